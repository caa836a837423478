"""Maps to test on: drawn by hand, and drawn at random in sizes that try the packed words' edges."""

import numpy as np
from hypothesis import strategies as st

from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax.families.procedural import draw_house

#: Map sizes (height, width): single cells and lines, and widths on both sides of the word boundaries.
SHAPES = ((1, 1), (1, 40), (33, 1), (9, 31), (8, 32), (7, 33), (5, 63), (6, 64), (5, 65))

LETTERS = {
    ".": "grass",
    "#": "house",
    "R": "road",
    "D": "front_door",
    "d": "driveway",
    "P": "path",
    "S": "sidewalk",
    "t": "tree",
}

_DRIVABLE = [CLASS_NAMES.index(name) for name in ("road", "driveway", "path", "sidewalk", "traversable")]
_BLOCKED = [CLASS_NAMES.index(name) for name in ("grass", "car", "house", "fence", "tree", "nothing")]


def drawn(picture: str) -> np.ndarray:
    """The class grid of a picture in `LETTERS`, a row a line."""
    return np.array(
        [[CLASS_NAMES.index(LETTERS[letter]) for letter in line.strip()] for line in picture.split()], np.uint8
    )


def random_cells(seed: int, shape: tuple[int, int], density: float) -> np.ndarray:
    """A random set of cells, bool [h w]."""
    return np.random.default_rng(seed).random(shape) < density


def random_terrain(seed: int, shape: tuple[int, int], density: float, doors: int = 1) -> np.ndarray:
    """Random classes with about this share of traversable cells, every class drawn but 'unknown'."""
    rng = np.random.default_rng(seed)
    drivable = rng.random(shape) < density
    terrain = np.where(drivable, rng.choice(_DRIVABLE, shape), rng.choice(_BLOCKED, shape)).astype(np.uint8)
    for _ in range(doors):
        terrain[rng.integers(shape[0]), rng.integers(shape[1])] = CLASS_NAMES.index("front_door")
    return terrain


def random_pose(seed: int, cells: np.ndarray) -> tuple[int, int, int]:
    """A random pose (x, y, heading) on one of the cells, often on the first or last of them in raster order."""
    rng = np.random.default_rng([seed, 1])
    candidates = np.argwhere(cells)
    row, column = candidates[rng.choice([0, -1, rng.integers(len(candidates))])]
    return int(column), int(row), int(rng.integers(4))


seeds = st.integers(0, 2**32 - 1)
densities = st.sampled_from([0.0, 0.1, 0.4, 0.55, 0.65, 0.75, 0.9, 1.0])


def drawn_dataset() -> HouseDataset:
    """Two urban training houses and one to validate on, at full resolution."""
    splits = {"n000": "train", "n001": "train", "n009": "val"}
    houses = (House(name, split, draw_house(seed, "urban")) for seed, (name, split) in enumerate(splits.items()))
    return HouseDataset("drawn", "folder", tuple(houses))
