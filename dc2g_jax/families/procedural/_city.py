"""The urban neighborhood: apartment blocks along streets with wide sidewalks, seen from above."""

import collections
from collections.abc import Callable

import numpy as np

from dc2g_jax.families.procedural._streets import Curb, Sidewalks, Streets, lay_streets
from dc2g_jax.families.procedural.drawing import (
    PictureFrame,
    Placement,
    Polygons,
    Sketch,
    choose,
    jitter,
    left_normals,
    random_turn,
    rectangle,
    resample,
    smooth,
    stroke,
    traveled,
    uniform,
    view_around,
)
from dc2g_jax.families.procedural.lots import car
from dc2g_jax.grid import ClassImage

#: Layer -> shape in a building's frame: the sidewalk's inner edge is y = 0, the street toward negative y.
Building = dict[str, Polygons]

_STREETS = {"straight": 0.3, "curved": 0.08, "tee": 0.15, "corner": 0.25, "crossing": 0.22}


def draw_city(rng: np.random.Generator) -> ClassImage:
    """Draw the street front of one city block: class indices, uint8 [H W]."""
    streets = lay_streets(rng, _STREETS, (6.5, 13.0), uniform(rng, (30, 70)))
    sidewalks = Sidewalks(
        verge=float(rng.choice((0.0, uniform(rng, (0.5, 2.0))), p=(0.75, 0.25))),
        width=uniform(rng, (2.0, 5.0)),
        left=True,
        right=bool(rng.random() < 0.9),
        over_driveways=bool(rng.random() < 0.5),
    )
    margin = sidewalks.verge + sidewalks.width
    sketch = Sketch(_look(rng, streets, margin))
    streets.draw(sketch, sidewalks, rng)
    if sidewalks.verge > 0:
        sketch.add("path", _curb_crossings(rng, streets, sidewalks.verge))
    usual = {kind: weight * rng.gamma(0.7) for kind, weight in _WEIGHTS.items()}
    depth = uniform(rng, (22, 34))
    alleys = _add_alleys(rng, sketch, streets, margin + depth) if rng.random() < 0.35 else []
    for edge in streets.curbs:
        _line_with_buildings(rng, sketch, edge, margin, usual)
    for alley in alleys:
        _line_with_buildings(rng, sketch, alley, uniform(rng, (0.3, 3.0)), _BEHIND)
    behind = margin + uniform(rng, (13, 24))
    for _ in range(int(rng.integers(0, 4))):  # further rows, deeper in the block
        for edge in streets.curbs:
            _line_with_buildings(rng, sketch, edge, behind, {"annex": 1.0})
        behind += uniform(rng, (9, 18))
    if rng.random() < 0.75:
        sketch.add_clear("car", _parked_cars(rng, streets, uniform(rng, (0.1, 0.8))))
    if rng.random() < 0.35 and len(streets.roads) > 1:
        sketch.add("crossing", _crossing(rng, streets))
    return sketch.classes()


def _look(rng: np.random.Generator, streets: Streets, margin: float) -> PictureFrame:
    """A view of a stretch of the first street, with a random part of the block beside and behind it."""
    road = 2 * float(streets.roads[0][1].mean())
    window = streets.curbs[0].at(0.0).place(rectangle(-8, -road * uniform(rng, (0.4, 1.0)), 8, margin + 12))
    return view_around(rng, [window], random_turn(rng, 0.45, 0.06), (4, uniform(rng, (16, 38))), (7, 12))


def _curb_crossings(rng: np.random.Generator, streets: Streets, verge: float) -> Polygons:
    """Short walkways across the grass between sidewalk and curb."""
    shape: Polygons = []
    spacing, width = uniform(rng, (12, 30)), uniform(rng, (1.2, 2.0))
    for curb in streets.curbs:
        for along in np.arange(-60, 60, spacing):
            frame = curb.at(float(along) + rng.normal(0, 1.5))
            shape += stroke(frame.place([(0.0, -1.0), (0.0, verge + 1.0)]), width)
    return shape


