"""Starts of object searches, the cells that a robot can reach, and the cells from which an object is within reach."""

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float

from dc2g_jax.grid.ground import component_numbers
from dc2g_jax.objectnav.worlds import IndoorWorld

#: Radius of the robot, meters.
ROBOT_RADIUS = 0.2

#: An object within this distance is reached, meters: the paper's success distance (section III-C).
REACH = 1.0


def passable(free: Bool[np.ndarray, "h w"], cell_size: float, radius: float = ROBOT_RADIUS) -> Bool[np.ndarray, "h w"]:
    """The cells in whose center a round robot does not touch blocked cells.

    Blocked cells count as discs of the width of a cell.

    Args:
      free: cells without obstacles. Space beyond the grid does not count as blocked.
      cell_size: side of a cell, meters.
      radius: radius of the robot, meters.
    """
    distance = cv2.distanceTransform(free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(distance * cell_size >= radius + cell_size / 2 - 1e-6)


def approaches(
    world: IndoorWorld, goal: int, *, radius: float = ROBOT_RADIUS, reach: float = REACH
) -> Bool[np.ndarray, "h w"]:
    """The cells on which a robot has an object of a class within reach, in the room of the object.

    Args:
      world: one house.
      goal: class index.
      radius: radius of the robot, meters.
      reach: largest distance from the cell to the nearest cell of the object, meters.
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
    """The cells from which a robot can reach an object of a class, at some distance from all objects of the class.

    Args:
      world: one house.
      goal: class index.
      distance: least straight-line distance to the nearest object of the class, meters.
      radius: radius of the robot, meters.
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


def rooms_cut_off(world: IndoorWorld, *, radius: float = ROBOT_RADIUS) -> list[int]:
    """The rooms that a robot cannot reach from the largest connected region, by their number in `world.rooms`."""
    piece = component_numbers(passable(np.asarray(world.free), float(world.cell_size), radius))
    sizes = np.bincount(piece.ravel())
    sizes[0] = 0
    reached = np.unique(np.asarray(world.rooms)[(piece == sizes.argmax()) & (piece > 0)])
    return [room for room in range(1, len(world.room_kinds)) if room not in reached]
