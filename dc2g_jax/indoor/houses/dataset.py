"""Houses for object search, by split: procedural houses, or houses from ProcTHOR's files."""

import dataclasses
import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dc2g_jax.datasets import PROCEDURAL, SPLITS, House, HouseDataset
from dc2g_jax.families import with_door
from dc2g_jax.grid import component_numbers
from dc2g_jax.indoor.houses.furnishing import furnish
from dc2g_jax.indoor.houses.layouts import draw_layout
from dc2g_jax.indoor.houses.placing import CHECK_CELLS, Floor, RoomSketch
from dc2g_jax.indoor.houses.plans import PLAN_CELL_SIZE, HousePlan, world_from_plan
from dc2g_jax.indoor.houses.procthor import read_procthor
from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.indoor.maps.cost_maps import ROBOT_RADIUS, inflated
from dc2g_jax.runtime import InputError, check_name, check_number

#: File endings of houses.
_ENDINGS = (".jsonl.gz", ".jsonl")

_ATTEMPTS = 100


class IndoorHouse(NamedTuple):
    """One house.

    Attributes:
      name: such as `train-17`: the split, and the line of the file or the index of the procedural house.
      world: the house as cells.
    """

    name: str
    world: IndoorWorld


def draw_plan(seed: int, split: str, index: int) -> HousePlan:
    """Draw a furnished house. Every combination of seed, split and index has its own random numbers.

    A robot of default radius can drive between all cells in which it fits. This is checked with cells of `CHECK_CELLS`;
    with finer cells there may be isolated gaps behind furniture. All doors are open.

    Raises:
      InputError: there is no such split, or a number is negative.
    """
    check_name("split", split, SPLITS)
    check_number("seed", seed, whole=True, least=0)
    check_number("house", index, whole=True, least=0)
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SPLITS.index(split), index, attempt)))
        layout = draw_layout(rng)
        floor = Floor(layout)
        rooms = [RoomSketch(rng, layout, number, floor) for number in range(len(layout.plan.rooms))]
        for room in rooms:
            furnish(room)
        # An object near a border without wall may cut off a corner of the adjacent room.
        if component_numbers(~inflated(~floor.free, ROBOT_RADIUS, CHECK_CELLS)).max() == 1:
            return dataclasses.replace(layout.plan, furniture=tuple(piece for room in rooms for piece in room.pieces))
    raise RuntimeError(f"no house within {_ATTEMPTS} drawings of seed {seed}, {split}, {index}")


def indoor_houses(
    location: str | os.PathLike[str] = PROCEDURAL,
    split: str = "train",
    *,
    count: int | None = None,
    cell_size: float = PLAN_CELL_SIZE,
) -> list[IndoorHouse]:
    """The first houses of a split.

    Args:
        location: 'procedural' for procedural houses, whose number is unlimited, or a folder with the files `train`,
            `val` and `test`, ending in `.jsonl.gz` or `.jsonl`, and `asset_boxes.json`.
        split: 'train', 'val' or 'test'.
        count: number of houses. `None` for all houses of a file, or for 20 procedural ones, as many as a split of
            ProcTHOR's sample has.
        cell_size: side of a cell, meters.

    Raises:
        InputError: the split, folder or file does not exist, a file is invalid, or it has fewer than `count` houses.
    """
    check_name("split", split, SPLITS)
    if count is not None:
        check_number("number of houses", count, whole=True, least=1)
    if location == PROCEDURAL:
        plans = [(index, draw_plan(0, split, index)) for index in range(count or 20)]
    else:
        paths = [Path(location) / f"{split}{ending}" for ending in _ENDINGS]
        path = next(filter(Path.is_file, paths), None)
        if path is None:
            names = " or ".join(path.name for path in paths)
            raise InputError(f"{location}: has no {names}; give a folder of ProcTHOR houses")
        plans = read_procthor(path)
        if count is not None and count > len(plans):
            raise InputError(f"{path}: has {len(plans)} houses, less than {count}; ask for fewer")
    return [IndoorHouse(f"{split}-{number}", world_from_plan(plan, cell_size)) for number, plan in plans[:count]]


def indoor_house(
    name: str, location: str | os.PathLike[str] = PROCEDURAL, split: str = "train", *, cell_size: float = PLAN_CELL_SIZE
) -> IndoorHouse:
    """The house of a split that has this name.

    Raises:
        InputError: there is none; or see `indoor_houses`, whose arguments the others are.
    """
    if location == PROCEDURAL:  # procedural houses are unlimited
        number = name.removeprefix(f"{split}-")
        if not number.isdecimal() or name != f"{split}-{int(number)}":
            raise InputError(
                f"no procedural house of the split {split} is called {name}; give {split}-0, {split}-1, ..."
            )
        return IndoorHouse(name, world_from_plan(draw_plan(0, split, int(number)), cell_size))
    houses = indoor_houses(location, split, cell_size=cell_size)
    for house in houses:
        if house.name == name:
            return house
    known = f"{houses[0].name} to {houses[-1].name}"
    raise InputError(f"{location}: no house of the split {split} is called {name}; give one of {known}")


#: Cells of a floor plan's map, its least number of rooms, and maps of each split, the first of which are to choose on.
_MAP_CELLS, _FEWEST_ROOMS, _MAPS = 50, 4, 100


def floor_plan_dataset(**_: object) -> HouseDataset:
    """Procedural houses seen from above, as maps without classes: free or occupied cells, and a door to find.

    The longer side of a house fills the map. Houses have four rooms at least; the door is a free cell at random.
    """

    def drawn(split: str) -> Iterator[House]:
        for index in itertools.count():
            plan, rng = draw_plan(0, split, index), np.random.default_rng([0, index])
            if len(plan.rooms) < _FEWEST_ROOMS:
                continue
            sides = world_from_plan(plan, PLAN_CELL_SIZE).free.shape
            free = world_from_plan(plan, max(sides) * PLAN_CELL_SIZE / _MAP_CELLS + 1e-3).free
            classes = with_door(np.pad(free, [(0, _MAP_CELLS - side) for side in free.shape]), rng)
            if classes is not None:
                yield House(f"{split}-{index}", split, classes)

    houses = (house for split in ("val", "test") for house in itertools.islice(drawn(split), _MAPS))
    return HouseDataset("floor_plans", PROCEDURAL, tuple(houses))