def _add_alleys(rng: np.random.Generator, sketch: Sketch, streets: Streets, depth: float) -> list[Curb]:
    """Add an alley behind the first row of buildings, with one or two passages to the street. Returns its two curbs."""
    curb, width = streets.curbs[0], uniform(rng, (3.5, 5.5))
    alley = np.array([curb.at(offset).place((0, depth)) for offset in np.arange(-70, 71, 7.0)])
    shape = stroke(alley, width)
    first = uniform(rng, (6, 24)) * float(rng.choice((-1, 1)))
    for offset in (first, -first * uniform(rng, (0.7, 2)))[: int(rng.integers(1, 3))]:
        frame = curb.at(offset)
        shape += stroke(np.array([frame.place((0, -1.0)), frame.place((rng.normal(0, 1), depth + 1))]), width)
    sketch.add("driveway", shape)
    edges = [alley + sign * left_normals(alley) * width / 2 for sign in (1, -1)]
    return [Curb(line, float(traveled(line)[-1]) / 2) for line in (edges[0], edges[1][::-1])]


def _line_with_buildings(
    rng: np.random.Generator, sketch: Sketch, edge: Curb, margin: float, weights: dict[str, float]
) -> None:
    """Add buildings along a curb, side by side, as many as fit without overlapping what is already drawn."""
    setback = float(rng.choice((0.3, uniform(rng, (0.5, 3)), uniform(rng, (3, 8)))))
    along = -75.0
    while along < 75.0:
        width = uniform(rng, (9, 38))
        kind = choose(rng, weights)
        frame = edge.at(along + width / 2)
        stand = Placement(frame.place((0.0, margin)), frame.angle, bool(rng.random() < 0.5))
        if _in_view(sketch, stand, width):
            building = _BUILDINGS[kind](rng, width, max(setback + rng.normal(0, 0.5), 0.1))
            placed = {layer: stand.place_all(shape) for layer, shape in building.items()}
            if not _fits(sketch, placed):
                along += 3.0
                continue
            sketch.add_all(placed)
        along += width + float(rng.choice((0.0, uniform(rng, (0.5, 5))), p=(0.6, 0.4)))


def _in_view(sketch: Sketch, stand: Placement, width: float) -> bool:
    pixels = sketch.view.to_pixels(stand.place([(0.0, 10.0)]))[0]
    slack = (width + 15) * sketch.view.scale
    return bool((pixels > -slack).all() and (pixels < np.array([sketch.view.width, sketch.view.height]) + slack).all())


def _fits(sketch: Sketch, shapes: Building) -> bool:
    solid = sketch.mask([*shapes.get("house", []), *shapes.get("driveway_inside", [])])
    return sketch.overlap(solid, "road", "pavement", "pavement_over_driveway", "house", "driveway") < 0.01


def _entrance(rng: np.random.Generator, x: float, y: float, path_width: float) -> Building:
    """A door at (x, y) of a street front, and a straight or slightly skewed walkway to the sidewalk."""
    half, depth = uniform(rng, (1.0, 1.9)), uniform(rng, (0.9, 1.8))
    door = jitter(rng, rectangle(x - half, y - depth * 0.5, x + half, y + depth), 0.12)
    line = np.array([(x + rng.normal(0, 0.3), -1.5), (x, y + 0.5)])
    return {"door": [door], "path": stroke(line, path_width)}


def _merge(into: Building, more: Building) -> None:
    for layer, shape in more.items():
        into[layer] += shape


def _terraces(rng: np.random.Generator, width: float, setback: float) -> Building:
    """Attached narrow houses, each with a door and a short walkway, their fronts not quite in line."""
    building: Building = collections.defaultdict(list)
    units = max(int(width / uniform(rng, (5.5, 9.0))), 2)
    unit, depth = width / units, uniform(rng, (9, 16))
    relief, side = uniform(rng, (0.0, 0.8)), uniform(rng, (0.2, 0.8))
    for index in range(units):
        left, front = -width / 2 + index * unit, setback + abs(rng.normal(0, relief))
        back = setback + depth + rng.normal(0, 1.0)
        building["house"].append(rectangle(left, front, left + unit + 0.2, back))
        if rng.random() < 0.3:
            top = back + uniform(rng, (2, 5))
            building["house"].append(rectangle(left + 0.15 * unit, back - 1, left + 0.6 * unit, top))
        at = side if index % 2 == 0 or rng.random() < 0.5 else 1 - side
        if rng.random() < 0.85:
            _merge(building, _entrance(rng, left + at * unit, front, uniform(rng, (1.0, 1.6))))
    return building


