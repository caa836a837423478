import collections
import inspect
import itertools
import re

import cv2
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.indoor.houses import furnishing, layouts
from dc2g_jax.indoor.houses.dataset import draw_plan, indoor_house, indoor_houses
from dc2g_jax.indoor.houses.plans import world_from_plan
from dc2g_jax.indoor.houses.worlds import start_cells
from dc2g_jax.indoor.maps.classes import (
    BATHROOM,
    BED,
    BEDROOM,
    COUCH,
    GOALS,
    KITCHEN,
    LIVING_ROOM,
    REFRIGERATOR,
    SINK,
    TOILET,
)
from tests.support.two_rooms import rooms_cut_off

COUNT = 40


@pytest.fixture(scope="module")
def plans() -> list:
    return [draw_plan(5, "train", index) for index in range(COUNT)]


@pytest.fixture(scope="module")
def worlds(plans) -> list:
    return [world_from_plan(plan, 0.1) for plan in plans]


@pytest.mark.parametrize(
    ("room", "corners"),
    [(("##", "#."), 6), (("####", "#..#", ".###", ".#.."), None), (("###", "#.#", "###"), None), (("#.", ".#"), None)],
)
def test_the_outline_of_a_room_that_has_one(room, corners):
    squares = {(x, y) for y, row in enumerate(room) for x, mark in enumerate(row) if mark == "#"}
    outline = layouts._outline(squares)
    assert (None if outline is None else len(outline)) == corners


def fits(free: np.ndarray, radius: float) -> np.ndarray:
    """Where the middle of a disc may be, by stamping discs around all blocked cells: cells of 10 cm."""
    clear = free.copy()
    reach = int(np.ceil(radius + 0.5)) + 1
    for row, column in itertools.product(range(-reach, reach + 1), repeat=2):
        if np.hypot(row, column) < radius + 0.5 - 1e-5:
            clear &= np.roll(free, (row, column), (0, 1))
    return clear


def test_a_robot_gets_everywhere(worlds):
    for world in worlds:
        cells = fits(world.free, 2.0)
        piece = cv2.connectedComponents(cells.astype(np.uint8), connectivity=4)[1]
        sizes = np.bincount(piece[piece > 0])
        # Turned chairs take fewer cells than the upright boxes around them, so that gaps may open.
        assert sizes.max() > 0.98 * sizes.sum()
        assert rooms_cut_off(world) == []


def test_goals_can_be_reached_from_afar(worlds):
    found = np.array([[np.any(world.classes == goal) for goal in GOALS] for world in worlds])
    started = np.array([[np.any(start_cells(world, goal, distance=1.5)) for goal in GOALS] for world in worlds])
    assert found.mean(axis=0).min() > 0.5
    assert started.sum() >= 0.98 * found.sum()


def test_things_stand_where_they_belong(worlds):
    where = {BED: {BEDROOM}, TOILET: {BATHROOM}, COUCH: {LIVING_ROOM}, REFRIGERATOR: {KITCHEN}}
    where |= {SINK: {BATHROOM, KITCHEN}}
    for world in worlds:
        kinds = world.room_kinds[world.rooms]
        for kind, rooms in where.items():
            assert set(kinds[(world.classes == kind)].tolist()) <= rooms
    kinds = np.concatenate([world.room_kinds[1:] for world in worlds])
    toilets = sum(int(np.sum(world.object_kinds == TOILET)) for world in worlds)
    assert toilets >= 0.9 * np.sum(kinds == BATHROOM)


def test_rooms_are_furnished_from_the_whole_catalog():
    mentions = collections.Counter(re.findall('"([a-z ]+)"', inspect.getsource(furnishing)))
    assert set(mentions) == set(furnishing.CATALOG)
    assert min(mentions.values()) > 1  # in the catalog, and in a room


def test_doors_stay_free_and_are_wide_enough(plans, worlds):
    for plan, world in zip(plans, worlds, strict=True):
        left, top = (min(w[i][0] for w in plan.walls for i in (0, 1)), max(w[i][1] for w in plan.walls for i in (0, 1)))
        for (x0, y0), (x1, y1) in plan.doors:
            assert 0.9 <= np.hypot(x1 - x0, y1 - y0) <= 2.1
            column, row = (int(((x0 + x1) / 2 - left + 0.25) / 0.1), int((top - (y0 + y1) / 2 + 0.25) / 0.1))
            assert world.free[row - 3 : row + 4, column - 3 : column + 4].sum() >= 21


def test_furniture_stands_in_rooms_and_houses_are_closed(plans, worlds):
    for plan, world in zip(plans, worlds, strict=True):
        assert len(world.object_kinds) == len(plan.furniture)
        assert not world.free[[0, 1, -2, -1]].any()
        assert not world.free[:, [0, 1, -2, -1]].any()


def test_a_seed_draws_the_same_house_and_no_other_one():
    def key(plan):
        return (plan.walls, plan.doors, plan.furniture)

    assert key(draw_plan(3, "val", 7)) == key(draw_plan(3, "val", 7))
    cases = [(0, "train", 1), (1, "train", 0), (0, "val", 1), (0, "test", 1), (0, "train", 0)]
    drawn = [key(draw_plan(*case)) for case in cases]
    assert all(one != other for one, other in itertools.combinations(drawn, 2))


def test_houses_are_of_one_to_ten_rooms(plans):
    counts = [len(plan.rooms) for plan in plans]
    assert min(counts) == 1
    assert max(counts) <= 10
    assert 3 < np.mean(counts) < 5


def test_bad_seeds_and_splits_are_refused():
    with pytest.raises(InputError, match="no split"):
        draw_plan(0, "training", 0)
    with pytest.raises(InputError, match="at least 0"):
        draw_plan(0, "train", -1)
    with pytest.raises(InputError, match="at least 1"):
        indoor_houses(count=0)


def test_the_procedural_houses_are_the_default():
    houses = indoor_houses(split="val", count=2, cell_size=0.1)
    assert [house.name for house in houses] == ["val-0", "val-1"]
    np.testing.assert_array_equal(houses[1].world.classes, world_from_plan(draw_plan(0, "val", 1), 0.1).classes)
    by_name = indoor_house("val-1", split="val", cell_size=0.1)
    assert by_name.name == "val-1"
    np.testing.assert_array_equal(by_name.world.classes, houses[1].world.classes)
