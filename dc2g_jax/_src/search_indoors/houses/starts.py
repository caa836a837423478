"""Starts of object searches, the cells that a robot can reach, and the cells from which an object is within reach."""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float

from dc2g_jax._src.grid.ground import component_numbers, connected_to
from dc2g_jax._src.search_indoors.maps.cost_maps import footprint
from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld

#: Radius of the robot, meters.
ROBOT_RADIUS = 0.2

#: An object within this distance is reached, meters: the paper's success distance (section III-C).
REACH = 1.0


def _distance_to(cells: Bool[np.ndarray, "h w"], cell_size: float) -> Float[np.ndarray, "h w"]:
    """Straight-line distance of each cell to the nearest of some cells, meters."""
    elsewhere = np.where(cells, 0, 1).astype(np.uint8)
    return cv2.distanceTransform(elsewhere, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * cell_size


def passable(free: Bool[np.ndarray, "h w"], cell_size: float) -> Bool[np.ndarray, "h w"]:
    """The cells in whose center a robot touches no blocked cell: `inflated` on the host, for grids of any size.

    Args:
      free: cells without obstacles. Space beyond the grid does not count as blocked.
      cell_size: side of a cell, meters.
    """
    return cv2.dilate((~free).astype(np.uint8), footprint(ROBOT_RADIUS, cell_size).astype(np.uint8)) == 0


def largest_region(world: IndoorWorld) -> Bool[np.ndarray, "h w"]:
    """The cells of the largest region of a house in which a robot can drive; none if it fits nowhere."""
    region = component_numbers(passable(np.asarray(world.free), float(world.cell_size)))
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
    return near & passable(np.asarray(world.free), cell_size)


def start_cells(world: IndoorWorld, goal: int, *, distance: float) -> Bool[np.ndarray, "h w"]:
    """The cells from which a robot can reach an object of a class, at some distance from all objects of the class.

    Args:
      world: one house.
      goal: class index.
      distance: least straight-line distance to the nearest object of the class, meters.
    """
    cell_size = float(world.cell_size)
    connected = connected_to(approaches(world, goal), passable(np.asarray(world.free), cell_size))
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