def _slab(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A long apartment house with several entrances, sometimes with a walkway along its front."""
    depth = uniform(rng, (10, 18))
    building: Building = collections.defaultdict(list)
    building["house"].append(rectangle(-width / 2, setback, width / 2, setback + depth))
    _relief(rng, building, width, setback, depth)
    count = max(round(width / uniform(rng, (9, 18))), 1)
    doors = -width / 2 + width * (np.arange(count) + uniform(rng, (0.3, 0.7))) / count
    if setback > 3.0 and rng.random() < 0.5:
        lane = setback - uniform(rng, (1.5, 2.5))
        ends = np.array([(doors[0], -1.5), (doors[0], lane), (doors[-1] + 0.1, lane)])
        building["path"] += stroke(resample(smooth(ends, int(rng.integers(0, 2))), 1.0), uniform(rng, (1.2, 2.0)))
        for x in doors:
            entrance = _entrance(rng, float(x), setback, 1.4)
            building["path"] += stroke(np.array([(x, lane), (x, setback + 0.5)]), 1.5)
            building["door"] += entrance["door"]
    else:
        for x in doors:
            _merge(building, _entrance(rng, float(x), setback, uniform(rng, (1.2, 2.6))))
    return building


def _relief(rng: np.random.Generator, building: Building, width: float, setback: float, depth: float) -> None:
    """Add stair towers, projections and wings that break up a plain front and back."""
    for _ in range(int(rng.integers(0, 5))):
        start, size = uniform(rng, (-width / 2, width / 2 - 3)), uniform(rng, (2.0, 8.0))
        end = min(start + size, width / 2)
        if rng.random() < 0.5 and setback > 1.5:
            building["house"].append(rectangle(start, setback - uniform(rng, (0.3, 1.0)), end, setback + 2))
        else:
            top = setback + depth + uniform(rng, (0.8, 6.0))
            building["house"].append(rectangle(start, setback + depth - 1, end, top))


def _court_block(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A U-shaped building around a planted court that is open to the street, with doors inside the court."""
    width, depth = max(width, 22.0), uniform(rng, (18, 40))
    wing = uniform(rng, (7, 0.36 * width))
    left, right, back = -width / 2, width / 2, setback + depth
    inner = back - uniform(rng, (8, 12))
    one_sided = bool(rng.random() < 0.3)
    house = [rectangle(left, setback, left + wing, back), rectangle(left, inner, right, back)]
    house += [] if one_sided else [rectangle(right - wing, setback, right, back)]
    middle = (left + wing + (right if one_sided else right - wing)) / 2 + rng.normal(0, 0.5)
    building: Building = collections.defaultdict(list, house=house)
    path_width = uniform(rng, (1.3, 2.6))
    _merge(building, _entrance(rng, middle, inner, path_width))
    sides = [(left + wing, 1)] + ([] if one_sided else [(right - wing, -1)])
    for wall, outward in sides:
        for y in np.arange(setback + uniform(rng, (3, 8)), inner - 2, uniform(rng, (6, 14))):
            half = uniform(rng, (1.0, 1.7))
            door = rectangle(wall - outward * 1.0, y - half, wall + outward * 0.8, y + half)
            building["door"].append(jitter(rng, door, 0.1))
            building["path"] += stroke(np.array([(middle, y), (wall, y)]), path_width * 0.8)
    if rng.random() < 0.4:
        x = left + wing * uniform(rng, (0.3, 0.7))
        _merge(building, _entrance(rng, x, setback, path_width))
    return building


def _closed_block(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A block with buildings on all sides, a court inside, and sometimes an archway for cars."""
    width, depth = max(width, 26.0), uniform(rng, (24, 36))
    building = _slab(rng, width, setback)
    building["house"] = [rectangle(-width / 2, setback, width / 2, setback + depth)]
    wall = uniform(rng, (8, 10))
    court = rectangle(-width / 2 + wall, setback + wall, width / 2 - wall, setback + depth - wall)
    building["court"] = [jitter(rng, court, 0.3)]
    if rng.random() < 0.5:
        x = uniform(rng, (-0.2, 0.2)) * width
        building["court_path"] = stroke(np.array([(x, setback + wall), (x, setback + depth - wall)]), 1.6)
    return building


def _parking(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A parking lot with rows of cars and an entry from the street, and a building behind it."""
    width, depth = min(width, 26.0), uniform(rng, (11, 18))
    ground = rectangle(-width / 2 + 0.5, setback + 0.5, width / 2 - 0.5, setback + depth)
    entry = uniform(rng, (-0.3, 0.3)) * width
    lane = rectangle(entry - 2.5, -8.0, entry + 2.5, setback + 2)
    cars, chance = [], uniform(rng, (0.1, 0.8))
    for x in np.arange(-width / 2 + 2, width / 2 - 1, 2.9):
        for y in (setback + 3.0, setback + depth - 2.8):
            if rng.random() < chance and (y > setback + 4 or abs(x - entry) > 4):
                cars.append(car(rng, np.array([x, y]), np.pi / 2 + rng.normal(0, 0.04)))
    house = [rectangle(-width / 2, setback + depth + 2, width / 2, setback + depth + uniform(rng, (10, 16)))]
    return {"driveway": [ground, lane], "car": cars, "house": house, "driveway_inside": [ground]}


def _tower(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A tower on a lawn or a paved square, with a bent walkway to its door and a driveway to its garage."""
    side, back = uniform(rng, (13, 20)), setback + uniform(rng, (3, 9))
    left, right = -side / 2 - uniform(rng, (-2, 3)), side / 2 + uniform(rng, (-2, 3))
    blocks = [rectangle(-side / 2, back, side / 2, back + side), rectangle(left, back + 3, right, back + side - 3)]
    x = uniform(rng, (-0.3, 0.3)) * side
    corners = [(x + rng.normal(0, 4), -1.5), (x + rng.normal(0, 2), back * 0.5), (x, back - 1), (x, back + 0.5)]
    line = resample(smooth(corners, int(rng.integers(0, 3))), 1.0)
    half = uniform(rng, (1.0, 1.7))
    door = jitter(rng, rectangle(x - half, back - 0.7, x + half, back + 0.9), 0.1)
    building: Building = {"house": blocks, "door": [door], "path": stroke(line, uniform(rng, (1.4, 2.6)))}
    if rng.random() < 0.3:
        building["pavement"] = [rectangle(-side / 2 - 1, -0.5, side / 2 + 1, back + 0.5)]
    if rng.random() < 0.5:
        ramp = side / 2 + uniform(rng, (2.5, 5))
        corners = [(ramp, -8.0), (ramp, back + side * 0.4), (side / 2 - 0.5, back + side * 0.6)]
        building["driveway"] = stroke(resample(smooth(corners, 1), 1.0), uniform(rng, (3.2, 5)))
    return building


def _annex(rng: np.random.Generator, width: float, setback: float) -> Building:
    """A garage or the back of a building on another street, without a door."""
    width = min(width, uniform(rng, (6, 30)))
    depth = uniform(rng, (6, 16))
    building: Building = {"house": [rectangle(-width / 2, setback, width / 2, setback + depth)]}
    _relief(rng, building, width, setback, depth)
    return building


_BUILDINGS: dict[str, Callable[[np.random.Generator, float, float], Building]] = {
    "terraces": _terraces,
    "slab": _slab,
    "court_block": _court_block,
    "closed_block": _closed_block,
    "parking": _parking,
    "tower": _tower,
    "annex": _annex,
}
#: Kinds of the buildings along alleys.
_BEHIND = {"terraces": 0.5, "slab": 1.0, "annex": 1.2}
#: Kinds of the buildings along streets.
_WEIGHTS = {"terraces": 1.0, "slab": 1.0, "court_block": 0.5, "closed_block": 0.3, "parking": 0.2, "tower": 0.25}


def _parked_cars(rng: np.random.Generator, streets: Streets, density: float) -> Polygons:
    """Cars along the curbs, bumper to bumper or with gaps, except at junctions."""
    cars = []
    for curb in streets.curbs:
        for along in np.arange(-60, 60, 6.2):
            frame = curb.at(float(along) + rng.normal(0, 0.4))
            center = frame.place((0.0, -uniform(rng, (1.1, 1.5))))
            if rng.random() < density and not _on_other_road(streets, curb, frame.origin):
                cars.append(car(rng, center, frame.angle + rng.normal(0, 0.03)))
    return cars


def _on_other_road(streets: Streets, curb: Curb, point: np.ndarray) -> bool:
    own = streets.curbs.index(curb) // 2
    for index, (line, half_widths) in enumerate(streets.roads):
        nearest = float(np.hypot(*(line - point).T).min())
        if index != own and nearest < float(half_widths.mean()) + 5:
            return True
    return False


def _crossing(rng: np.random.Generator, streets: Streets) -> Polygons:
    """A pedestrian crossing over the side street, next to the main street."""
    line, half_widths = streets.roads[1]
    off = float(streets.roads[0][1].mean()) + uniform(rng, (1.5, 4))
    index = int(np.searchsorted(traveled(line), off))
    half = float(half_widths[index]) + 0.5
    ahead = line[index + 1] - line[index]
    return [Placement(line[index], float(np.arctan2(ahead[1], ahead[0]))).place(rectangle(-1.2, -half, 1.2, half))]
