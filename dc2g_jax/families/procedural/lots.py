"""One lot of a suburb: house, driveway, walkways, doors and cars, drawn in meters.

A house has its own frame: its front runs along x near y = 0, the street lies toward negative y, and the garage
is on the left (negative x). The frame may be mirrored.
"""

from dataclasses import dataclass

import numpy as np

from dc2g_jax.families.procedural._streets import Curb
from dc2g_jax.families.procedural.drawing import (
    Placement,
    Points,
    Polygons,
    Range,
    choose,
    jitter,
    rectangle,
    resample,
    smooth,
    stroke,
    traveled,
    uniform,
)


@dataclass(frozen=True)
class Suburb:
    """Style of a suburb: its lots, its streets, and how much of it an image shows.

    Ranges are in meters, `turn` is in radians, the others are weights and shares.
    """

    lot_width: Range
    setback: Range
    house_width: Range
    house_depth: Range
    turn: float
    driveways: dict[str, float]
    driveway_width: Range
    cars: float
    second_door: float
    streets: dict[str, float]
    road_width: Range
    sidewalks: float
    verge: Range
    street_cars: float
    neighbors: float
    margins: Range
    beyond_road: Range
    extra_width: Range
    pixels_per_meter: Range


@dataclass(frozen=True)
class _HouseOutline:
    """A house in its own frame: blocks, ends, the garage's (x, front y, width), the front door's (x, y)."""

    blocks: list[Points]
    left: float
    right: float
    garage: tuple[float, float, float]
    door: tuple[float, float]


@dataclass
class Lot:
    """The content of one lot: layer -> shape in the plane, and the shape that an image of the lot must contain."""

    shapes: dict[str, Polygons]
    essentials: Polygons


def _build_house(rng: np.random.Generator, suburb: Suburb) -> _HouseOutline:
    """A house as a union of rectangles: body, garage, bays, wings, some with corners cut off."""
    width, depth = uniform(rng, suburb.house_width), uniform(rng, suburb.house_depth)
    garage_width = min(uniform(rng, (4.5, 7.5)), 0.55 * width)
    left, right = -width / 2, width / 2
    garage_front = float(rng.choice((uniform(rng, (-4.5, -0.5)), 0.0, uniform(rng, (0.3, 2.5))), p=(0.5, 0.2, 0.3)))
    garage_depth = uniform(rng, (6, 8)) + max(-garage_front, 0) * 0.4
    inner = left + garage_width
    blocks = [
        rectangle(inner - 0.4, 0, right, depth),
        rectangle(left, garage_front, inner, max(garage_front + garage_depth, 3.0)),
    ]
    for _ in range(int(rng.integers(0, 3))):  # bays at the front
        bay = uniform(rng, (2.0, 0.45 * (right - inner) + 2.0))
        start = uniform(rng, (inner, max(right - bay, inner + 0.1)))
        blocks.append(rectangle(start, uniform(rng, (-1.8, -0.4)), min(start + bay, right + 0.6), 2.0))
    for _ in range(int(rng.integers(0, 3))):  # wings at the back and the sides
        wing = uniform(rng, (0.25, 0.6)) * width
        start = uniform(rng, (left - 1.0, right - wing + 1.0))
        blocks.append(rectangle(start, depth * 0.5, start + wing, depth + uniform(rng, (0.8, 5.0))))
    if rng.random() < 0.25:  # a wing in front, far from the garage: an L or a U
        start = right - uniform(rng, (0.2, 0.4)) * width
        blocks.append(rectangle(start, uniform(rng, (-5, -2)), right, depth * 0.6))
    door_x = uniform(rng, (inner + 1.2, max(right - 1.5, inner + 1.3)))
    behind_door = [block for block in blocks if np.min(block[:, 0]) <= door_x <= np.max(block[:, 0])]
    door = (door_x, min(float(np.min(block[:, 1])) for block in behind_door))  # on the foremost wall
    blocks = [_cut_corner(rng, jitter(rng, block, 0.12)) for block in blocks]
    return _HouseOutline(blocks, left, right, (left + garage_width / 2, garage_front, garage_width), door)


