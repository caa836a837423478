"""Houses as grids of cells: free floor, heights, classes and objects, a scene, colors, and starts of searches.

World frame as in `mapping.camera`: x along the columns, y against the rows, both 0 at the outer corner of the
first cell, which is the upper left one of the plan.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from flax import struct
from jaxtyping import Bool, Float, Int16, UInt8
from scipy.ndimage import distance_transform_edt

from dc2g_jax.grid import connected_to
from dc2g_jax.indoor.maps.classes import BATHROOM, BEDROOM, KITCHEN, LIVING_ROOM, NO_COLOR, OBJECT_COLORS
from dc2g_jax.indoor.maps.cost_maps import REACH, ROBOT_RADIUS, Cells, inflated
from dc2g_jax.robot import Scene, scene_from_heights

#: Colors of floors by type of room, of walls, and of the outside.
_FLOORS = {BEDROOM: (196, 170, 140), BATHROOM: (170, 196, 206), KITCHEN: (206, 200, 182), LIVING_ROOM: (158, 120, 88)}
_WALL = (226, 224, 218)


@struct.dataclass
class IndoorWorld:
    """One house. Its leaves are NumPy arrays until houses are stacked.

    Attributes:
      free: whether a cell is free floor, including open doors.
      heights: height of each cell above the floor, meters; 0 on free floor and outside.
      classes: class index of the highest object in each cell, see `maps.classes`; 0 without object, as in
        walls.
      instances: index of that object in `object_kinds`, -1 without object.
      rooms: room of each cell, also below objects; 0 in walls and outside.
      room_kinds: room -> index into `maps.classes.ROOM_NAMES`; room 0 is the outside.
      object_kinds: class of each object, including those hidden below higher ones; 0 is padding.
      cell_size: side of a cell, meters.
    """

    free: Bool[Cells, "h w"]
    heights: Float[Cells, "h w"]
    classes: UInt8[Cells, "h w"]
    instances: Int16[Cells, "h w"]
    rooms: UInt8[Cells, "h w"]
    room_kinds: UInt8[Cells, " room"]
    object_kinds: UInt8[Cells, " object"]
    cell_size: Float[Cells, ""]

    @property
    def obstacle(self) -> Bool[Cells, "h w"]:
        """Cells of walls and objects. The outside is neither free nor an obstacle."""
        return self.heights > 0

    @property
    def walls(self) -> Bool[Cells, "h w"]:
        """Cells of walls."""
        return self.obstacle & (self.instances < 0)

    @property
    def fits(self) -> Bool[np.ndarray, "h w"]:
        """Cells in whose center a robot touches no blocked cell. Space beyond the grid does not count as blocked."""
        return ~inflated(~np.asarray(self.free), ROBOT_RADIUS, float(self.cell_size))


def scene(world: IndoorWorld) -> Scene:
    """The scene of a house for the simulated camera, with one tile per cell. Scenes of equal size can be stacked."""
    return scene_from_heights(np.asarray(world.heights), np.asarray(world.classes), float(world.cell_size))


def painted(world: IndoorWorld, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    """The color of each cell of a house, which is that of its highest object.

    Houses have no textures. Objects have the colors of their classes with random variation. Floors differ by the type
    of room, since kitchens and bathrooms have other floors than bedrooms. All walls look alike.
    """
    objects = np.append(OBJECT_COLORS[np.asarray(world.object_kinds)], [_WALL], axis=0)
    objects = objects + rng.normal(0, 14, objects.shape)
    kinds = np.asarray(world.room_kinds)
    floors = np.array([_FLOORS.get(int(kind), NO_COLOR) for kind in kinds]) + rng.normal(0, 10, (len(kinds), 3))
    cells = np.where(
        np.asarray(world.obstacle)[..., None], objects[np.asarray(world.instances)], floors[np.asarray(world.rooms)]
    )
    return np.clip(np.round(cells), 0, 255).astype(np.uint8)


def padded_alike(worlds: Sequence[IndoorWorld]) -> list[IndoorWorld]:
    """Pad houses with equal cells, one at least, to a common size, so that they can be stacked.

    Cells keep their positions.
    """
    names = [field.name for field in dataclasses.fields(IndoorWorld) if field.name != "cell_size"]
    most = {name: np.max([getattr(world, name).shape for world in worlds], axis=0) for name in names}

    def padded(world: IndoorWorld, name: str) -> np.ndarray:
        leaf = getattr(world, name)
        margins = [(0, size) for size in most[name] - leaf.shape]
        return np.pad(leaf, margins, constant_values=-1 if name == "instances" else 0)

    return [dataclasses.replace(world, **{name: padded(world, name) for name in names}) for world in worlds]


def _distance_to(cells: Bool[np.ndarray, "h w"], cell_size: float) -> Float[np.ndarray, "h w"]:
    return distance_transform_edt(~cells).astype(np.float32) * cell_size


def approaches(world: IndoorWorld, goal: int) -> Bool[np.ndarray, "h w"]:
    """The cells on which a robot has an object of a class within `REACH`, in the room of the object."""
    cell_size, rooms = float(world.cell_size), np.asarray(world.rooms)
    goals, near = np.asarray(world.classes) == goal, np.zeros(rooms.shape, bool)
    for room in np.unique(rooms[goals]):
        near |= (rooms == room) & (_distance_to(goals & (rooms == room), cell_size) <= REACH)
    return near & world.fits


def start_cells(world: IndoorWorld, goal: int, *, distance: float) -> Bool[np.ndarray, "h w"]:
    """The cells from which a robot can reach an object of a class, `distance` meters or more from all of the class."""
    cell_size = float(world.cell_size)
    connected = connected_to(approaches(world, goal), world.fits)
    return connected & (_distance_to(np.asarray(world.classes) == goal, cell_size) >= distance)


def sample_starts(
    world: IndoorWorld, goal: int, count: int, *, rng: np.random.Generator, distance: float = 2.0
) -> Float[np.ndarray, "start 3"]:
    """Random starts on `start_cells` of the default robot: x and y in the world, meters, and yaw, radians.

    A start is in the center of a cell and has a random yaw. The result is empty, [0 3], if there are no start cells.
    """
    rows, columns = np.nonzero(start_cells(world, goal, distance=distance))
    if not rows.size:
        return np.zeros((0, 3))
    chosen = rng.integers(rows.size, size=count)
    x, y = (columns[chosen] + 0.5) * float(world.cell_size), -(rows[chosen] + 0.5) * float(world.cell_size)
    return np.stack([x, y, rng.uniform(-math.pi, math.pi, count)], axis=-1)
