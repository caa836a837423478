"""Procedural floor plans: furnished houses like ProcTHOR's, as many as are wanted, the same for a seed everywhere."""

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
    """One furnished house. No two of seed, split and index share their random numbers.

    A robot of the usual radius gets from everywhere it fits to everywhere else, checked in cells of `CHECK_CELLS`; in
    finer ones there may be gaps behind furniture. All doors are open.

    Args:
      seed: from 0 on.
      split: 'train', 'val' or 'test'.
      index: of the house in the split, from 0 on.

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
        rooms = [RoomSketch(rng, layout, number, floor) for number in range(len(layout.kinds))]
        for room in rooms:
            furnish(room)
        # What stands near a border without a wall may cut off a corner of the room beyond.
        if component_numbers(passable(floor.free, CHECK_CELLS)).max() == 1:
            furniture = tuple(piece for room in rooms for piece in room.pieces)
            return HousePlan(layout.rooms, layout.walls, layout.doors, furniture)
    raise RuntimeError(f"no house within {_ATTEMPTS} drawings of seed {seed}, {split}, {index}")