def _cut_corner(rng: np.random.Generator, block: Points) -> Points:
    """The block, sometimes with one or two back corners cut off."""
    if rng.random() < 0.75:
        return block
    corner = int(rng.integers(2, 4))
    before, at, after = block[corner - 1], block[corner], block[(corner + 1) % 4]
    share = uniform(rng, (0.15, 0.4))
    cut = np.array([at + share * (before - at), at + share * (after - at)])
    return np.concatenate([block[:corner], cut, block[corner + 1 :]])


def build_lot(rng: np.random.Generator, suburb: Suburb, curb: Curb, has_sidewalk: bool) -> Lot:
    """House, driveway, walkways, doors and cars of the lot along a curb."""
    house = _build_house(rng, suburb)
    at_curb = curb.at(0.0)
    setback = uniform(rng, suburb.setback) + max(-house.garage[1], 0.0)
    turn = rng.normal(0, suburb.turn)
    sideways = uniform(rng, (-0.12, 0.12)) * suburb.lot_width[0]
    stand = Placement(at_curb.place((sideways, setback)), at_curb.angle + turn, bool(rng.random() < 0.5))
    lot = Lot({"house": stand.place_all(house.blocks)}, stand.place_all(house.blocks))
    drive = _DRIVEWAYS[choose(rng, suburb.driveways)](rng, suburb, house, stand, curb)
    lot.shapes["driveway"] = drive.shape
    lot.essentials += [drive.line]
    starts = _walkway_starts(rng, house, stand, at_curb, drive, has_sidewalk)
    width = uniform(rng, (1.2, 2.0)) if suburb.setback[1] > 20 else uniform(rng, (0.9, 1.6))
    lot.shapes["path"] = [piece for start in starts for piece in walkway(rng, house.door, stand, start, width)]
    lot.shapes["door"] = [stand.place(door_outline(rng, house.door, 1.15 if suburb.setback[1] > 20 else 1.0))]
    if rng.random() < suburb.second_door:
        _add_side_door(rng, lot, house, stand, width)
    if rng.random() < suburb.cars:
        lot.shapes["car"] = _park(rng, drive)
    return lot


@dataclass(frozen=True)
class Driveway:
    """A driveway: shape, center line from road to house [n 2], width, where walkways may begin [m 2]."""

    shape: Polygons
    line: Points
    width: float
    walk_from: Points


def tapered(rng: np.random.Generator, line: Points, at_road: float, at_house: float, flare: float) -> Polygons:
    """The strip of a driveway along a line [n 2]: its width varies from road to house, and flares at the road."""
    distance = traveled(line)
    width = np.interp(distance, (0, distance[-1]), (at_road, at_house))
    mouth = uniform(rng, (2.0, 3.5))
    return stroke(line, width + (flare - 1) * at_road * np.clip(1 - (distance - 1.0) / mouth, 0, 1))


def _front_driveway(
    rng: np.random.Generator, suburb: Suburb, house: _HouseOutline, stand: Placement, curb: Curb
) -> Driveway:
    """A short driveway from the road straight, bent or skewed to a garage door that faces the street."""
    x, y, garage_width = house.garage
    at_house = garage_width * uniform(rng, (0.7, 1.0))
    end, before = stand.place((x, y + 0.6)), stand.place((x, y - uniform(rng, (1.0, 3.0))))
    at_curb = curb.at(0.0)
    away = float((end - at_curb.origin) @ np.array([np.cos(at_curb.angle), np.sin(at_curb.angle)]))
    mouth = curb.at(away + rng.normal(0, 1.2))
    line = np.array([mouth.place((0, -1.2)), mouth.place((0, uniform(rng, (0.8, 2.0)))), before, end])
    line = resample(smooth(line, int(rng.integers(0, 3))), 0.8)
    shape = tapered(rng, line, at_house * uniform(rng, (0.75, 1.1)), at_house, uniform(rng, (1.0, 1.7)))
    walk = stand.place([(x, y - uniform(rng, (0.8, 3.5))), (x, y - uniform(rng, (0.8, 2.0)))])
    return Driveway(shape, line, at_house, walk)


