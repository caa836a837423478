"""Which ground hangs together: what can be reached from the goals of a map, and what cannot."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Int, UInt8

from dc2g_jax.grid.terrain import FRONT_DOOR, TRAVERSABLE


class Piece(NamedTuple):
    """Cells that hang together.

    Attributes:
      x: column of the one nearest to their mean.
      y: its row.
      cells: how many there are.
    """

    x: int
    y: int
    cells: int


def component_numbers(cells: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """The number of the 4-connected component that each cell belongs to, 0 where there is none."""
    return np.asarray(cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)[1])


def pieces(cells: Bool[np.ndarray, "h w"]) -> list[Piece]:
    """The 4-connected pieces of a set of cells, the largest first."""
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
    labels = component_numbers(TRAVERSABLE[terrain])
    return np.asarray(TRAVERSABLE[terrain] & np.isin(labels, labels[terrain == FRONT_DOOR]))


def goals_without_ground(terrain: UInt8[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Front door cells that no other traversable ground leads to, 4-connected."""
    goals = terrain == FRONT_DOOR
    labels = component_numbers(TRAVERSABLE[terrain])
    return np.asarray(goals & ~np.isin(labels, labels[TRAVERSABLE[terrain] & ~goals]))


def why_no_way(terrain: UInt8[np.ndarray, "h w"]) -> str | None:
    """Why no ground of a map leads to a goal, or `None` where some does."""
    goals = terrain == FRONT_DOOR
    if not np.any(TRAVERSABLE[terrain] & ~goals):
        return "it has no traversable ground"
    if not np.any(goals):
        return "it has no front door"
    if np.all(goals_without_ground(terrain)[goals]):
        return "no front door can be reached, none touches other traversable ground"
    return None
