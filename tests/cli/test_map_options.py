"""Where an episode may start, and what is said where it may not."""

import numpy as np
import pytest

from dc2g_jax._src.cli.map_options import MapOptions, doubts_about, start_in
from dc2g_jax._src.grid.terrain import TRAVERSABLE
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.readers.starts import Start
from tests.support.maps import drawn
from tests.support.refusals import refusal

YARD = House(
    "yard",
    "test",
    drawn("""
        ##D##...
        ..P....R
        SSSSS...
        RRRRR..P
    """),
)


def test_a_start_that_is_given_is_taken():
    assert start_in("yard.png", YARD, (4, 2, 3), seed=0) == Start("yard", 4, 2, 3)


@pytest.mark.parametrize("seed", range(5))
def test_a_start_that_is_not_given_is_sampled_on_the_road(seed):
    start = start_in("yard.png", YARD, None, seed)
    assert start == start_in("yard.png", YARD, None, seed)
    assert start.y == 3
    assert 0 <= start.x <= 4
    assert 0 <= start.heading < 4


@pytest.mark.parametrize(
    ("pose", "mentions"),
    [
        ((1, 3, 4), ("--start 1 3 4", "no heading 4")),
        ((9, 3, 0), ("off the map of 8 x 4 cells", "column 4, row 3")),
        ((-1, 3, 0), ("off the map of 8 x 4 cells", "column 0, row 3")),
        ((0, 0, 0), ("column 0, row 0 is 'house', which is not traversable", "column 0, row 2")),
        ((2, 0, 0), ("is a goal already", "column 2, row 1")),
    ],
)
def test_a_start_of_no_use_is_refused_with_the_nearest_that_is(pose, mentions):
    refusal(lambda: start_in("yard.png", YARD, pose, seed=0), "yard.png: --start", *mentions)


def test_where_no_road_leads_to_a_goal_a_start_is_sampled_all_the_same():
    terrain = np.where(YARD.terrain == YARD.terrain[3, 0], np.uint8(2), YARD.terrain)
    terrain[3, 7] = YARD.terrain[3, 0]
    house = House("path", "test", terrain)
    assert start_in("path.png", house, None, seed=0)[:3] == ("path", 7, 3)  # the only road
    assert start_in("path.png", house, (0, 2, 1), seed=0) == Start("path", 0, 2, 1)
    terrain = terrain.copy()
    terrain[0, 2] = terrain[3, 7] = 2
    sampled = {start_in("no.png", House("doorless", "test", terrain), None, seed)[1:3] for seed in range(40)}
    assert sampled == {(x, y) for y, x in np.argwhere(TRAVERSABLE[terrain]).tolist()}
    lawn = House("lawn", "test", np.full((3, 3), 2, np.uint8))
    refusal(lambda: start_in("no.png", lawn, None, seed=0), "no.png: ", "no traversable ground", "choose another one")


def test_grids_that_distort_a_map_are_told(tmp_path):
    np.save(tmp_path / "yard.npy", np.full((40, 60), 3, np.uint8))
    told = [
        doubts_about(MapOptions(tmp_path / "yard.npy", cells=cells)) for cells in (None, (30, 20), (30, 21), (30, 30))
    ]
    assert told[:3] == [[], [], []]
    assert told[3] == ["--cells 30 30 does not keep the aspect ratio of 60 x 40 pixels; --cells 30 20 would"]
