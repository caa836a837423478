"""The three suburban neighborhoods: lots along streets, seen from above around one of them."""

import numpy as np

from dc2g_jax._src.grid.sampling import ClassImage
from dc2g_jax._src.procedural._streets import Curb, Sidewalks, Streets, lay_streets, wander
from dc2g_jax._src.procedural.drawing import (
    PictureFrame,
    Placement,
    Polygons,
    Sketch,
    choose,
    random_turn,
    rectangle,
    traveled,
    uniform,
    view_around,
)
from dc2g_jax._src.procedural.lots import Lot, Suburb, build_lot, car

#: Side of a single house's map in cells, and side of a cell of a larger map in pixels.
_HOUSE_CELLS, _PIXELS_A_CELL = 50, 4

#: Distance of the farthest neighbor of the main lot, meters.
_REACH = 75.0

#: Kinds of streets for rows of houses, with weights.
_THROUGH = {"straight": 0.5, "fork": 0.5}


SUBURBS = {
    "suburb_sidewalks": Suburb(
        lot_width=(15, 22),
        setback=(6, 13),
        house_width=(12, 19),
        house_depth=(8, 14),
        turn=0.06,
        driveways={"front": 0.86, "winding": 0.06, "side": 0.08},
        driveway_width=(3.5, 5.0),
        cars=0.3,
        second_door=0.04,
        streets={"straight": 0.42, "curved": 0.16, "circle": 0.34, "knuckle": 0.04, "tee": 0.04},
        road_width=(7.5, 11),
        sidewalks=0.6,
        verge=(0.6, 3.0),
        street_cars=0.2,
        neighbors=0.9,
        margins=(0.5, 7),
        beyond_road=(-7.5, 6),
        extra_width=(0, 3),
        pixels_per_meter=(7.5, 11),
    ),
    "large_lots": Suburb(
        lot_width=(38, 60),
        setback=(16, 42),
        house_width=(15, 24),
        house_depth=(9, 15),
        turn=0.45,
        driveways={"winding": 0.72, "horseshoe": 0.18, "front": 0.1},
        driveway_width=(3.2, 5.0),
        cars=0.22,
        second_door=0.16,
        streets={"straight": 0.25, "curved": 0.33, "circle": 0.22, "fork": 0.08, "tee": 0.08, "knuckle": 0.04},
        road_width=(6, 9.5),
        sidewalks=0.0,
        verge=(0, 1),
        street_cars=0.05,
        neighbors=0.7,
        margins=(1.5, 12),
        beyond_road=(-4, 7),
        extra_width=(0, 8),
        pixels_per_meter=(8, 13),
    ),
    "compact_suburb": Suburb(
        lot_width=(13, 20),
        setback=(4, 12),
        house_width=(10, 16),
        house_depth=(8, 14),
        turn=0.05,
        driveways={"front": 0.72, "side": 0.24, "winding": 0.04},
        driveway_width=(3.0, 4.5),
        cars=0.45,
        second_door=0.08,
        streets={
            "straight": 0.16,
            "curved": 0.16,
            "circle": 0.2,
            "tee": 0.16,
            "corner": 0.16,
            "crossing": 0.1,
            "knuckle": 0.06,
        },
        road_width=(7, 11),
        sidewalks=0.9,
        verge=(0.0, 2.5),
        street_cars=0.5,
        neighbors=0.95,
        margins=(1, 9),
        beyond_road=(-3, 16),
        extra_width=(0, 14),
        pixels_per_meter=(8, 13),
    ),
}


def draw_suburb(rng: np.random.Generator, suburb: Suburb) -> ClassImage | None:
    """Draw the surroundings of one house: class indices, uint8 [H W]; None if the house does not fit."""
    lot_width = uniform(rng, suburb.lot_width)
    streets = lay_streets(rng, suburb.streets, suburb.road_width, lot_width)
    sidewalks = _choose_sidewalks(rng, suburb)
    lot = build_lot(rng, suburb, streets.curbs[0], sidewalks is not None)
    sketch = Sketch(_view(rng, suburb, streets, lot))
    streets.draw(sketch, sidewalks, rng)
    if not _fits(sketch, lot.shapes):
        return None
    sketch.add_all(lot.shapes)
    for curb in _lots_along(rng, streets, lot_width):
        neighbor = build_lot(rng, suburb, curb, sidewalks is not None)
        clear = sketch.overlap(sketch.mask(neighbor.shapes["driveway"]), "driveway") < 0.05
        if clear and rng.random() < suburb.neighbors and _fits(sketch, neighbor.shapes):
            sketch.add_all(neighbor.shapes)
    if rng.random() < suburb.street_cars:
        sketch.add_clear("car", _street_cars(rng, streets))
    return sketch.classes()


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
    sidewalks = _choose_sidewalks(rng, suburb)
    lot = build_lot(rng, suburb, streets.curbs[0], sidewalks is not None)
    view = _widened(_view(rng, suburb, streets, lot), cells)
    _add_side_streets(rng, streets, 2 * lot_width, view.width / view.scale)
    sketch = Sketch(view)
    streets.draw(sketch, sidewalks, rng)
    lots = []
    for curb in _all_along(rng, streets, lot_width):
        lot = build_lot(rng, suburb, curb, sidewalks is not None)
        driveway, house = (sketch.mask(lot.shapes[layer]) for layer in ("driveway", "house"))
        clear = house.any() and sketch.overlap(driveway, "driveway") < 0.05
        if clear and rng.random() < suburb.neighbors and _fits(sketch, lot.shapes):
            sketch.add_all({layer: shape for layer, shape in lot.shapes.items() if layer != "door"})
            lots.append(lot)
    for number in rng.permutation(len(lots))[:doors]:
        sketch.add("door", lots[number].shapes["door"])
    if rng.random() < suburb.street_cars:
        sketch.add_clear("car", _street_cars(rng, streets))
    return sketch.classes()


