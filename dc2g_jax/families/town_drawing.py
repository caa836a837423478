"""Towns as a newcomer draws them: large, sparse maps of rectangles, on which most walkways lead to no door.

Streets cross a town or end in it. Along them stand houses with walkways and driveways, of which one to three have a
front door, and between the houses lie parks, parking lots, squares and blocks. All is drawn on the grid itself.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dc2g_jax.datasets import PROCEDURAL, House, HouseDataset, sampled
from dc2g_jax.families.procedural.drawing import Range, first_usable, uniform
from dc2g_jax.grid import (
    BUSH,
    CAR,
    DRIVEWAY,
    FENCE,
    FREE,
    FRONT_DOOR,
    GRASS,
    HOUSE,
    PATH,
    ROAD,
    SIDEWALK,
    TRAVERSABLE,
    TREE,
    ClassImage,
    connected_to,
)

#: Columns and rows of the towns. They are few, since a planner is compiled for each.
TOWN_SIZES = ((60, 60), (90, 60), (100, 75), (120, 120), (150, 100), (200, 150), (240, 180), (300, 225))

#: Cells to a meter, and the least length of a side in meters. The published houses have about 0.8 cells to a meter.
_SCALES, _SHORTEST_SIDE = (0.5, 0.7, 1.0, 1.4, 2.0), 60

#: Largest number of houses with a front door.
_MOST_DOORS = 3


@dataclass(frozen=True)
class _Side:
    """One side of a street, in meters. Points beside it are given along the street and outward from its edge.

    Attributes:
      upright: whether the street runs from north to south.
      middle: place of its middle line across its direction.
      half: half its width with its sidewalks.
      length: where it begins and ends along its direction.
      outward: 1 for the right or lower side, -1 for the other.
    """

    upright: bool
    middle: float
    half: float
    length: Range
    outward: int

    def rectangle(self, along: Range, out: Range) -> tuple[Range, Range]:
        """Columns and rows, in meters, of a rectangle beside the street."""
        one, other = sorted(self.middle + self.outward * (self.half + limit) for limit in out)
        return ((one, other), along) if self.upright else (along, (one, other))


@dataclass(frozen=True)
class _Sketch:
    """An unfinished town.

    Attributes:
      rng: random numbers.
      scale: cells to a meter.
      grid: class indices, uint8 [rows columns].
    """

    rng: np.random.Generator
    scale: float
    grid: ClassImage

    def part(self, columns: Range, rows: Range) -> ClassImage:
        """A view of the cells of a rectangle in meters: at least one each way, unless it lies off the map."""
        bounds = ((round(low * self.scale), round(high * self.scale)) for low, high in (rows, columns))
        return self.grid[tuple(slice(max(low, 0), max(high, low + 1, 0)) for low, high in bounds)]

    def fill(self, rectangle: tuple[Range, Range], terrain: int, over: Iterable[int] = (GRASS,)) -> None:
        """Fill the cells of a rectangle that are of some classes."""
        part = self.part(*rectangle)
        part[np.isin(part, list(over))] = terrain

    def is_free(self, rectangle: tuple[Range, Range]) -> bool:
        """Whether a rectangle lies on the map and is nothing but grass."""
        rows, columns = (length / self.scale for length in self.grid.shape)
        inside = all(low >= 0 and high <= most for (low, high), most in zip(rectangle, (columns, rows), strict=True))
        return inside and bool(np.all(self.part(*rectangle) == GRASS))


def _draw_streets(sketch: _Sketch) -> list[_Side]:
    """Draw the streets, and list their sides. One each way crosses the whole town; dead ends begin or end beside it."""
    rng = sketch.rng
    height, width = (length / sketch.scale for length in sketch.grid.shape)
    spacing = uniform(rng, (40, 120))
    middles = []
    for length in (height, width):
        count = max(1, round(length / spacing))
        middles.append(rng.permutation((np.arange(count) + rng.uniform(0.2, 0.8, count)) * length / count).tolist())
    road, sidewalk = uniform(rng, (4, 8)), float(rng.choice([0.0, 1.0, 2.0]))
    sides = []
    for upright, length in ((False, width), (True, height)):
        crossing = middles[1 - upright][0]
        for number, middle in enumerate(middles[upright]):
            begin, end = 0.0, length
            if number and rng.random() < 0.5:
                begin, end = rng.uniform(0, crossing), rng.uniform(crossing, length)
                begin, end = ((begin, crossing), (crossing, end), (begin, end))[rng.integers(3)]
            for outward in (-1, 1):
                sides.append(_Side(upright, middle, road / 2 + sidewalk, (begin, end), outward))
    for inner, terrain, over in ((0.0, SIDEWALK, (GRASS,)), (sidewalk, ROAD, (GRASS, SIDEWALK))):
        for side in sides:
            sketch.fill(side.rectangle(side.length, (-side.half, -inner)), terrain, over)
    return sides


def _draw_house(sketch: _Sketch, side: _Side) -> tuple[Range, Range] | None:
    """Draw a house with a walkway or without, and return where its door could be; `None` if there is no place for it.

    The walkway leads to the front, or around a corner to a side of the house.
    """
    rng = sketch.rng
    wide, deep, setback = uniform(rng, (7, 16)), uniform(rng, (7, 13)), uniform(rng, (3, 18))
    left = uniform(rng, side.length)
    right, back = left + wide, setback + deep
    if not sketch.is_free(side.rectangle((left - 4, right + 4), (0.5, back + 1))):
        return None
    sketch.fill(side.rectangle((left, right), (setback, back)), HOUSE)
    if rng.random() < 0.4:
        drive = rng.choice([left, right - 3])
        sketch.fill(side.rectangle((drive, drive + 3), (-0.5, setback)), DRIVEWAY, (GRASS, SIDEWALK))
        if rng.random() < 0.4:
            sketch.fill(side.rectangle((drive + 0.5, drive + 2.5), (setback - 5, setback - 1)), CAR, (DRIVEWAY,))
    walk = uniform(rng, (1, 2))
    if rng.random() < 0.7:
        begin = uniform(rng, (left + 1, right - walk - 1))
        door = side.rectangle((begin, begin + walk), (setback, setback + 1 / sketch.scale))
        sketch.fill(side.rectangle((begin, begin + walk), (-0.5, setback)), PATH)
    else:
        turn = uniform(rng, (setback + 1, back - walk - 1))
        door = side.rectangle((right - 1 / sketch.scale, right), (turn, turn + walk))
        sketch.fill(side.rectangle((right + 1, right + 1 + walk), (-0.5, turn + walk)), PATH)
        sketch.fill(side.rectangle((right, right + 1 + walk), (turn, turn + walk)), PATH)
    return door


def _draw_walkway(sketch: _Sketch, side: _Side) -> None:
    """A walkway that ends in the grass, straight or around a corner."""
    rng = sketch.rng
    begin, walk, out = uniform(rng, side.length), uniform(rng, (1, 2)), uniform(rng, (4, 30))
    across = rng.choice([0.0, uniform(rng, (-20, 20))])
    terrain = int(rng.choice([PATH, PATH, FREE, SIDEWALK]))
    sketch.fill(side.rectangle((begin, begin + walk), (-0.5, out)), terrain)
    sketch.fill(
        side.rectangle((min(begin, begin + across), max(begin, begin + across) + walk), (out - walk, out)), terrain
    )


def _draw_ground(sketch: _Sketch, side: _Side) -> None:
    """A park with paths, a parking lot, a square or a block of buildings."""
    rng = sketch.rng
    long, deep = uniform(rng, (15, 60)), uniform(rng, (12, 40))
    left = uniform(rng, side.length)
    if not sketch.is_free(side.rectangle((left, left + long), (0.5, deep))):
        return
    whole = side.rectangle((left, left + long), (0, deep))
    kind = rng.choice(["park", "park", "parking", "square", "block"])
    if kind == "park":
        terrain, walk = int(rng.choice([PATH, FREE, SIDEWALK])), uniform(rng, (1, 2.5))
        for entrance in rng.uniform(left, left + long - walk, rng.integers(1, 4)):
            sketch.fill(side.rectangle((entrance, entrance + walk), (-0.5, uniform(rng, (deep / 2, deep)))), terrain)
        for row in rng.uniform(2, deep - walk, rng.integers(1, 4)):
            ends = sorted(rng.uniform(left, left + long, 2))
            sketch.fill(side.rectangle((ends[0], ends[1]), (row, row + walk)), terrain)
        sketch.fill(whole, int(rng.choice([GRASS, TREE, BUSH])))
    elif kind == "parking":
        sketch.fill(side.rectangle((left, left + long), (3, deep)), DRIVEWAY)
        sketch.fill(side.rectangle((left + long / 2, left + long / 2 + 5), (-0.5, 3)), DRIVEWAY, (GRASS, SIDEWALK))
        for row in np.arange(6, deep - 5, 12):
            sketch.fill(side.rectangle((left + 4, left + long - 4), (row, row + 4)), CAR, (DRIVEWAY,))
    elif kind == "square":
        sketch.fill(side.rectangle((left, left + long), (-0.5, deep)), FREE)
        sketch.fill(side.rectangle((left + long / 3, left + long / 2), (deep / 3, 2 * deep / 3)), HOUSE, (FREE,))
    else:
        sketch.fill(whole, HOUSE)


def _scatter(sketch: _Sketch) -> None:
    rng = sketch.rng
    height, width = (length / sketch.scale for length in sketch.grid.shape)
    for _ in range(rng.integers(0, 10 + int(width * height / 400))):
        x, y = uniform(rng, (0, width)), uniform(rng, (0, height))
        terrain = int(rng.choice([TREE, TREE, BUSH, FENCE]))
        across, down = (1, uniform(rng, (4, 25))) if terrain == FENCE else (uniform(rng, (1, 4)), uniform(rng, (1, 4)))
        if rng.random() < 0.5:
            across, down = down, across
        sketch.fill(((x, x + across), (y, y + down)), terrain)


def _draw(rng: np.random.Generator, columns: int, rows: int) -> ClassImage | None:
    """A town; `None` if it has no house with a walkway, or a door that cannot be reached from the streets."""
    scales = [scale for scale in _SCALES if min(columns, rows) / scale >= _SHORTEST_SIDE]
    sketch = _Sketch(rng, float(rng.choice(scales)), np.full((rows, columns), GRASS, np.uint8))
    sides = _draw_streets(sketch)
    area = columns * rows / sketch.scale**2

    def some(least: int, square_meters: int) -> Iterable[_Side]:
        """Random sides of streets, with a number up to one more for so much area."""
        count = round(np.exp(uniform(rng, (np.log(least), np.log(least + area / square_meters)))))
        return (sides[number] for number in rng.integers(len(sides), size=count))

    for side in some(3, 2500):
        _draw_ground(sketch, side)
    doors = [door for side in some(12, 400) if (door := _draw_house(sketch, side)) is not None]
    for side in some(3, 3000):
        _draw_walkway(sketch, side)
    _scatter(sketch)
    if not doors:
        return None
    count = min(len(doors), int(rng.integers(1, _MOST_DOORS + 1)))
    for number in rng.permutation(len(doors))[:count]:
        sketch.part(*doors[number])[:] = FRONT_DOOR
    from_streets = connected_to(sketch.grid == ROAD, TRAVERSABLE[sketch.grid])
    return sketch.grid if np.all(from_streets[sketch.grid == FRONT_DOOR]) else None


def draw_town(seed: int, columns: int, rows: int) -> ClassImage:
    """Draw a town. It depends only on the arguments.

    Args:
        seed: a non-negative integer.
        columns: columns of the grid, at least 60.
        rows: rows of the grid, at least 60.

    Returns:
        Class indices, uint8 [rows columns]. Each front door can be reached from all streets.

    Raises:
        ValueError: if the seed is negative, or the grid is too small.
        RuntimeError: if 100 drawings in a row turn out unusable.
    """
    if seed < 0 or min(columns, rows) < _SHORTEST_SIDE:
        raise ValueError(f"seed {seed} and {columns} x {rows} cells; give a seed of at least 0 and 60 cells each way")
    return first_usable(lambda rng: _draw(rng, columns, rows), seed, (), f"town of {columns} x {rows} cells")


def towns(**_: object) -> HouseDataset:
    """All towns, each on its own grid, whatever grid and split are asked for."""
    return _towns()


@functools.cache
def _towns() -> HouseDataset:
    """100 towns to choose on, and 100 that are kept aside. Their sizes take turns."""
    houses = []
    for number, split in enumerate(["val"] * 100 + ["test"] * 100):
        town = draw_town(number, *TOWN_SIZES[number % len(TOWN_SIZES)])
        houses.append(House(f"t{number:03d}", split, sampled(f"t{number:03d}", town, None)))
    return HouseDataset("towns", PROCEDURAL, tuple(houses))
