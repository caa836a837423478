"""A hand-drawn house in ProcTHOR's format: two rooms side by side, and the boxes of what stands in them."""

import copy
import json
from pathlib import Path
from typing import Any

BOXES = {
    "bed": {"type": "Bed", "box": [1.0, 0.6, 2.0]},
    "table": {"type": "DiningTable", "box": [0.6, 0.8, 0.4]},
    "fern": {"type": "HousePlant", "box": [0.2, 0.5, 0.2]},
    "cup": {"type": "Cup", "box": [0.1, 0.1, 0.1]},
    "screen": {"type": "Television", "box": [1.0, 0.6, 0.02]},
    "picture": {"type": "Painting", "box": [0.6, 0.6, 0.2]},
    "crate": {"type": "Box", "box": [0.3, 0.3, 0.3]},
}


def _wall(name: str, x0: float, z0: float, x1: float, z1: float, **more: Any) -> dict[str, Any]:
    corners = [(x0, 0, z0), (x1, 0, z1), (x0, 3, z0), (x1, 3, z1)]
    return {"id": name, "polygon": [dict(zip("xyz", corner, strict=True)) for corner in corners], **more}


def _box(asset: str, x: float, middle: float, z: float, turn: float = 0, **more: Any) -> dict[str, Any]:
    return {
        "assetId": asset,
        "position": {"x": x, "y": middle, "z": z},
        "rotation": {"x": 0, "y": turn, "z": 0},
        **more,
    }


def _room(kind: str, left: float, right: float) -> dict[str, Any]:
    corners = [(left, 0), (left, 3), (right, 3), (right, 0)]
    return {"roomType": kind, "floorPolygon": [{"x": x, "y": 0, "z": z} for x, z in corners]}


_HOUSE = {
    "rooms": [_room("Bedroom", 0, 3), _room("Kitchen", 3, 5)],
    "walls": [
        _wall("west", 0, 0, 0, 3),
        _wall("east", 5, 3, 5, 0),
        _wall("south", 0, 0, 5, 0),
        _wall("north", 0, 3, 5, 3),
        # From the top down: the door's hole is measured from the first vertex.
        _wall("between", 3, 3, 3, 0),
        _wall("between, from the kitchen", 3, 0, 3, 3),
        _wall("no wall", 0, 1.5, 5, 1.5, empty=True),
    ],
    "doors": [
        {"id": "inner", "room0": "a", "room1": "b", "wall0": "between", "holePolygon": [{"x": 0.5}, {"x": 1.5}]},
        {"id": "front", "room0": "a", "room1": "a", "wall0": "south", "holePolygon": [{"x": 1.0}, {"x": 2.0}]},
    ],
    "objects": [
        _box("bed", 1.05, 0.3, 0.55, 90),
        _box("table", 4.5, 0.4, 0.4, children=[_box("fern", 4.6, 1.05, 0.4), _box("cup", 4.3, 0.85, 0.4)]),
        _box("screen", 1.5, 1.5, 2.99, 180),
        _box("picture", 4.0, 1.5, 2.9),
        _box("crate", 4.0, 0.15, 2.0, 45),
        _box("crate", 9.0, 0.15, 2.0),
    ],
}


def house() -> dict[str, Any]:
    """A new copy of the house."""
    return copy.deepcopy(_HOUSE)


def write(folder: Path, *lines: object, name: str = "train.jsonl") -> Path:
    """Write houses, or lines of text, and the boxes."""
    (folder / "asset_boxes.json").write_text(json.dumps(BOXES))
    path = folder / name
    path.write_text("".join((line if isinstance(line, str) else json.dumps(line)) + "\n" for line in lines))
    return path