def _court(rng: np.random.Generator, house: _HouseOutline, width: float) -> tuple[Polygons, Points, Points]:
    """Paved ground beside a garage that opens sideways, in the house's frame: shape, entry, middle."""
    reach, back = uniform(rng, (5.0, 8.0)), uniform(rng, (4.5, 7.0))
    front = house.garage[1] + uniform(rng, (-0.5, 1.5))
    ground = rectangle(house.left - reach, front, house.left + 0.5, front + back)
    ground = jitter(rng, ground, 0.5)
    ground[0] += (uniform(rng, (0, 1.5)), uniform(rng, (-1, 1)))
    shape = [ground]
    entry = np.array([house.left - reach + width * uniform(rng, (0.5, 0.8)), front + 0.8])
    if rng.random() < 0.7:  # a stub for turning around
        slant, length = uniform(rng, (-0.8, 0.8)), uniform(rng, (3, 7))
        foot = np.array([house.left - reach * 0.75, front + back * 0.6])
        tip = foot + length * np.array([np.sin(slant), np.cos(slant)])
        shape += stroke(np.array([foot, tip]), uniform(rng, (3.0, 4.5)))
    return shape, entry, np.array([house.left - reach / 2, front + back / 2])


def _winding_driveway(
    rng: np.random.Generator, suburb: Suburb, house: _HouseOutline, stand: Placement, curb: Curb
) -> Driveway:
    """A long driveway, straight or winding, to a paved court beside the house."""
    width = uniform(rng, suburb.driveway_width)
    court, entry, middle = _court(rng, house, width)
    setback = float(np.hypot(*(stand.origin - curb.at(0.0).origin)))
    sign = -1.0 if stand.mirrored else 1.0
    mouth = curb.at(sign * (entry[0] + rng.normal(0, 0.35) * setback))
    bend = rng.normal(0, 0.12, 2) * setback
    start, turn_in = mouth.place((0, 0)), stand.place(entry - (0, uniform(rng, (0.1, 0.3)) * setback))
    lean = mouth.place((rng.normal(0, 1.5), uniform(rng, (2, 6))))
    between = (lean + turn_in) / 2 + bend
    line = np.array([mouth.place((0, -1.5)), start, lean, between, turn_in, stand.place(entry), stand.place(middle)])
    if rng.random() < 0.3:
        line = np.delete(line, (3, 4), axis=0)
    line = resample(smooth(line, int(rng.choice((0, 1, 2, 3), p=(0.12, 0.28, 0.3, 0.3)))), 1.2)
    shape = tapered(rng, line, width, width * uniform(rng, (0.95, 1.3)), uniform(rng, (1.2, 2.4)))
    backs = len(line) - 1 - np.rint(rng.uniform(4, 12, 2) / 1.2).astype(int)
    walk = np.concatenate([line[np.maximum(backs, 0)], stand.place(middle)[None]])
    return Driveway([*shape, *stand.place_all(court)], line, width, walk)


