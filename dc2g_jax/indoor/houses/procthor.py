"""Houses in the format of ProcTHOR (Deitke et al., 2022): one house per line of JSON, and a table of bounding boxes.

The following parts of a house are used: the floors of rooms; walls, except those marked `empty`; doors between two
rooms, all of them open (doors to the outside are closed); and objects as the boxes of their assets, rotated by
`rotation.y`. Windows are walls. Objects on other objects are used only if they have a class of their own, such as a
plant on a table. Objects that hang on a wall are left out, except televisions.
"""

import gzip
import math
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from dc2g_jax.files import opened, parse_json, read_lines, read_object
from dc2g_jax.indoor.houses.plans import Furniture, HousePlan, Room, Segment
from dc2g_jax.indoor.maps.classes import OTHER, PROCTHOR_CLASSES, ROOM_NAMES
from dc2g_jax.runtime import InputError, check_name, check_number, short

#: Name of the table of boxes, beside the houses.
BOXES_FILE = "asset_boxes.json"

#: An object that begins higher above the floor than this, and stands on nothing, hangs on a wall; meters.
_HANGING = 0.3

#: Largest distance of a house from the origin, meters, and largest rotation of an object, degrees.
_FARTHEST, _FULLY_TURNED = 100.0, 3600.0

#: Most bytes of a house, and most lines of a file.
_LONGEST_LINE, _MOST_LINES = 2**24, 10**6

#: Largest numbers of rooms and objects in a house.
_MOST_ROOMS, _MOST_OBJECTS = 255, 10_000


#: The bounding box of an asset: object type, such as `DiningTable`; and extents along x, y (up) and z, meters.
AssetBox = tuple[str, float, float, float]


def _read_asset_boxes(path: str | Path) -> dict[str, AssetBox]:
    """Read the table of boxes: a JSON object `assetId -> {"type": ..., "box": [x, y, z]}`, sizes in meters.

    Raises:
      InputError: the file cannot be read or is not such a table; the message names the asset.
    """
    path = Path(path)
    remedy = "give a JSON file that says type and box [x, y, z] in meters of each asset"
    boxes = {}
    for asset, entry in read_object(path, remedy, at_most=_LONGEST_LINE).items():
        try:
            width, height, depth = (_number(abs(size), "box") for size in _list(entry, "box"))
            boxes[asset] = str(entry["type"]), width, height, depth
        except (TypeError, KeyError, ValueError):
            raise InputError(f"{path}: asset {short(asset)} is {short(entry)}; {remedy}") from None
    return boxes


def read_procthor(path: str | Path) -> list[tuple[int, HousePlan]]:
    """Read the houses of a file. Empty lines are ignored.

    Args:
      path: JSON lines, gzipped if the name ends in `.gz`, beside the table of boxes, `asset_boxes.json`.

    Returns:
      Line number, from 1, and plan of each house.

    Raises:
      InputError: a file cannot be read or contains no houses, or a line is not a valid house.
    """
    path = Path(path)
    table = _read_asset_boxes(path.parent / BOXES_FILE)
    houses = []
    for number, line in _lines(path):
        try:
            houses.append((number, house_plan(_parsed(line), table)))
        except InputError as error:
            raise InputError(f"{path}: line {number} is not a house: {error}; repair or delete the line") from None
    if not houses:
        raise InputError(f"{path}: holds no house; give a file with a house in ProcTHOR's JSON format on each line")
    return houses


def house_plan(house: Mapping[str, Any], boxes: Mapping[str, AssetBox]) -> HousePlan:
    """The plan of one house. ProcTHOR's x and z are the plan's x and y; its clockwise angles become negative.

    Raises:
      InputError: something in it is missing or invalid.
    """
    rooms = tuple(_room(room) for room in _list(house, "rooms"))
    walls = {str(_field(wall, "id")): wall for wall in _list(house, "walls")}
    furniture = [piece for entry in _list(house, "objects") for piece in _pieces(entry, boxes, on_floor=True)]
    if not 0 < len(rooms) <= _MOST_ROOMS or len(furniture) > _MOST_OBJECTS:
        raise InputError(f"{len(rooms)} rooms and {len(furniture)} objects, not 1 to {_MOST_ROOMS} and {_MOST_OBJECTS}")
    return HousePlan(
        rooms=rooms,
        walls=tuple(_ends(wall) for wall in house["walls"] if not wall.get("empty")),
        doors=tuple(
            _opening(door, walls) for door in _list(house, "doors") if _field(door, "room0") != _field(door, "room1")
        ),
        furniture=tuple(furniture),
    )


