"""Maps without classes, as a laser sees them: mazes, halls and offices. Cells are free or occupied; one is the door."""

import functools
import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool

from dc2g_jax.datasets import PROCEDURAL, House, HouseDataset, sampled
from dc2g_jax.grid import FREE, FRONT_DOOR, OCCUPIED, ClassImage, largest_piece

#: Columns and rows of the maps.
CELLS = 50

#: Number of maps of each split: the first are to choose on, the rest are kept aside.
SPLIT_SIZES = {"val": 100, "test": 100}

#: Least share of the cells that is free and connected.
_LEAST_FREE = 0.2


def draw_maze(rng: np.random.Generator) -> Bool[np.ndarray, "h w"]:
    """Free cells of a maze: corridors two to five cells wide, of which some walls are left out.

    The corridors are a random spanning tree of squares, grown depth first.
    """
    wide = int(rng.integers(2, 6))
    squares = (CELLS - 1) // (wide + 1)
    free = np.zeros((CELLS, CELLS), bool)

    def open_square(row: int, column: int, down: int = 0, right: int = 0) -> None:
        """Free a square, and the wall between it and the one below or to the right."""
        top, left = 1 + row * (wide + 1), 1 + column * (wide + 1)
        free[top : top + wide + down, left : left + wide + right] = True

    left_out = float(rng.choice([0.0, 0.05, 0.15]))
    path, met = [(0, 0)], {(0, 0)}
    open_square(0, 0)
    while path:
        row, column = path[-1]
        around = [(row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)]
        around = [(r, c) for r, c in around if 0 <= r < squares and 0 <= c < squares]
        new = [square for square in around if square not in met]
        chosen = new[int(rng.integers(len(new)))] if new else None
        for r, c in around:
            if (r, c) == chosen or (chosen is None and rng.random() < left_out):
                open_square(min(row, r), min(column, c), down=int(r != row), right=int(c != column))
        if chosen is None:
            path.pop()
        else:
            open_square(*chosen)
            met.add(chosen)
            path.append(chosen)
    return free


def draw_hall(rng: np.random.Generator) -> Bool[np.ndarray, "h w"]:
    """Free cells of a hall: an open square with 5 to 59 walls and boxes in it, anywhere."""
    free = np.zeros((CELLS, CELLS), bool)
    free[1:-1, 1:-1] = True
    for _ in range(rng.integers(5, 60)):
        if rng.random() < 0.5:
            height, width = rng.integers(1, 7, size=2)
        else:
            height, width = rng.permutation([1, int(rng.integers(4, 25))])
        row, column = rng.integers(CELLS, size=2)
        free[row : row + height, column : column + width] = False
    return free


def draw_office(rng: np.random.Generator) -> Bool[np.ndarray, "h w"]:
    """Free cells of an office floor: corridors from wall to wall, rooms on both sides of each, desks in the rooms."""
    free = np.zeros((CELLS, CELLS), bool)
    rows = list(np.cumsum(rng.integers(11, 17, size=5)) - 5)
    corridors = [(int(row), int(row + rng.integers(2, 4))) for row in rows if row < CELLS - 8]
    for top, bottom in corridors:
        free[top:bottom, 1:-1] = True
    # Rooms reach halfway to the next corridor, or to the outer wall.
    halfway = [(above[1] + below[0]) // 2 for above, below in itertools.pairwise(corridors)]
    walls = [0, *halfway, CELLS - 1]
    for (top, bottom), above, below in zip(corridors, walls, walls[1:], strict=False):
        for first, last, door in ((above + 1, top - 1, top - 1), (bottom + 1, below, bottom)):
            left = 1
            while left < CELLS - 4:
                right = min(left + int(rng.integers(4, 11)), CELLS - 1)
                free[first:last, left:right] = True
                opening = int(rng.integers(left, right - 1)) if right - left > 1 else left
                free[door, opening : min(opening + 2, right)] = True
                for _ in range(rng.integers(0, 3)):
                    row, column = rng.integers(first, max(last, first + 1)), rng.integers(left, right)
                    free[row : min(row + 1, last), column : min(column + 2, right)] = False
                left = right + 1
    for _ in range(rng.integers(1, 3)):  # a corridor across
        left = int(rng.integers(2, CELLS - 4))
        free[corridors[0][0] : corridors[-1][1], left : left + 2] = True
    return free


#: What is drawn, by the name of the dataset.
PLAIN: dict[str, Callable[[np.random.Generator], Bool[np.ndarray, "h w"]]] = {
    "mazes": draw_maze,
    "halls": draw_hall,
    "offices": draw_office,
}


def with_door(free: Bool[np.ndarray, "h w"], rng: np.random.Generator) -> ClassImage | None:
    """Class indices of a map with these free cells, and the door on one of them at random.

    Only the largest piece of connected cells stays free. `None` if it is too small.
    """
    ground = largest_piece(free)
    if ground.sum() < _LEAST_FREE * free.size:
        return None
    classes = np.where(ground, np.uint8(FREE), np.uint8(OCCUPIED))
    cells = np.argwhere(ground)
    classes[tuple(cells[rng.integers(len(cells))])] = FRONT_DOOR
    return classes


def plain_maps(kind: str, seed: int = 0) -> list[tuple[str, str, ClassImage]]:
    """Maps of one of the kinds of `PLAIN`: (name, split, class indices uint8 [50 50]) of each, see `SPLIT_SIZES`."""
    maps = []
    for number, split in enumerate(split for split, size in SPLIT_SIZES.items() for _ in range(size)):
        key = (list(PLAIN).index(kind), number)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
        drawn = None
        while drawn is None:
            drawn = with_door(PLAIN[kind](rng), rng)
        maps.append((f"{kind[:-1]}{number:03d}", split, drawn))
    return maps


@functools.cache
def _drawn(kind: str) -> HouseDataset:
    houses = (House(name, split, sampled(name, classes, None)) for name, split, classes in plain_maps(kind))
    return HouseDataset(kind, PROCEDURAL, tuple(houses))


def _dataset(kind: str, **_: object) -> HouseDataset:
    """The maps of one of the kinds of `PLAIN`, whatever grid and split are asked for."""
    return _drawn(kind)


#: The datasets of these names.
mazes, halls, offices = (functools.partial(_dataset, kind) for kind in PLAIN)