def _horseshoe_driveway(
    rng: np.random.Generator, suburb: Suburb, house: _HouseOutline, stand: Placement, curb: Curb
) -> Driveway:
    """A driveway with two entries that passes in front of the front door, with a spur to the garage."""
    width = uniform(rng, suburb.driveway_width) * 0.9
    court, entry, middle = _court(rng, house, width)
    door_x, door_y = house.door
    near = door_y - uniform(rng, (3.5, 9.0))
    spread = uniform(rng, (3.0, 7.0))
    sign = -1.0 if stand.mirrored else 1.0
    first, last = (curb.at(sign * (door_x + side * uniform(rng, (9, 20)))) for side in (-1, 1))
    apex = [stand.place((door_x - spread, near)), stand.place((door_x + spread, near + rng.normal(0, 1.0)))]
    corners = [first.place((0, -1.5)), first.place((0, 3)), *apex, last.place((0, 3)), last.place((0, -1.5))]
    line = resample(smooth(corners, int(rng.integers(1, 4))), 1.2)
    distance = traveled(line)
    ends = np.minimum(distance, distance[-1] - distance)
    shape = stroke(line, width * (1 + 0.8 * np.clip(1 - (ends - 1) / 3, 0, 1)))
    leave = line[int(np.clip(len(line) * uniform(rng, (0.15, 0.4)), 1, len(line) - 2))]
    before = stand.place(entry - (0, uniform(rng, (1.5, 4))))
    spur = resample(smooth([leave, before, stand.place(entry), stand.place(middle)], int(rng.integers(0, 3))), 1.2)
    shape += stroke(spur, width)
    closest = line[int(np.argmin(np.hypot(*(line - stand.place((door_x, near))).T)))]
    return Driveway([*shape, *stand.place_all(court)], np.concatenate([line, spur]), width, closest[None])


def _side_driveway(
    rng: np.random.Generator, suburb: Suburb, house: _HouseOutline, stand: Placement, curb: Curb
) -> Driveway:
    """A narrow driveway along the side of the house to its back, sometimes to a separate garage."""
    width = uniform(rng, suburb.driveway_width) * 0.85
    x = house.left - width * uniform(rng, (0.5, 0.9))
    back = uniform(rng, (4.0, 12.0))
    end, before = stand.place((x, back)), stand.place((x, min(house.garage[1], 0) - 1.5))
    sign = -1.0 if stand.mirrored else 1.0
    mouth = curb.at(sign * x + rng.normal(0, 1.0))
    line = np.array([mouth.place((0, -1.2)), mouth.place((0, 1.5)), before, end])
    line = resample(smooth(line, int(rng.integers(0, 3))), 0.8)
    shape = tapered(rng, line, width, width * uniform(rng, (0.9, 1.4)), uniform(rng, (1.0, 1.8)))
    front = min(house.garage[1], house.door[1])
    return Driveway(shape, line, width, stand.place([(x, front - uniform(rng, (1.0, 3.0)))]))


def _walkway_starts(
    rng: np.random.Generator,
    house: _HouseOutline,
    stand: Placement,
    at_curb: Placement,
    drive: Driveway,
    has_sidewalk: bool,
) -> Polygons:
    """The starts of walkways to the front door: one or two points [2] on the driveway or at the street."""
    from_drive = drive.walk_from[int(rng.integers(len(drive.walk_from)))]
    door = stand.place((house.door[0], house.door[1]))
    along = np.array([np.cos(at_curb.angle), np.sin(at_curb.angle)])
    offset = float((door - at_curb.origin) @ along) + rng.normal(0, 0.8)
    from_street = at_curb.place((offset, -0.8))
    near = float(np.hypot(*(door - from_street))) < 22
    street, both = (0.22, 0.08) if has_sidewalk else (0.06, 0.04)
    draw = rng.random()
    if near and draw < street:
        return [from_street]
    return [from_drive, from_street] if near and draw > 1 - both else [from_drive]