def _lines(path: Path) -> Iterator[tuple[int, bytes]]:
    remedy = "give an undamaged file of houses in ProcTHOR's JSON format, .jsonl or .jsonl.gz"
    try:
        with opened(path, remedy) as file:
            lines: Any = gzip.GzipFile(fileobj=file) if path.suffix == ".gz" else file  # type: ignore[call-overload]
            for number, line in read_lines(lines, path, at_most=_LONGEST_LINE):
                if number > _MOST_LINES:
                    raise InputError(f"{path}: has more than {_MOST_LINES} lines; divide it into several files")
                if line.strip():
                    yield number, line
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: cannot be read ({error}); {remedy}") from None


def _parsed(text: bytes) -> dict[str, Any]:
    try:
        parsed = parse_json(text)
    except ValueError as error:
        raise InputError(f"it is not JSON ({error})") from None
    if not isinstance(parsed, dict):
        raise InputError(f"it holds a {type(parsed).__name__} instead of an object")
    return parsed


def _field(entry: Any, name: str) -> Any:
    if not isinstance(entry, dict) or name not in entry:
        raise InputError(f"no {name!r} in {short(entry)}")
    return entry[name]


def _list(entry: Any, name: str) -> list[Any]:
    found = _field(entry, name)
    if not isinstance(found, list):
        raise InputError(f"{name!r} is {short(found)}, not a list")
    return found


def _number(value: Any, name: str, most: float = _FARTHEST) -> float:
    check_number(name, value, least=-most, most=most)
    return float(value)


def _corners(entry: Any, name: str, least: int) -> Float[np.ndarray, "corner 2"]:
    corners = [[_number(_field(corner, axis), axis) for axis in "xz"] for corner in _list(entry, name)]
    if len(corners) < least:
        raise InputError(f"{name!r} has {len(corners)} corners, less than {least}")
    return np.array(corners)


def _room(room: Any) -> Room:
    kind = _field(room, "roomType")
    check_name("room type", kind, ROOM_NAMES[1:])
    return Room(ROOM_NAMES.index(kind), _corners(room, "floorPolygon", 3))


def _ends(wall: Any) -> Segment:
    """The segment of a wall: the first two corners of its polygon are those on the floor."""
    start, end = _corners(wall, "polygon", 2)[:2].tolist()
    return Segment(tuple(start), tuple(end))


def _opening(door: Any, walls: Mapping[str, Any]) -> Segment:
    name = str(_field(door, "wall0"))
    if name not in walls:
        raise InputError(f"door {_field(door, 'id')!r} is in a wall {name!r} that is not there")
    start, end = np.array(_ends(walls[name]))
    length = float(np.hypot(*(end - start)))
    if length == 0:
        raise InputError(f"wall {short(name)} has no length, but a door")
    hole = [_number(_field(corner, "x"), "x") for corner in _list(door, "holePolygon")[:2]]
    if len(hole) < 2:
        raise InputError(f"the hole of door {short(_field(door, 'id'))} has less than 2 corners")
    near, far = (start + (end - start) * (x / length) for x in hole)
    return Segment(tuple(near.tolist()), tuple(far.tolist()))


def _pieces(entry: Any, boxes: Mapping[str, AssetBox], *, on_floor: bool) -> Iterator[Furniture]:
    """An object and what stands on it."""
    asset = str(_field(entry, "assetId"))
    if asset not in boxes:
        raise InputError(f"asset {short(asset)} is not in the table of boxes")
    (name, width, height, depth), position = boxes[asset], _field(entry, "position")
    x, middle, z = (_number(_field(position, axis), axis) for axis in "xyz")
    turn = _number(_field(_field(entry, "rotation"), "y"), "y", _FULLY_TURNED)
    kind = PROCTHOR_CLASSES.get(name, OTHER)
    bottom, top = middle - height / 2, middle + height / 2
    stands = on_floor and bottom <= _HANGING
    if top > 0 and (kind != OTHER or stands):  # objects below the floor are neither visible nor in the way
        yield Furniture(kind, x, z, width, depth, -math.radians(turn), top)
    for child in _list(entry, "children") if entry.get("children") else ():
        yield from _pieces(child, boxes, on_floor=False)
