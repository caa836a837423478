"""Furnishing of rooms by type, with frequencies and places as in ProcTHOR's training houses.

Bathtubs and sinks in kitchens are additions: those 20 houses have none.
"""

import math
from collections.abc import Callable

from dc2g_jax.indoor.houses.placing import RoomSketch, Wall, in_front
from dc2g_jax.indoor.houses.plans import Furniture
from dc2g_jax.indoor.maps import classes

_Range = tuple[float, float]

#: Name -> class, and ranges of the extents along its back and from back to front and of the height, meters, as in
#: ProcTHOR's training houses. Pieces without a range of the depth are square.
CATALOG: dict[str, tuple[int, _Range, _Range | None, _Range]] = {
    "single bed": (classes.BED, (0.8, 1.3), (1.9, 2.2), (0.6, 0.95)),
    "double bed": (classes.BED, (1.35, 2.05), (2.05, 2.45), (0.8, 1.3)),
    "nightstand": (classes.CABINET, (0.38, 0.65), (0.28, 0.5), (0.46, 0.7)),
    "dresser": (classes.CABINET, (0.65, 2.3), (0.3, 0.75), (0.7, 1.15)),
    "side table": (classes.CABINET, (0.4, 1.0), (0.3, 0.6), (0.5, 0.85)),
    "desk": (classes.DESK, (1.2, 1.7), (0.5, 0.85), (0.75, 1.5)),
    "table": (classes.TABLE, (1.0, 1.8), (0.75, 1.0), (0.7, 0.85)),
    "coffee table": (classes.TABLE, (0.9, 1.5), (0.5, 0.9), (0.32, 0.45)),
    "chair": (classes.CHAIR, (0.42, 0.6), (0.46, 0.62), (0.78, 1.05)),
    "armchair": (classes.ARMCHAIR, (0.7, 1.1), (0.65, 0.95), (0.65, 1.05)),
    "couch": (classes.COUCH, (1.7, 2.7), (0.82, 1.2), (0.75, 1.15)),
    "television": (classes.TELEVISION, (1.05, 1.35), (0.09, 0.18), (1.7, 2.1)),
    "television on stand": (classes.TELEVISION, (0.85, 1.2), (0.15, 0.35), (0.6, 0.8)),
    "television stand": (classes.CABINET, (0.95, 1.4), (0.45, 0.85), (0.6, 0.8)),
    "shelf": (classes.SHELF, (0.65, 1.05), (0.25, 0.48), (1.2, 2.2)),
    "floor lamp": (classes.LAMP, (0.41, 0.55), None, (1.8, 2.1)),
    "desk lamp": (classes.LAMP, (0.2, 0.4), None, (0.35, 0.7)),
    "floor plant": (classes.PLANT, (0.3, 0.55), None, (0.6, 1.1)),
    "potted plant": (classes.PLANT, (0.2, 0.4), None, (0.35, 0.7)),
    "toilet": (classes.TOILET, (0.5, 0.56), (0.84, 0.97), (0.92, 1.05)),
    "sink": (classes.SINK, (0.66, 0.8), (0.55, 0.73), (0.95, 1.05)),
    "kitchen sink": (classes.SINK, (0.6, 0.85), (0.45, 0.6), (0.04, 0.1)),
    "bathtub": (classes.OTHER, (1.5, 1.8), (0.7, 0.85), (0.5, 0.62)),
    "fridge": (classes.REFRIGERATOR, (0.85, 1.15), (0.7, 0.82), (1.5, 2.1)),
    "counter": (classes.COUNTER, (1.2, 3.0), (0.6, 0.65), (0.92, 0.95)),
    "deep counter": (classes.COUNTER, (1.2, 3.05), (0.9, 2.6), (0.92, 0.95)),
    "waste bin": (classes.OTHER, (0.36, 0.52), (0.3, 0.5), (0.45, 0.66)),
    "small bin": (classes.OTHER, (0.14, 0.18), None, (0.5, 0.56)),
    "box": (classes.OTHER, (0.32, 0.65), (0.32, 0.5), (0.2, 0.4)),
    "ball": (classes.OTHER, (0.24, 0.26), None, (0.24, 0.26)),
    "pet bed": (classes.OTHER, (0.73, 1.1), (0.73, 1.0), (0.12, 0.3)),
    "hamper": (classes.OTHER, (0.45, 0.65), (0.36, 0.5), (0.6, 0.87)),
}

#: Number of chairs at a table, and its probability.
_CHAIRS = ((0, 0.14), (1, 0.24), (2, 0.22), (3, 0.08), (4, 0.14), (6, 0.18))

