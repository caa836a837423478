"""A furnished house in meters, before it is cut into cells.

Plan frame: x to the right and y up, as one draws it, angles counter-clockwise from x.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Room(NamedTuple):
    """A room.

    Attributes:
      kind: index into `dc2g_jax.objectnav.classes.ROOM_NAMES`.
      outline: corners of its floor in turn, [corner 2].
    """

    kind: int
    outline: Float[np.ndarray, "corner 2"]


class Segment(NamedTuple):
    """A straight piece of a wall, by its ends (x, y)."""

    start: tuple[float, float]
    end: tuple[float, float]


class Furniture(NamedTuple):
    """An object as an upright box.

    Attributes:
      kind: class index, see `dc2g_jax.objectnav.classes`.
      x: of its middle.
      y: of its middle.
      width: along its own x axis, meters.
      depth: along its own y axis, meters.
      angle: of that x axis, radians.
      top: how high it reaches above the floor, meters.
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
      rooms: at least one; no two overlap.
      walls: those that two rooms share may come twice.
      doors: the pieces of walls that are open. All doors of a plan are.
      furniture: in any order.
    """

    rooms: tuple[Room, ...]
    walls: tuple[Segment, ...]
    doors: tuple[Segment, ...]
    furniture: tuple[Furniture, ...]
