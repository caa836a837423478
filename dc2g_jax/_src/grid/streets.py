"""The width of streets, which tells a map of a town from one of a house with its surroundings."""

import numpy as np
from jaxtyping import Array, Bool, UInt8
from scipy import ndimage

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.terrain import ROAD

#: The widest street fits more often into the longer side of a map of a town. Into that of the published and procedural
#: houses, it fits 10 times at most.
_STREETS_A_SIDE = 12

#: Longest side of the maps that show a house, by their size, in cells: twice the side of the training maps.
_LONGEST_SIDE_OF_A_HOUSE = 100


def street_width(terrain: UInt8[np.ndarray, "h w"]) -> int:
    """Width of the widest street in cells: the side of the largest square of road; 0 without road."""
    road, width = np.pad(terrain == ROAD, 1), 0
    while np.any(road):
        road, width = ndimage.binary_erosion(road, np.ones((2, 2))), width + 1
    return width


def is_town(terrain: UInt8[np.ndarray, "h w"]) -> bool:
    """Whether a map has streets, all of them narrow for its size."""
    return 0 < street_width(terrain) < max(terrain.shape) // _STREETS_A_SIDE


def in_town(belief: Belief) -> Bool[Array, "*batch"]:
    """Whether most of the road that a robot has seen is narrow for the size of the map; no without road.

    Streets are taken to go on where nothing has been observed on small maps, and to end there on large ones.
    """
    road = belief.of_class(ROAD) & belief.seen
    longest = max(belief.height, belief.width)
    side = longest // _STREETS_A_SIDE
    ends = belief.seen & ~road if longest <= _LONGEST_SIDE_OF_A_HOUSE else bitboard.complement(road, belief.width)
    corners = bitboard.complement(_spread(ends, side, -1), belief.width)
    wide = road & _spread(corners, side, 1)
    return 2 * bitboard.count(wide) < bitboard.count(road)


def _spread(cells: Board, side: int, way: int) -> Board:
    """The squares of this side whose upper left (way 1) or lower right corners (way -1) are the cells."""
    reach = 1
    while reach < side:
        step = min(reach, side - reach)
        cells = cells | bitboard.shift(cells, way * step, 0)
        cells = cells | bitboard.shift(cells, 0, way * step)
        reach += step
    return cells
