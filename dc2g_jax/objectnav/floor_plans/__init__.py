"""Procedural floor plans: an unlimited number of furnished houses like ProcTHOR's, reproducible by seed."""

import dataclasses

import numpy as np

from dc2g_jax.datasets.maps import SPLITS
from dc2g_jax.errors import InputError
from dc2g_jax.grid.ground import component_numbers
from dc2g_jax.objectnav.floor_plans.furnishing import furnish
from dc2g_jax.objectnav.floor_plans.layouts import draw_layout
from dc2g_jax.objectnav.floor_plans.placing import CHECK_CELLS, Floor, RoomSketch
from dc2g_jax.objectnav.plans import HousePlan
from dc2g_jax.objectnav.starts import passable

_ATTEMPTS = 100


def draw_plan(seed: int, split: str, index: int) -> HousePlan:
    """Draw a furnished house. Every combination of seed, split and index has its own random numbers.

    A robot of default radius can drive between all cells in which it fits. This is checked with cells of `CHECK_CELLS`;
    with finer cells there may be isolated gaps behind furniture. All doors are open.

    Args:
      seed: a non-negative seed.
      split: 'train', 'val' or 'test'.
      index: index of the house in the split, from 0.

    Raises:
      InputError: there is no such split, or a number is negative.
    """
    if split not in SPLITS:
        raise InputError(f"no split is called {split!r}; use one of: {', '.join(SPLITS)}")
    if seed < 0 or index < 0:
        raise InputError(f"seed {seed}, house {index}: give numbers from 0 on")
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(SPLITS.index(split), index, attempt)))
        layout = draw_layout(rng)
        floor = Floor(layout)
        rooms = [RoomSketch(rng, layout, number, floor) for number in range(len(layout.plan.rooms))]
        for room in rooms:
            furnish(room)
        # An object near a border without wall may cut off a corner of the adjacent room.
        if component_numbers(passable(floor.free, CHECK_CELLS)).max() == 1:
            return dataclasses.replace(layout.plan, furniture=tuple(piece for room in rooms for piece in room.pieces))
    raise RuntimeError(f"no house within {_ATTEMPTS} drawings of seed {seed}, {split}, {index}")
