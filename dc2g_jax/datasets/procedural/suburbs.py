"""The three suburban neighbourhoods: lots along streets, seen from above around one of them."""

from dataclasses import dataclass

import numpy as np

from dc2g_jax.datasets.procedural.drawing import Frame, Range, Shape, Sketch, choose, rectangle, uniform, view_around
from dc2g_jax.datasets.procedural.lots import LotStyle, build_lot, car
from dc2g_jax.datasets.procedural.streets import Kerb, Sidewalks, Streets, lay_streets
from dc2g_jax.grid.sampling import ClassImage


@dataclass(frozen=True)
class Suburb:
    """What a suburb is like: its lots, its streets, and how much of it a picture shows (ranges in metres)."""

    lots: LotStyle
    streets: dict[str, float]
    road_width: Range
    sidewalks: float
    verge: Range
    street_cars: float
    neighbours: float
    margins: Range
    beyond_road: Range
    extra_width: Range
    pixels_per_metre: Range


SUBURBS = {
    "suburb_sidewalks": Suburb(
        lots=LotStyle(
            width=(15, 22),
            setback=(6, 13),
            house_width=(12, 19),
            house_depth=(8, 14),
            turn=0.06,
            driveways={"front": 0.86, "winding": 0.06, "side": 0.08},
            driveway_width=(3.5, 5.0),
            cars=0.3,
            second_door=0.04,
        ),
        streets={"straight": 0.42, "curved": 0.16, "circle": 0.34, "knuckle": 0.04, "tee": 0.04},
        road_width=(7.5, 11),
        sidewalks=0.6,
        verge=(0.6, 3.0),
        street_cars=0.2,
        neighbours=0.9,
        margins=(0.5, 7),
        beyond_road=(-7.5, 6),
        extra_width=(0, 3),
        pixels_per_metre=(7.5, 11),
    ),
    "large_lots": Suburb(
        lots=LotStyle(
            width=(38, 60),
            setback=(16, 42),
            house_width=(15, 24),
            house_depth=(9, 15),
            turn=0.45,
            driveways={"winding": 0.72, "horseshoe": 0.18, "front": 0.1},
            driveway_width=(3.2, 5.0),
            cars=0.22,
            second_door=0.16,
        ),
        streets={
            "straight": 0.25,
            "curved": 0.33,
            "circle": 0.22,
            "fork": 0.08,
            "tee": 0.08,
            "knuckle": 0.04,
        },
        road_width=(6, 9.5),
        sidewalks=0.0,
        verge=(0, 1),
        street_cars=0.05,
        neighbours=0.7,
        margins=(1.5, 12),
        beyond_road=(-4, 7),
        extra_width=(0, 8),
        pixels_per_metre=(8, 13),
    ),
    "compact_suburb": Suburb(
        lots=LotStyle(
            width=(13, 20),
            setback=(4, 12),
            house_width=(10, 16),
            house_depth=(8, 14),
            turn=0.05,
            driveways={"front": 0.72, "side": 0.24, "winding": 0.04},
            driveway_width=(3.0, 4.5),
            cars=0.45,
            second_door=0.08,
        ),
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
        neighbours=0.95,
        margins=(1, 9),
        beyond_road=(-3, 16),
        extra_width=(0, 14),
        pixels_per_metre=(8, 13),
    ),
}


def draw_suburb(rng: np.random.Generator, suburb: Suburb) -> ClassImage | None:
    """One picture around one house, uint8 [H W] of class indices; None where the house does not fit."""
    lot_width = uniform(rng, suburb.lots.width)
    streets = lay_streets(rng, suburb.streets, suburb.road_width, lot_width)
    sidewalks = _choose_sidewalks(rng, suburb)
    lot = build_lot(rng, suburb.lots, streets.kerbs[0], sidewalks is not None)
    sketch = Sketch(
        view_around(
            rng,
            _framing(rng, suburb, streets, lot.essentials),
            _turn(rng),
            suburb.margins,
            suburb.pixels_per_metre,
        )
    )
    streets.draw(sketch, sidewalks, rng)
    if not _fits(sketch, lot.shapes):
        return None
    sketch.add_all(lot.shapes)
    for kerb in _lots_along(rng, streets, lot_width):
        neighbour = build_lot(rng, suburb.lots, kerb, sidewalks is not None)
        clear = sketch.overlap(sketch.mask(neighbour.shapes["driveway"]), "driveway") < 0.05
        if clear and rng.random() < suburb.neighbours and _fits(sketch, neighbour.shapes):
            sketch.add_all(neighbour.shapes)
    if rng.random() < suburb.street_cars:
        sketch.add_clear("car", _street_cars(rng, streets))
    return sketch.classes()


def _turn(rng: np.random.Generator) -> float:
    """How the picture is turned, radians: often nearly square to the street, else any angle."""
    if rng.random() < 0.5:
        return float(rng.integers(4)) * np.pi / 2 + rng.normal(0, 0.07)
    return uniform(rng, (0, 2 * np.pi))


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


def _framing(rng: np.random.Generator, suburb: Suburb, streets: Streets, essentials: Shape) -> Shape:
    """What the picture has to hold: the lot, some or all of the road before it, perhaps more beside it."""
    kerb = streets.kerbs[0].at(0.0)
    depth = 2 * float(streets.roads[0][1].mean()) + uniform(rng, suburb.beyond_road)
    left, right = rng.uniform(*suburb.extra_width, 2)
    return [*essentials, kerb.place(rectangle(-left, -max(depth, 3.0), right, 0.0))]


def _fits(sketch: Sketch, shapes: dict[str, Shape]) -> bool:
    """May a lot be drawn: its house clear of roads, driveways and houses, its driveway clear of houses?"""
    house, driveway = sketch.mask(shapes["house"]), sketch.mask(shapes["driveway"])
    if sketch.overlap(house, "road", "driveway", "house", "pavement", "pavement_over_driveway", "path") > 0:
        return False
    covered = int(np.count_nonzero(house & driveway)) / max(int(np.count_nonzero(driveway)), 1)
    return covered < 0.18 and sketch.overlap(driveway, "house", "door") == 0


def _lots_along(rng: np.random.Generator, streets: Streets, lot_width: float, reach: float = 75.0) -> list[Kerb]:
    """Places for neighbours: about every lot width along all kerbs near the main lot, nearest first."""
    main = streets.kerbs[0]
    center = main.at(0.0).origin
    places = []
    for kerb in streets.kerbs:
        first = 0.0 if kerb is main else uniform(rng, (0, lot_width))
        for count in range(-6, 7):
            moved = Kerb(kerb.line, kerb.position + first + count * lot_width * uniform(rng, (0.9, 1.15)))
            distance = float(np.hypot(*(moved.at(0.0).origin - center)))
            if distance < reach and not (kerb is main and count == 0):
                places.append((distance, moved))
    return [kerb for _, kerb in sorted(places, key=lambda place: place[0])]


def _street_cars(rng: np.random.Generator, streets: Streets) -> Shape:
    """Cars that stand along the kerbs, a few on each."""
    cars = []
    for kerb in streets.kerbs:
        for _ in range(int(rng.integers(0, 4))):
            frame: Frame = kerb.at(rng.normal(0, 18))
            cars.append(car(rng, frame.place((0.0, -uniform(rng, (1.2, 1.8)))), frame.angle + rng.normal(0, 0.05)))
    return cars