def walkway(
    rng: np.random.Generator, door: tuple[float, float], stand: Placement, start: Points, width: float
) -> Polygons:
    """A bent, slanted or curved walkway in front of a house, from a point of the plane to the front door.

    Args:
      rng: random number generator.
      door: the door in the house's frame.
      stand: the house's frame.
      start: the first point [2], in the plane.
      width: width in meters.
    """
    door_x, door_y = door
    cosine, sine = np.cos(stand.angle), np.sin(stand.angle)
    dx, dy = start - stand.origin
    local_x, local_y = dx * cosine + dy * sine, -dx * sine + dy * cosine
    local_x = -local_x if stand.mirrored else local_x
    step = min(uniform(rng, (0.8, 3.0)), max(door_y - local_y, 0.8))
    turn = door_y - step
    kind = rng.random()
    if kind < 0.45:
        middle = [(door_x + rng.normal(0, 0.2), min(local_y + rng.normal(0, 0.2), door_y - 0.7))]
    elif kind < 0.8:
        middle = [(door_x + rng.normal(0, 0.3), turn)]
    else:
        share = uniform(rng, (0.3, 0.7))
        swing = rng.normal(0, 0.25) * max(abs(door_x - local_x), 2.0)
        middle = [(local_x + share * (door_x - local_x), min(local_y, turn) - abs(swing)), (door_x, turn)]
    line = smooth([(local_x, local_y), *middle, (door_x, door_y + 0.5)], int(rng.integers(0, 3)))
    line = resample(line, 0.9)
    ending = np.interp(np.arange(len(line)), (0, len(line) - 1), (1.0, uniform(rng, (0.8, 1.4))))
    return stand.place_all(stroke(jitter(rng, line, 0.06), width * ending))


def door_outline(rng: np.random.Generator, door: tuple[float, float], size: float) -> Points:
    """A front door's outline in the house's frame: a small quadrilateral that straddles the front."""
    half = size * uniform(rng, (0.9, 1.7))
    outer, inner = size * uniform(rng, (0.5, 1.1)), size * uniform(rng, (0.5, 1.2))
    corners = rectangle(door[0] - half, door[1] - outer, door[0] + half, door[1] + inner)
    return jitter(rng, corners, 0.12)


def _add_side_door(rng: np.random.Generator, lot: Lot, house: _HouseOutline, stand: Placement, width: float) -> None:
    """Add a second door or a patio at the side of the house, with a walkway around the corner."""
    depth = float(np.max(house.blocks[0][:, 1]))
    beside, side_y = house.right + width * uniform(rng, (0.6, 1.2)), uniform(rng, (0.3, 0.8)) * depth
    front = min(float(np.min(block[:, 1])) for block in house.blocks) - width * uniform(rng, (0.5, 1.2))
    corner = [(house.door[0], front), (beside, front), (beside, side_y)]
    line = resample(smooth(corner, int(rng.integers(0, 2))), 0.9)
    lot.shapes["path"] += stand.place_all(stroke(line, width * 0.9))
    if rng.random() < 0.6:
        half = uniform(rng, (0.8, 1.2))
        door = rectangle(house.right - 0.7, side_y - half, beside, side_y + half)
        lot.shapes["door"].append(stand.place(jitter(rng, door, 0.1)))
    else:
        patio = rectangle(beside - 1.0, side_y, beside + uniform(rng, (1, 3)), depth + uniform(rng, (0.0, 3.0)))
        lot.shapes["path"].append(stand.place(jitter(rng, patio, 0.3)))


def car(rng: np.random.Generator, center: Points, angle: float) -> Points:
    """A car's outline, [4 2]."""
    length, width = uniform(rng, (3.9, 5.2)), uniform(rng, (1.7, 2.2))
    body = rectangle(-length / 2, -width / 2, length / 2, width / 2)
    return Placement(center, angle).place(jitter(rng, body, 0.12))


def _park(rng: np.random.Generator, drive: Driveway) -> Polygons:
    """One or two cars beside a driveway's center line, so that wide driveways stay passable."""
    cars = []
    for _ in range(1 + int(rng.random() < 0.25)):
        index = int(np.clip(uniform(rng, (0.35, 0.95)) * len(drive.line), 1, len(drive.line) - 2))
        ahead = drive.line[index + 1] - drive.line[index - 1]
        angle = float(np.arctan2(ahead[1], ahead[0]))
        aside = max(drive.width / 2 - uniform(rng, (0.9, 1.4)), 0.0) * float(rng.choice((-1, 1)))
        cars.append(car(rng, Placement(drive.line[index], angle).place((0.0, aside)), angle + rng.normal(0, 0.08)))
    return cars


_DRIVEWAYS = {
    "front": _front_driveway,
    "winding": _winding_driveway,
    "horseshoe": _horseshoe_driveway,
    "side": _side_driveway,
}
