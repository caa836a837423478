"""The three suburban neighborhoods: lots along streets, seen from above around one of them."""

from typing import Any

import numpy as np

from dc2g_jax.families.procedural._streets import Curb, Sidewalks, Streets, lay_streets
from dc2g_jax.families.procedural.drawing import (
    PictureFrame,
    Placement,
    Polygons,
    Sketch,
    choose,
    random_turn,
    rectangle,
    uniform,
    view_around,
)
from dc2g_jax.families.procedural.lots import Lot, Suburb, build_lot, car
from dc2g_jax.grid import ClassImage

#: Distance of the farthest neighbor of the main lot, meters.
_REACH = 75.0

#: Style of each suburb: a row for each of the attributes of `Suburb`.
_STYLES = ("suburb_sidewalks", "large_lots", "compact_suburb")
_TABLE: dict[str, tuple[Any, Any, Any]] = {
    "lot_width": ((15, 22), (38, 60), (13, 20)),
    "setback": ((6, 13), (16, 42), (4, 12)),
    "house_width": ((12, 19), (15, 24), (10, 16)),
    "house_depth": ((8, 14), (9, 15), (8, 14)),
    "turn": (0.06, 0.45, 0.05),
    "driveways": (
        {"front": 0.86, "winding": 0.06, "side": 0.08},
        {"winding": 0.72, "horseshoe": 0.18, "front": 0.1},
        {"front": 0.72, "side": 0.24, "winding": 0.04},
    ),
    "driveway_width": ((3.5, 5.0), (3.2, 5.0), (3.0, 4.5)),
    "cars": (0.3, 0.22, 0.45),
    "second_door": (0.04, 0.16, 0.08),
    "streets": (
        {"straight": 0.42, "curved": 0.16, "circle": 0.34, "knuckle": 0.04, "tee": 0.04},
        {"straight": 0.25, "curved": 0.33, "circle": 0.22, "fork": 0.08, "tee": 0.08, "knuckle": 0.04},
        {
            "straight": 0.16,
            "curved": 0.16,
            "circle": 0.2,
            "tee": 0.16,
            "corner": 0.16,
            "crossing": 0.1,
            "knuckle": 0.06,
        },
    ),
    "road_width": ((7.5, 11), (6, 9.5), (7, 11)),
    "sidewalks": (0.6, 0.0, 0.9),
    "verge": ((0.6, 3.0), (0, 1), (0.0, 2.5)),
    "street_cars": (0.2, 0.05, 0.5),
    "neighbors": (0.9, 0.7, 0.95),
    "margins": ((0.5, 7), (1.5, 12), (1, 9)),
    "beyond_road": ((-7.5, 6), (-4, 7), (-3, 16)),
    "extra_width": ((0, 3), (0, 8), (0, 14)),
    "pixels_per_meter": ((7.5, 11), (8, 13), (8, 13)),
}
SUBURBS = {
    style: Suburb(**{name: values[number] for name, values in _TABLE.items()}) for number, style in enumerate(_STYLES)
}


def draw_suburb(rng: np.random.Generator, suburb: Suburb) -> ClassImage | None:
    """Draw the surroundings of one house: class indices, uint8 [H W]; None if the house does not fit."""
    lot_width = uniform(rng, suburb.lot_width)
    streets = lay_streets(rng, suburb.streets, suburb.road_width, lot_width)
    sidewalks = choose_sidewalks(rng, suburb)
    lot = build_lot(rng, suburb, streets.curbs[0], sidewalks is not None)
    sketch = Sketch(view(rng, suburb, streets, lot))
    streets.draw(sketch, sidewalks, rng)
    if not fits(sketch, lot.shapes):
        return None
    sketch.add_all(lot.shapes)
    for curb in _lots_along(rng, streets, lot_width):
        neighbor = build_lot(rng, suburb, curb, sidewalks is not None)
        clear = sketch.overlap(sketch.mask(neighbor.shapes["driveway"]), "driveway") < 0.05
        if clear and rng.random() < suburb.neighbors and fits(sketch, neighbor.shapes):
            sketch.add_all(neighbor.shapes)
    if rng.random() < suburb.street_cars:
        sketch.add_clear("car", street_cars(rng, streets))
    return sketch.classes()


def choose_sidewalks(rng: np.random.Generator, suburb: Suburb) -> Sidewalks | None:
    """Sidewalks on one side or both, in a share of the streets."""
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


def view(rng: np.random.Generator, suburb: Suburb, streets: Streets, lot: Lot) -> PictureFrame:
    """The frame of a picture around one lot, some or all of the road in front, sometimes more beside it."""
    curb = streets.curbs[0].at(0.0)
    depth = 2 * float(streets.roads[0][1].mean()) + uniform(rng, suburb.beyond_road)
    left, right = rng.uniform(*suburb.extra_width, 2)
    shown = [*lot.essentials, curb.place(rectangle(-left, -max(depth, 3.0), right, 0.0))]
    return view_around(rng, shown, random_turn(rng, 0.5, 0.07), suburb.margins, suburb.pixels_per_meter)


def fits(sketch: Sketch, shapes: dict[str, Polygons]) -> bool:
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


def street_cars(rng: np.random.Generator, streets: Streets) -> Polygons:
    """Cars parked along the curbs, a few on each."""
    cars = []
    for curb in streets.curbs:
        for _ in range(int(rng.integers(0, 4))):
            frame: Placement = curb.at(rng.normal(0, 18))
            cars.append(car(rng, frame.place((0.0, -uniform(rng, (1.2, 1.8)))), frame.angle + rng.normal(0, 0.05)))
    return cars
