"""Remixed houses: new maps made of known ones, so that a network does not learn a few real houses by heart.

A map is turned or mirrored, stretched and squeezed along both axes by factors that change from place to place, and
often turned off the grid; every other one is then cut in two, and one side replaced by a piece of another map that goes
on where the cut is. Streets, driveways and gardens keep the look of real ones.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8

from dc2g_jax.datasets.houses import House
from dc2g_jax.datasets.starts import start_cells, why_no_episode

#: Standard deviation of the logarithm of the local scale, and largest logarithm of the scale of the whole map.
_STRETCH, _SCALE = 0.3, 0.15
#: Largest shift, as a share of the map's side.
_SHIFT = 0.14
#: Largest angle in degrees of the maps that are turned off the grid.
_ANGLE = 30.0
#: Share of cells on both sides of a cut that must be alike.
_ALIKE = 0.88
#: Pieces that are tried for one cut, and maps that are tried for one house.
_PIECES, _MAPS = 96, 100


def _source(rng: np.random.Generator, size: int) -> Float[np.ndarray, "n"]:
    """Along one axis: where each cell is taken from."""
    knots = int(rng.integers(3, 7))
    rate = np.exp(np.interp(np.arange(size), np.linspace(0, size - 1, knots), rng.normal(0, _STRETCH, knots)))
    position = np.cumsum(rate * np.exp(rng.uniform(-_SCALE, _SCALE)) / rate.mean())
    return position - position[size // 2] + size * (0.5 + rng.uniform(-_SHIFT, _SHIFT))


def _turned(rng: np.random.Generator, grid: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """A map in one of its symmetries (those of the rectangle where it is not square)."""
    grid = grid[:: rng.choice((-1, 1)), :: rng.choice((-1, 1))]
    return grid.T if grid.shape[0] == grid.shape[1] and rng.random() < 0.5 else grid


def _taken(
    grid: UInt8[np.ndarray, "h w"], rows: Float[np.ndarray, "*cells"], columns: Float[np.ndarray, "*cells"]
) -> UInt8[np.ndarray, "*cells"]:
    """The nearest cells of a map; beyond its edge, those of the edge."""
    nearest = (np.rint(at).astype(int).clip(0, size - 1) for at, size in zip((rows, columns), grid.shape, strict=True))
    return grid[tuple(nearest)]


def _bent(rng: np.random.Generator, grid: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """A map turned, stretched and shifted at random."""
    grid = _turned(rng, grid)
    rows, columns = np.meshgrid(*(_source(rng, size) for size in grid.shape), indexing="ij")
    angle = np.deg2rad(rng.uniform(-_ANGLE, _ANGLE)) if rng.random() < 0.5 else 0.0
    middle, centre = ((size - 1) / 2 for size in grid.shape)
    down, right = rows - middle, columns - centre
    return _taken(
        grid,
        np.cos(angle) * down - np.sin(angle) * right + middle,
        np.sin(angle) * down + np.cos(angle) * right + centre,
    )


def _joined(
    rng: np.random.Generator, left: UInt8[np.ndarray, "h w"], right: UInt8[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w"] | None:
    """The left part of one map and the right part of another that best goes on from it; `None` if none does well."""
    height, width = left.shape
    row, column = np.arange(height)[:, None], np.arange(width)
    best, found = _ALIKE, None
    for _ in range(_PIECES if width >= 4 else 0):
        piece = _turned(rng, right)
        cut = int(rng.integers(width // 4, width - width // 4 + 1))
        down, aside = int(rng.integers(-height // 3, height // 3 + 1)), int(rng.integers(-width // 5, width // 5 + 1))
        edge = left[:, cut - 1]
        piece = piece[(row + down).clip(0, height - 1), (column + aside).clip(0, width - 1)]
        alike = np.mean(edge == piece[:, cut])
        if alike > best and np.any(edge != edge[0]):
            best, found = alike, np.concatenate([left[:, :cut], piece[:, cut:]], axis=1)
    return found


def remix(rng: np.random.Generator, houses: Sequence[House]) -> UInt8[np.ndarray, "h w"]:
    """One map made of one or two others, in which an episode can be run.

    Args:
      rng: random numbers.
      houses: what to make it of: maps of one size, in which episodes can be run.

    Returns:
      Class indices. A quarter as many cells as in the map it is made of, at least, are fit to start from; where chance
      finds no such map, it is one of the houses as it is.
    """
    for _ in range(_MAPS):
        origin, other = (houses[number] for number in rng.integers(len(houses), size=2))
        grid = _bent(rng, origin.terrain)
        if rng.random() < 0.5 and (joined := _joined(rng, grid, _bent(rng, other.terrain))) is not None:
            grid = joined
        made = House("", origin.split, np.ascontiguousarray(grid))
        starts = np.count_nonzero(start_cells(made.terrain))
        if why_no_episode(made) is None and 4 * starts >= np.count_nonzero(start_cells(origin.terrain)):
            return made.terrain
    return origin.terrain


def remixed_houses(houses: Sequence[House], count: int, seed: int) -> list[House]:
    """Remixed houses, called `m00000` and so on, of the split of the first house.

    Args:
      houses: see `remix`.
      count: how many.
      seed: what they depend on, beside the houses; the first ones are the same whatever the count.
    """
    rngs = (np.random.default_rng([seed, number]) for number in range(count))
    return [House(f"m{number:05d}", houses[0].split, remix(rng, houses)) for number, rng in enumerate(rngs)]
