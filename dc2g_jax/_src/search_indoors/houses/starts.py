"""Starts of object searches, the cells that a robot can reach, and the cells from which an object is within reach."""

import math

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from dc2g_jax._src.grid.ground import component_numbers, connected_to
from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld
from dc2g_jax._src.search_indoors.maps.cost_maps import REACH


def _distance_to(cells: Bool[np.ndarray, "h w"], cell_size: float) -> Float[np.ndarray, "h w"]:
    """Straight-line distance of each cell to the nearest of some cells, meters."""
    return distance_transform_edt(~cells).astype(np.float32) * cell_size


def largest_region(world: IndoorWorld) -> Bool[np.ndarray, "h w"]:
    """The cells of the largest region of a house in which a robot can drive; none if it fits nowhere."""
    region = component_numbers(world.fits)
    sizes = np.bincount(region.ravel())
    sizes[0] = 0
    return (region == np.argmax(sizes)) & (region > 0)


def approaches(world: IndoorWorld, goal: int) -> Bool[np.ndarray, "h w"]:
    """The cells on which a robot has an object of a class within `REACH`, in the room of the object.

    Args:
      world: one house.
      goal: class index.
    """
    cell_size, rooms = float(world.cell_size), np.asarray(world.rooms)
    goals, near = np.asarray(world.goals(goal)), np.zeros(rooms.shape, bool)
    for room in np.unique(rooms[goals]):
        near |= (rooms == room) & (_distance_to(goals & (rooms == room), cell_size) <= REACH)
    return near & world.fits


def start_cells(world: IndoorWorld, goal: int, *, distance: float) -> Bool[np.ndarray, "h w"]:
    """The cells from which a robot can reach an object of a class, at some distance from all objects of the class.

    Args:
      world: one house.
      goal: class index.
      distance: least straight-line distance to the nearest object of the class, meters.
    """
    cell_size = float(world.cell_size)
    connected = connected_to(approaches(world, goal), world.fits)
    return connected & (_distance_to(np.asarray(world.goals(goal)), cell_size) >= distance)


def sample_starts(
    world: IndoorWorld, goal: int, count: int, *, rng: np.random.Generator, distance: float = 2.0
) -> Float[np.ndarray, "start 3"]:
    """Random starts on `start_cells` of the default robot: x and y in the world, meters, and yaw, radians.

    A start is in the center of a cell and has a random yaw. The result is empty, [0 3], if there are no start cells.

    Args:
      world: one house.
      goal: class index.
      count: number of starts.
      rng: random number generator.
      distance: least straight-line distance to the nearest object of the class, meters.
    """
    rows, columns = np.nonzero(start_cells(world, goal, distance=distance))
    if not rows.size:
        return np.zeros((0, 3))
    chosen = rng.integers(rows.size, size=count)
    x, y = (columns[chosen] + 0.5) * float(world.cell_size), -(rows[chosen] + 0.5) * float(world.cell_size)
    return np.stack([x, y, rng.uniform(-math.pi, math.pi, count)], axis=-1)
