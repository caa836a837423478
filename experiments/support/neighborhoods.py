"""Maps of several houses in rows along streets, in the styles of the procedural suburbs."""

import numpy as np

from dc2g_jax._src.grid.sampling import ClassImage, sample_grid
from dc2g_jax._src.runtime.errors import check_name, check_number
from dc2g_jax.families.procedural import STYLES, is_usable
from dc2g_jax.families.procedural._streets import Curb, Streets, lay_streets, wander
from dc2g_jax.families.procedural.drawing import PictureFrame, Sketch, first_usable, traveled, uniform
from dc2g_jax.families.procedural.lots import Suburb, build_lot
from dc2g_jax.families.procedural.suburbs import SUBURBS, choose_sidewalks, fits, street_cars, view

#: Side of a single house's map in cells, and side of a cell of a larger map in pixels.
_HOUSE_CELLS, _PIXELS_A_CELL = 50, 4

#: Kinds of streets, with weights.
_THROUGH = {"straight": 0.5, "fork": 0.5}


def draw_neighborhood(seed: int, style: str, cells: int, doors: int) -> ClassImage:
    """Generate houses in rows along streets. The map depends only on the arguments.

    Args:
        seed: a non-negative integer.
        style: one of `SUBURBS`.
        cells: side of the grid, whose cells are as large as those of a single house's map. The streets are long enough
            for about 350 cells.
        doors: largest number of houses that have a front door.

    Returns:
        Class indices of the grid, uint8 [cells cells]; a front door can be reached from the road.

    Raises:
        InputError: if there is no such style, or a number is out of range.
        RuntimeError: if 100 drawings in a row turn out unusable.
    """
    check_name("style", style, SUBURBS)
    check_number("cells", cells, whole=True, least=50)
    check_number("doors", doors, whole=True, least=1)

    def draw(rng: np.random.Generator) -> ClassImage | None:
        classes = draw_row(rng, SUBURBS[style], cells, doors)
        return sample_grid(classes, cells) if is_usable(classes, cells=cells) else None

    return first_usable(draw, seed, (len(STYLES) + STYLES.index(style),), f"{style} neighborhood")


def draw_row(rng: np.random.Generator, suburb: Suburb, cells: int, doors: int) -> ClassImage:
    """Draw houses in rows along a street and its side streets: class indices of a square, uint8 [H W].

    Args:
        rng: random number generator.
        suburb: style of the houses and streets.
        cells: side of the grid of the image, whose cells are as large as those of a single house's 50 x 50 grid.
        doors: largest number of houses that have a front door; the walkways of the others end at a wall.
    """
    lot_width = uniform(rng, suburb.lot_width)
    streets = lay_streets(rng, _THROUGH, suburb.road_width, lot_width)
    sidewalks = choose_sidewalks(rng, suburb)
    lot = build_lot(rng, suburb, streets.curbs[0], sidewalks is not None)
    frame = _widened(view(rng, suburb, streets, lot), cells)
    _add_side_streets(rng, streets, 2 * lot_width, frame.width / frame.scale)
    sketch = Sketch(frame)
    streets.draw(sketch, sidewalks, rng)
    lots = []
    for curb in _all_along(rng, streets, lot_width):
        lot = build_lot(rng, suburb, curb, sidewalks is not None)
        driveway, house = (sketch.mask(lot.shapes[layer]) for layer in ("driveway", "house"))
        clear = house.any() and sketch.overlap(driveway, "driveway") < 0.05
        if clear and rng.random() < suburb.neighbors and fits(sketch, lot.shapes):
            sketch.add_all({layer: shape for layer, shape in lot.shapes.items() if layer != "door"})
            lots.append(lot)
    for number in rng.permutation(len(lots))[:doors]:
        sketch.add("door", lots[number].shapes["door"])
    if rng.random() < suburb.street_cars:
        sketch.add_clear("car", street_cars(rng, streets))
    return sketch.classes()


def _widened(frame: PictureFrame, cells: int) -> PictureFrame:
    """A square around the middle of a view, with cells as large as those of the view on a 50 x 50 grid."""
    sides = np.array([frame.width, frame.height]) / frame.scale
    cell = float(np.sqrt(sides.prod())) / _HOUSE_CELLS
    corner = frame.corner + (sides - cells * cell) / 2
    return PictureFrame(frame.angle, corner, _PIXELS_A_CELL / cell, cells * _PIXELS_A_CELL, cells * _PIXELS_A_CELL)


def _add_side_streets(rng: np.random.Generator, streets: Streets, apart: float, reach: float) -> None:
    """Add side streets on both sides of the first street, at least `apart` meters apart, up to `reach` along it."""
    main, half_widths = streets.roads[0]
    along = traveled(main) - traveled(main)[len(main) // 2]
    for side in (-1, 1):
        place = -reach / 2 + uniform(rng, (0, 2 * apart))
        while place < reach / 2:
            at = int(np.searchsorted(along, place))
            if 0 < at < len(main) - 1:
                ahead = main[at + 1] - main[at]
                heading = float(np.arctan2(ahead[1], ahead[0])) + side * np.pi / 2 * uniform(rng, (0.85, 1.15))
                half = float(half_widths.mean()) * uniform(rng, (0.75, 1.1))
                streets.add_road(wander(rng, heading, 0.25) + main[at], half)
            place += apart * uniform(rng, (1.0, 2.5))


def _all_along(rng: np.random.Generator, streets: Streets, lot_width: float) -> list[Curb]:
    """Places for houses along the whole length of all curbs."""
    places = []
    for curb in streets.curbs:
        position, end = uniform(rng, (0, lot_width)), float(traveled(curb.line)[-1])
        while position < end:
            places.append(Curb(curb.line, position))
            position += lot_width * uniform(rng, (0.9, 1.15))
    return places
