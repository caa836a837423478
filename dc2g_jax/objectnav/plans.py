"""Plans of furnished houses in meters, before rasterization.

Plan frame: x to the right, y up, angles counter-clockwise from x.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Room(NamedTuple):
    """A room.

    Attributes:
      kind: index into `dc2g_jax.objectnav.classes.ROOM_NAMES`.
      outline: corners of its floor in order, [corner 2].
    """

    kind: int
    outline: Float[np.ndarray, "corner 2"]


class Segment(NamedTuple):
    """A straight segment of a wall, given by its ends (x, y)."""

    start: tuple[float, float]
    end: tuple[float, float]


class Furniture(NamedTuple):
    """An object as an upright box.

    Attributes:
      kind: class index, see `dc2g_jax.objectnav.classes`.
      x: x of its center, meters.
      y: y of its center, meters.
      width: extent along its own x axis, meters.
      depth: extent along its own y axis, meters.
      angle: angle of its own x axis, radians.
      top: height of its top above the floor, meters.
    """

    kind: int
    x: float
    y: float
    width: float
    depth: float
    angle: float
    top: float


@dataclass(frozen=True, eq=False)
class HousePlan:
    """A furnished house.

    Attributes:
      rooms: at least one room; rooms do not overlap.
      walls: walls; those that two rooms share may occur twice.
      doors: open segments of walls. All doors of a plan are open.
      furniture: furniture in any order.
    """

    rooms: tuple[Room, ...]
    walls: tuple[Segment, ...]
    doors: tuple[Segment, ...]
    furniture: tuple[Furniture, ...]
