"""Slow, obviously right driving: small steps in double precision, and distances to every cell of the map."""

import numpy as np

Array = np.ndarray

FRAME = 3


def driven(position: Array, yaw: float, speed: float, turn_rate: float, seconds: float, steps: int) -> Array:
    """Positions on the way, [steps + 1 2]: at every small step straight ahead in the middle direction of the step."""
    small = seconds / steps
    yaws = yaw + turn_rate * small * (np.arange(steps) + 0.5)
    moves = speed * small * np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    return np.asarray(position, float) + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])


def clearance(points: Array, free: Array, cell_size: float) -> Array:
    """Distance of each point, [n 2], to the nearest cell that is not free, those beyond the map among them, [n].

    Points lie on the map or less than `FRAME` cells beyond it.
    """
    framed = np.pad(free, FRAME, constant_values=False)
    rows, columns = np.nonzero(~framed)
    low = np.stack([columns - FRAME, FRAME - 1 - rows], axis=-1) * cell_size
    nearest = np.full(len(points), np.inf)
    for corner in low:
        outside = np.maximum(np.maximum(corner - points, points - (corner + cell_size)), 0)
        nearest = np.minimum(nearest, np.hypot(*outside.T))
    return nearest
