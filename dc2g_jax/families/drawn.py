"""Procedural maps without classes to train on: eight kinds, new for each seed. None is in a dataset."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from dc2g_jax.families.plain import draw_hall, draw_maze, draw_office
from dc2g_jax.grid import FREE, OCCUPIED, ClassImage, largest_piece

Free = Bool[np.ndarray, "h w"]

#: Smallest share of the cells that are free and connected.
_LEAST_FREE = 0.06


def _enlarged(draw: Callable[[np.random.Generator], Free]) -> Callable[[np.random.Generator, int], Free]:
    """Maps of 50 cells a side, enlarged: each cell becomes a square of several."""

    def drawn(rng: np.random.Generator, side: int) -> Free:
        factor = -(-side // 50)
        return np.kron(draw(rng), np.ones((factor, factor), bool))[:side, :side]

    return drawn


def draw_rooms(rng: np.random.Generator, side: int) -> Free:
    """A building, divided recursively into rooms: first by corridors, then by walls with doors."""
    free = np.zeros((side, side), bool)
    free[1:-1, 1:-1] = True
    least, wide, corridors = (int(rng.integers(*limits)) for limits in ((4, 14), (2, 5), (0, 4)))
    opening, loops = int(rng.integers(1, 4)), float(rng.choice([0.0, 0.1, 0.3]))

    def wall(part: Any, doors: int) -> None:
        free[part] = False
        line = free[part]
        for _ in range(doors):
            first = int(rng.integers(0, max(1, line.size - opening + 1)))
            line[first : first + opening] = True

    def divide(top: int, left: int, bottom: int, right: int, depth: int) -> None:
        upright = right - left > bottom - top
        size, length = (right - left, bottom - top) if upright else (bottom - top, right - left)
        gap = wide + 1 if depth < corridors else 0
        if size < 2 * least + gap + 2 or (depth > 2 and rng.random() < 0.1):
            return
        at = int(rng.integers(least, size - least - gap))
        for offset in {at, at + gap}:
            part = np.s_[top:bottom, left + offset] if upright else np.s_[top + offset, left:right]
            wall(part, max(1, length // int(rng.integers(6, 20))) if gap else 1 + int(rng.random() < loops))
        if upright:
            divide(top, left, bottom, left + at, depth + 1)
            divide(top, left + at + gap + 1, bottom, right, depth + 1)
        else:
            divide(top, left, top + at, right, depth + 1)
            divide(top + at + gap + 1, left, bottom, right, depth + 1)

    divide(1, 1, side - 1, side - 1, 0)
    for _ in range(int(rng.integers(0, 30) * (side / 50) ** 2)):
        (row, column), (down, across) = rng.integers(side, size=2), rng.integers(1, 4, size=2)
        free[row : row + down, column : column + across] = False
    return free


def draw_cave(rng: np.random.Generator, side: int) -> Free:
    """A cave, by a cellular automaton."""
    free = rng.random((side, side)) < rng.uniform(0.5, 0.6)
    for _ in range(int(rng.integers(3, 7))):
        free = ndimage.convolve(free.astype(int), np.ones((3, 3)), mode="constant") >= 5
    return free


def draw_land(rng: np.random.Generator, side: int) -> Free:
    """Open land with lakes and rocks: smoothed noise below a threshold."""
    smooth = rng.uniform(2, 7)
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), smooth)
    noise += rng.uniform(0, 0.3) * ndimage.gaussian_filter(rng.normal(size=(side, side)), smooth / 3)
    return noise < np.quantile(noise, rng.uniform(0.5, 0.85))


def draw_blocks(rng: np.random.Generator, side: int) -> Free:
    """City blocks: streets, and between them buildings, squares and courtyards; some cities are rotated."""
    free = np.zeros((side, side), bool)
    edges = []
    for axis in (0, 1):
        at, cuts = int(rng.integers(0, 8)), [0]
        while at < side:
            end = at + int(rng.integers(2, 6))
            np.swapaxes(free, 0, axis)[at:end] = True
            cuts += [at, min(end, side)]
            at = end + int(rng.integers(6, 24))
        edges.append([*cuts, side])
    for top, bottom in zip(edges[0][::2], edges[0][1::2], strict=True):
        for left, right in zip(edges[1][::2], edges[1][1::2], strict=True):
            kind, inside = rng.random(), free[top:bottom, left:right]
            if kind < 0.15:
                inside[:] = True
            elif kind < 0.4 and min(inside.shape) > 6:
                inside[2:-2, 2:-2] = True
                gate = int(rng.integers(2, inside.shape[1] - 3))
                inside[:2, gate : gate + 2] = True
    if rng.random() < 0.3:
        free = ndimage.rotate(free.astype(np.uint8), rng.uniform(0, 45), reshape=False, order=0) > 0
    return free


def draw_dungeon(rng: np.random.Generator, side: int) -> Free:
    """A dungeon: rooms at random positions, linked by L-shaped passages, with some loops."""
    free = np.zeros((side, side), bool)
    largest, wide = int(rng.integers(6, 20)), int(rng.integers(1, 4))
    middles: list[np.ndarray] = []

    def link(one: np.ndarray, other: np.ndarray) -> None:
        (row, column), (last_row, last_column) = (one, other) if rng.random() < 0.5 else (other, one)
        first, last = sorted((column, last_column))
        free[row : row + wide, first : last + wide] = True
        first, last = sorted((row, last_row))
        free[first : last + wide, last_column : last_column + wide] = True

    for _ in range(int(rng.integers(6, 16) * (side / 50) ** 1.5)):
        size = rng.integers(3, largest, size=2)
        corner = rng.integers(1, side - size - 1)
        free[corner[0] : corner[0] + size[0], corner[1] : corner[1] + size[1]] = True
        middle = corner + size // 2
        if middles:
            nearest = min(middles, key=lambda there: int(np.abs(there - middle).sum()))
            link(middle, nearest if rng.random() < 0.8 else middles[int(rng.integers(len(middles)))])
        middles.append(middle)
    for _ in range(int(rng.integers(0, len(middles) // 2 + 1))):
        link(*(middles[number] for number in rng.integers(len(middles), size=2)))
    return free


#: Functions that draw each kind of map: `(random numbers, side) ->` free cells.
KINDS: dict[str, Callable[[np.random.Generator, int], Free]] = {
    "mazes": _enlarged(draw_maze),
    "halls": _enlarged(draw_hall),
    "offices": _enlarged(draw_office),
    "rooms": draw_rooms,
    "caves": draw_cave,
    "land": draw_land,
    "blocks": draw_blocks,
    "dungeons": draw_dungeon,
}


def _as_a_robot_maps_it(free: Free, rng: np.random.Generator) -> Free:
    """The map; in one of four cases with specks or frayed walls."""
    kind = rng.random()
    if kind < 0.15:
        return free & (rng.random(free.shape) > rng.uniform(0.005, 0.04))
    if kind < 0.25:
        return free | ndimage.binary_dilation(free) & (rng.random(free.shape) < 0.15)
    return free


def draw_map(kind: str, seed: tuple[int, ...], side: int) -> Free:
    """The largest connected piece of free cells of a map. One map in four fills only part of the square.

    Args:
      kind: one of `KINDS`.
      seed: numbers that the map depends on.
      side: cells a side.
    """
    rng = np.random.default_rng(seed)
    while True:
        free = _as_a_robot_maps_it(KINDS[kind](rng, side), rng)
        if rng.random() < 0.25:
            part = int(rng.integers(side // 2, side))
            free = np.pad(free[:part, :part], (0, side - part))
            free = np.roll(free, rng.integers(0, side - part + 1, size=2), axis=(0, 1))
        piece = largest_piece(free)
        if piece.sum() >= _LEAST_FREE * free.size:
            return piece


def plain_training_maps(count: int, seed: int, side: int) -> list[ClassImage]:
    """`count` maps of free and occupied cells, of all kinds in turn; uint8 [side side] each."""
    kinds = list(KINDS)
    drawn = (draw_map(kinds[number % len(kinds)], (seed, side, number), side) for number in range(count))
    return [np.where(free, np.uint8(FREE), np.uint8(OCCUPIED)) for free in drawn]