#: Range of the depth of a chair below the table, meters, and its largest rotation, radians.
_TUCKED, _TURNED = (0.08, 0.25), 0.45

#: Free space in front of furniture that is used from the front, meters.
_FRONT = 0.55


def furnish(room: RoomSketch) -> None:
    """Furnish a room by its type."""
    _RULES[room.kind](room)


def _bedroom(room: RoomSketch) -> None:
    for _ in range(1 + _chance(room, 0.45)):
        item = _item(room, "double bed" if _chance(room, 0.55) else "single bed")
        bed = room.against_wall(item, corner=0.55, front=0.45)
        if bed and _chance(room, 0.4):
            _nightstand(room, bed)
    if _chance(room, 0.2):
        _at_wall(room, "desk", seat=0.9)
    if _chance(room, 0.42):
        _table(room)
    for _ in range(_chance(room, 0.9) + _chance(room, 0.4)):
        dresser = _at_wall(room, "dresser", corner=0.35)
        if dresser and _chance(room, 0.5):
            _on_top(room, dresser)
    if _chance(room, 0.46):
        _television(room, next((piece for piece in room.pieces if piece.kind == classes.BED), None), stand=0.2)
    _often(room, "armchair", 0.22)
    _often(room, "floor lamp", 0.28, corner=0.4)
    _often(room, "floor plant", 0.42, corner=0.6)
    _often(room, "shelf", 0.05)
    _clutter(room, boxes=0.6, balls=0.75, bins=0.2, pets=0.12)


def _bathroom(room: RoomSketch) -> None:
    _at_wall(room, "toilet", corner=0.75, front=_FRONT)
    _at_wall(room, "sink", corner=0.75, front=_FRONT)
    _often(room, "bathtub", 0.3, corner=0.9)
    _often(room, "dresser", 0.2)
    _often(room, "side table", 0.14)
    _often(room, "small bin", 0.9)
    _often(room, "waste bin", 0.85)
    _often(room, "hamper", 0.13)
    _often(room, "floor plant", 0.07, corner=0.6)


def _kitchen(room: RoomSketch) -> None:
    if _chance(room, 0.95):
        # Counters that run around a corner have deep boxes.
        name = "deep counter" if _chance(room, 0.55) else "counter"
        counter = _at_wall(room, name, corner=0.6, front=_FRONT)
        if counter and _chance(room, 0.35):
            room.on(counter, _item(room, "kitchen sink"))
        if counter and _chance(room, 0.22):
            room.on(counter, _item(room, "potted plant"))
    if _chance(room, 0.95):
        _at_wall(room, "fridge", corner=0.45, front=_FRONT)
    if _chance(room, 0.7):
        _table(room)
    _often(room, "shelf", 0.58)
    _often(room, "side table", 0.08)
    if _chance(room, 0.35):
        _television(room, None, stand=0.0)
    _often(room, "floor plant", 0.2, corner=0.6)
    _clutter(room, boxes=0.0, balls=0.0, bins=0.85, pets=0.0)


def _living_room(room: RoomSketch) -> None:
    couch = _at_wall(room, "couch", corner=0.4, front=0.7) if _chance(room, 0.95) else None
    if _chance(room, 0.97):
        _television(room, couch, stand=0.4)
    if couch and _chance(room, 0.14):
        _coffee_table(room, couch)
    for _ in range(_chance(room, 0.98) + _chance(room, 0.3)):
        _table(room)
    for _ in range(_chance(room, 0.3) + _chance(room, 0.12)):
        _at_wall(room, "armchair", front=0.3)
    _often(room, "floor lamp", 0.5, corner=0.35)
    _often(room, "floor plant", 0.36, corner=0.6)
    _often(room, "side table", 0.17)
    _often(room, "dresser", 0.06)
    _often(room, "shelf", 0.06)
    _clutter(room, boxes=0.5, balls=0.1, bins=0.25, pets=0.18)


_RULES: dict[int, Callable[[RoomSketch], None]] = {
    classes.BEDROOM: _bedroom,
    classes.BATHROOM: _bathroom,
    classes.KITCHEN: _kitchen,
    classes.LIVING_ROOM: _living_room,
}


def _chance(room: RoomSketch, share: float) -> bool:
    return bool(room.rng.random() < share)


def _item(room: RoomSketch, name: str) -> Furniture:
    """Draw an item of the catalog, without a place."""
    kind, widths, depths, tops = CATALOG[name]
    width, depth, top = (float(room.rng.uniform(*limits)) for limits in (widths, depths or widths, tops))
    return Furniture(kind, 0, 0, width, depth if depths else width, 0, top)


