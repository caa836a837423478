"""Connected components of the ground, and which of it connects to a goal."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, UInt8
from scipy import ndimage

from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE


class Piece(NamedTuple):
    """A connected set of cells.

    Attributes:
      x: column of the cell nearest to the mean of the set.
      y: row of that cell.
      cells: number of cells.
    """

    x: int
    y: int
    cells: int


def component_numbers(cells: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """The number of the 4-connected component of each cell, counted from 1; 0 for cells outside the set."""
    return np.asarray(ndimage.label(cells)[0])


def largest_piece(cells: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The largest 4-connected component of a set of cells; empty for an empty set."""
    numbers = component_numbers(cells)
    return np.asarray(cells & (numbers == np.argmax(np.bincount(numbers[cells], minlength=1))))


def connected_to(goals: Bool[np.ndarray, "h w"], cells: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """The cells from which a 4-connected path within `cells` leads to a goal."""
    numbers = component_numbers(cells)
    return np.asarray(cells & np.isin(numbers, numbers[goals & cells]))


def pieces(cells: Bool[np.ndarray, "h w"]) -> list[Piece]:
    """The 4-connected components of a set of cells, the largest first."""
    y, x = np.nonzero(cells)
    if not len(x):
        return []
    piece = component_numbers(cells)[y, x] - 1
    counts = np.bincount(piece)
    off_mean = np.hypot(x - (np.bincount(piece, x) / counts)[piece], y - (np.bincount(piece, y) / counts)[piece])
    middles = np.lexsort((off_mean, piece))[np.cumsum(counts) - counts]
    found = [Piece(int(x[i]), int(y[i]), int(count)) for i, count in zip(middles, counts, strict=True)]
    return sorted(found, key=lambda piece: -piece.cells)


def connected_to_goal(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Traversable cells from which a front door can be reached, 4-connected."""
    return connected_to(terrain == FRONT_DOOR, TRAVERSABLE[terrain])


def goals_without_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Front door cells that touch no other traversable ground, 4-connected."""
    goals = terrain == FRONT_DOOR
    return goals & ~connected_to(~goals, TRAVERSABLE[terrain])


def why_no_path(terrain: UInt8[np.ndarray, "h w"]) -> str | None:
    """The reason why no ground of a map leads to a goal; `None` if some ground does."""
    goals = terrain == FRONT_DOOR
    if not np.any(TRAVERSABLE[terrain] & ~goals):
        return "it has no traversable ground"
    if not np.any(goals):
        return "it has no front door"
    if np.all(goals_without_ground(terrain)[goals]):
        return "no front door can be reached, none touches other traversable ground"
    return None


def longest_way(terrain: UInt8[np.ndarray, "h w"]) -> int:
    """Cells of the longest of all shortest 4-connected ways from a front door to ground; 0 without a front door."""
    unseen = np.pad(connected_to_goal(terrain), 1)
    reached = np.flatnonzero(unseen & np.pad(terrain == FRONT_DOOR, 1))
    to_neighbors = np.array([[1], [-1], [unseen.shape[1]], [-unseen.shape[1]]])
    unseen = unseen.ravel()
    cells = 0
    unseen[reached] = False
    while True:
        near = np.unique(reached + to_neighbors)
        reached = near[unseen[near]]
        if not len(reached):
            return cells
        unseen[reached] = False
        cells += 1
