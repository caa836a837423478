"""Where a robot can go in a house, when it has come to an object, and where episodes begin."""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float

from dc2g_jax.grid.ground import component_numbers
from dc2g_jax.objectnav.worlds import IndoorWorld

#: Radius of the robot, meters.
ROBOT_RADIUS = 0.2

#: How near the robot comes to an object that it has reached, meters: the paper's success distance (section III-C).
REACH = 1.0


def passable(free: Bool[np.ndarray, "h w"], cell_size: float, radius: float = ROBOT_RADIUS) -> Bool[np.ndarray, "h w"]:
    """The cells in whose middle a round robot stands clear of all cells that are not free.

    A blocked cell counts as a disc as wide as itself.

    Args:
      free: cells without obstacles. What lies beyond the grid does not count.
      cell_size: side of a cell, meters.
      radius: of the robot, meters.
    """
    distance = cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance * cell_size >= radius + cell_size / 2 - 1e-6)


def approaches(
    world: IndoorWorld, goal: int, *, radius: float = ROBOT_RADIUS, reach: float = REACH
) -> Bool[np.ndarray, "h w"]:
    """The cells that a robot can stand on with an object of a class within reach, in the object's own room.

    Args:
      world: one house.
      goal: class index.
      radius: of the robot, meters.
      reach: from the cell to the nearest cell of the object, meters.
    """
    cell_size, rooms = float(world.cell_size), np.asarray(world.rooms)
    goals, near = np.asarray(world.goals(goal)), np.zeros(rooms.shape, bool)
    for room in np.unique(rooms[goals]):
        elsewhere = np.where(goals & (rooms == room), 0, 1).astype(np.uint8)
        distance = cv2.distanceTransform(elsewhere, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        near |= (rooms == room) & (distance * cell_size <= reach)
    return near & passable(np.asarray(world.free), cell_size, radius)


def start_cells(
    world: IndoorWorld, goal: int, *, distance: float, radius: float = ROBOT_RADIUS, reach: float = REACH
) -> Bool[np.ndarray, "h w"]:
    """The cells from which a robot can get to an object of a class that is not near it yet.

    Args:
      world: one house.
      goal: class index.
      distance: to the nearest object of the class as the crow flies, meters at least.
      radius: of the robot, meters.
      reach: see `approaches`.
    """
    piece = component_numbers(passable(np.asarray(world.free), float(world.cell_size), radius))
    connected = (piece > 0) & np.isin(piece, piece[approaches(world, goal, radius=radius, reach=reach)])
    elsewhere = np.where(np.asarray(world.goals(goal)), 0, 1).astype(np.uint8)
    away = cv2.distanceTransform(elsewhere, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * float(world.cell_size)
    return np.asarray(connected & (away >= distance))


def sample_starts(
    world: IndoorWorld, goal: int, count: int, *, rng: np.random.Generator, distance: float = 2.0
) -> Float[np.ndarray, "start 3"]:
    """Random starts on `start_cells` of the usual robot: x and y in the world, meters, and yaw, radians.

    Each is in the middle of a cell and headed anywhere. There are none, [0 3], where no such object can be reached from
    far enough away.

    Args:
      world: one house.
      goal: class index.
      count: how many.
      rng: where chance comes from.
      distance: to the nearest object of the class as the crow flies, meters at least.
    """
    rows, columns = np.nonzero(start_cells(world, goal, distance=distance))
    if not rows.size:
        return np.zeros((0, 3))
    chosen = rng.integers(rows.size, size=count)
    x, y = (columns[chosen] + 0.5) * float(world.cell_size), -(rows[chosen] + 0.5) * float(world.cell_size)
    return np.stack([x, y, rng.uniform(-math.pi, math.pi, count)], axis=-1)


def rooms_cut_off(world: IndoorWorld, *, radius: float = ROBOT_RADIUS) -> list[int]:
    """The rooms that a robot cannot get to from where it can move most, by their number in `world.rooms`."""
    piece = component_numbers(passable(np.asarray(world.free), float(world.cell_size), radius))
    sizes = np.bincount(piece.ravel())
    sizes[0] = 0
    reached = np.unique(np.asarray(world.rooms)[(piece == sizes.argmax()) & (piece > 0)])
    return [room for room in range(1, len(world.room_kinds)) if room not in reached]