def _at_wall(
    room: RoomSketch, name: str, *, corner: float = 0.0, front: float = 0.0, seat: float = 0.0
) -> Furniture | None:
    """Place a piece with its back to a wall, with retries at other sizes, and with a chair at probability `seat`."""
    for _ in range(4):
        piece = room.against_wall(_item(room, name), corner=corner, front=front)
        if piece:
            if _chance(room, seat):
                _seat(room, piece, 0.0, 0.0)
            return piece
    return None


def _often(room: RoomSketch, name: str, share: float, *, corner: float = 0.0) -> None:
    """Place a piece with its back to a wall, with probability `share`."""
    if _chance(room, share):
        _at_wall(room, name, corner=corner)


def _nightstand(room: RoomSketch, bed: Furniture) -> None:
    item = _item(room, "nightstand")
    for side in room.rng.permutation([-1, 1]).tolist():
        x, y = in_front(bed, side * (bed.width + item.width + 0.12) / 2, (item.depth - bed.depth) / 2)
        stand = item._replace(x=x, y=y, angle=bed.angle)
        if room.place(stand):
            if _chance(room, 0.3):
                room.on(stand, _item(room, "desk lamp"))
            return


def _television(room: RoomSketch, watcher: Furniture | None, *, stand: float) -> None:
    """Place a television on a wall, or on a stand in front of it; if possible the wall that `watcher` faces."""
    wall = room.opposite(watcher) if watcher else None
    if _chance(room, stand):
        below = _opposite_first(room, "television stand", wall)
        if below:
            room.on(below, _item(room, "television on stand"))
            return
    _opposite_first(room, "television", wall)


def _opposite_first(room: RoomSketch, name: str, wall: Wall | None) -> Furniture | None:
    """Place a piece against a wall, or against another wall if it does not fit there."""
    item = _item(room, name)
    piece = room.against_wall(item, wall=wall) if wall else None
    return piece or room.against_wall(item)


def _coffee_table(room: RoomSketch, couch: Furniture) -> None:
    item = _item(room, "coffee table")
    x, y = in_front(couch, 0, couch.depth / 2 + 0.75 + item.depth / 2)
    room.place(item._replace(x=x, y=y, angle=couch.angle))


def _table(room: RoomSketch) -> None:
    """Place a table, against a wall or not, with chairs around it and sometimes something on top."""
    item = _item(room, "table")
    by_wall = _chance(room, 0.4)
    table = room.against_wall(item, corner=0.25) if by_wall else room.anywhere(item)
    if not table:
        return
    counts, shares = zip(*_CHAIRS, strict=True)
    wanted = int(room.rng.choice(counts, p=shares))
    for side, shift in _seats(room, pairs=wanted > 3):
        if wanted and _seat(room, table, side, shift * table.width):
            wanted -= 1
    _on_top(room, table)


def _seats(room: RoomSketch, *, pairs: bool) -> list[tuple[float, float]]:
    """Seats around a table: the side (0 is the front), and the offset from the side's middle in widths of the table.

    Long sides come first; with `pairs` they have two seats each.
    """
    long, short = room.rng.permutation([0, math.pi]), room.rng.permutation([math.pi / 2, -math.pi / 2])
    places = [(float(side), shift) for side in long for shift in ((-0.25, 0.25) if pairs else (0.0,))]
    return places + [(float(side), 0.0) for side in short]


def _seat(room: RoomSketch, table: Furniture, side: float, shift: float) -> bool:
    """Place a chair at a side of a table (0 is the front), shifted along that side. Returns whether it fits."""
    item = _item(room, "chair")
    reach = table.depth if math.cos(side) ** 2 > 0.5 else table.width
    ahead = (reach + item.depth) / 2 - room.rng.uniform(*_TUCKED)
    x, y = in_front(table._replace(angle=table.angle + side), shift, ahead)
    angle = table.angle + side + room.rng.uniform(-_TURNED, _TURNED)
    return room.place(item._replace(x=x, y=y, angle=angle), table=table)


def _on_top(room: RoomSketch, piece: Furniture) -> None:
    """Sometimes place a lamp or a plant on a piece."""
    if _chance(room, 0.42):
        room.on(piece, _item(room, "desk lamp"))
    if _chance(room, 0.16):
        room.on(piece, _item(room, "potted plant"))


def _clutter(room: RoomSketch, *, boxes: float, balls: float, bins: float, pets: float) -> None:
    """Place other objects on the floor: boxes, balls, bins and pet beds, each with its probability."""
    if _chance(room, boxes):
        room.anywhere(_item(room, "box"))
    if _chance(room, balls):
        room.anywhere(_item(room, "ball"))
    _often(room, "waste bin", bins, corner=0.3)
    _often(room, "pet bed", pets, corner=0.3)