def _widened(view: PictureFrame, cells: int) -> PictureFrame:
    """A square around the middle of a view, with cells as large as those of the view on a 50 x 50 grid."""
    sides = np.array([view.width, view.height]) / view.scale
    cell = float(np.sqrt(sides.prod())) / _HOUSE_CELLS
    corner = view.corner + (sides - cells * cell) / 2
    return PictureFrame(view.angle, corner, _PIXELS_A_CELL / cell, cells * _PIXELS_A_CELL, cells * _PIXELS_A_CELL)


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


def _choose_sidewalks(rng: np.random.Generator, suburb: Suburb) -> Sidewalks | None:
    if rng.random() >= suburb.sidewalks:
        return None
    sides = choose(rng, {"both": 0.75, "left": 0.15, "right": 0.1})
    return Sidewalks(
        verge=uniform(rng, suburb.verge),
        width=uniform(rng, (1.1, 2.0)),
        left=sides != "right",
        right=sides != "left",
        over_driveways=bool(rng.random() < 0.12),
    )


def _view(rng: np.random.Generator, suburb: Suburb, streets: Streets, lot: Lot) -> PictureFrame:
    """The frame of a picture around one lot, some or all of the road in front, sometimes more beside it."""
    curb = streets.curbs[0].at(0.0)
    depth = 2 * float(streets.roads[0][1].mean()) + uniform(rng, suburb.beyond_road)
    left, right = rng.uniform(*suburb.extra_width, 2)
    shown = [*lot.essentials, curb.place(rectangle(-left, -max(depth, 3.0), right, 0.0))]
    return view_around(rng, shown, random_turn(rng, 0.5, 0.07), suburb.margins, suburb.pixels_per_meter)


def _fits(sketch: Sketch, shapes: dict[str, Polygons]) -> bool:
    """Whether a lot fits: its house is clear of roads, driveways and houses, and its driveway is clear of houses."""
    house, driveway = sketch.mask(shapes["house"]), sketch.mask(shapes["driveway"])
    if sketch.overlap(house, "road", "driveway", "house", "pavement", "pavement_over_driveway", "path") > 0:
        return False
    covered = int(np.count_nonzero(house & driveway)) / max(int(np.count_nonzero(driveway)), 1)
    return covered < 0.18 and sketch.overlap(driveway, "house", "door") == 0


def _lots_along(rng: np.random.Generator, streets: Streets, lot_width: float) -> list[Curb]:
    """Places for neighbors: about every lot width along all curbs near the main lot, nearest first."""
    main = streets.curbs[0]
    center = main.at(0.0).origin
    places = []
    for curb in streets.curbs:
        first = 0.0 if curb is main else uniform(rng, (0, lot_width))
        for count in range(-6, 7):
            moved = Curb(curb.line, curb.position + first + count * lot_width * uniform(rng, (0.9, 1.15)))
            distance = float(np.hypot(*(moved.at(0.0).origin - center)))
            if distance < _REACH and not (curb is main and count == 0):
                places.append((distance, moved))
    return [curb for _, curb in sorted(places, key=lambda place: place[0])]


def _street_cars(rng: np.random.Generator, streets: Streets) -> Polygons:
    """Cars parked along the curbs, a few on each."""
    cars = []
    for curb in streets.curbs:
        for _ in range(int(rng.integers(0, 4))):
            frame: Placement = curb.at(rng.normal(0, 18))
            cars.append(car(rng, frame.place((0.0, -uniform(rng, (1.2, 1.8)))), frame.angle + rng.normal(0, 0.05)))
    return cars
