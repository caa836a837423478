"""Maps that misbehave: specks and glass, loops that close, doors that shut, inflated walls, and all of it at random.

    STORIES=10000 pytest -n 0 -rP -m slow tests/planning/test_misbehaving_maps.py

lets so many robots explore parts of real maps, and says how that ended. `STORIES=500-1000` are the stories with these
numbers.
"""

import collections
import math
import os

import numpy as np
import pytest

from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.planning.metric import MetricPlanner
from dc2g_jax._src.planning.metric_map import MetricMap
from tests.support import stories
from tests.support.metric_maps import FRAME, FREE, OCCUPIED, PIXEL, REACH, TURNS, UNKNOWN, grid_of, place, planner_of

#: Numbers of the stories.
FIRST, _, BEYOND = os.environ.get("STORIES", "50").rpartition("-")
STORIES = range(int(FIRST or 0), int(BEYOND))

#: Most seconds of CPU time that a decision takes.
MOST_SECONDS = 5


def corridor(length: int = 8) -> np.ndarray:
    """Free from column 1 in row 1, with an unknown end."""
    cells = np.pad(np.full((1, length), FREE), 1, constant_values=OCCUPIED)
    cells[1, length] = UNKNOWN
    return cells


@pytest.mark.parametrize("ground", [OCCUPIED, UNKNOWN])
def test_a_robot_on_an_occupied_or_unknown_cell_turns_where_it_stands_and_leaves(ground):
    cells, here = corridor(), place(2.3, 0.8, turns=2)
    cells[1, 2] = ground
    decision = planner_of().plan(grid_of(cells), here)
    assert decision.mode == "explore"
    assert [pose[:2] for pose in decision.path[:3]] == [here[:2]] * 3
    np.testing.assert_allclose(decision.subgoal, place(5, 1))


def test_a_door_that_can_no_longer_be_reached_is_the_goal_again_when_it_can():
    planner, cells = planner_of(), np.pad(np.full((3, 9), FREE), 1, constant_values=OCCUPIED)
    modes = []
    for passage in (FREE, OCCUPIED, FREE):
        cells[1:4, 5] = passage
        modes.append(planner.plan(grid_of(cells), place(2, 2), doors=[place(9, 2)[:2]]).mode)
    assert modes == ["to_goal", "gave_up", "to_goal"]


def test_inflation_wider_than_a_doorway_hides_the_room_behind_it_until_it_is_gone():
    planner, cells = planner_of(2), np.pad(np.full((6, 16), FREE), 2, constant_values=OCCUPIED)
    cells[:, 9:11], cells[4:6, 9:11], cells[2:8, 17] = OCCUPIED, FREE, UNKNOWN
    inflated = cells.copy()
    inflated[3:7, 8:12] = OCCUPIED
    modes = [planner.plan(grid_of(each), place(4, 4)).mode for each in (cells, inflated, cells)]
    assert modes == ["explore", "gave_up", "explore"]


# --- cells that stay unknown ------------------------------------------------------------------------------------------


def drive(planner: MetricPlanner, world: np.ndarray, robot, hidden=(), doors=()):
    """Decisions on the way; the robot goes to each subgoal and sees the pixels of its field of view but the hidden."""
    seen, decisions = np.zeros(world.shape, bool), []
    known_doors = [place(*door)[:2] for door in doors]
    for _ in range(200):
        column, row, turns = robot
        for y, x in np.ndindex(world.shape):
            dx, dy, (ahead_x, ahead_y) = x - column, y - row, TURNS[turns]
            ahead, aside = dx * ahead_x + dy * ahead_y, dx * ahead_y - dy * ahead_x
            seen[y, x] |= (abs(aside) < ahead and math.hypot(dx, dy) <= 3 * REACH) or max(abs(dx), abs(dy)) <= 1
        for x, y in hidden:
            seen[y, x] = False
        decision = planner.plan(grid_of(np.where(seen, world, UNKNOWN)), place(*robot), doors=known_doors)
        decisions.append(decision)
        if decision.mode == "gave_up" or len(decision.path) == 1:
            return decisions, seen
        right, up = FRAME.to_grid(*decision.subgoal[:2])
        turns = round((decision.subgoal.yaw - FRAME.yaw) / (math.pi / 2)) % 4
        robot = math.floor(right / PIXEL), math.floor(up / PIXEL), turns
    raise AssertionError("the robot never ends")


@pytest.mark.parametrize("pixels", [1, 2])
def test_exploration_sees_everything_and_ends_whatever_the_sensor_misses(pixels):
    world = np.pad(np.full((12, 16), FREE), 1, constant_values=OCCUPIED)
    world[6, :9] = OCCUPIED
    hidden = [(12, 5), (12, 6), (5, 6)]  # a hole in the ground, and one in the wall
    decisions, seen = drive(planner_of(pixels), world, (3, 2, 0), hidden)
    assert decisions[-1].mode == "gave_up"
    assert (~seen).sum() <= len(hidden) + 4, "all but the hidden and the corners"
    assert "still unknown after the robot looked at them" in decisions[-1].why


def test_a_robot_that_goes_to_see_large_and_small_cells_in_turn_comes_to_an_end():
    world = np.pad(np.full((2, 8), FREE), 2, constant_values=OCCUPIED)
    planner = MetricPlanner(cell_size=0.1, smallest_cell=0.05, sensing_range=0.1, largest=(16, 16))
    decisions, _ = drive(planner, world, (9, 2, 2), hidden=[(3, 2), (5, 2)])
    assert {round(each.cell_size, 2) for each in decisions} == {0.05, 0.1}
    assert decisions[-1].mode == "gave_up"


def test_a_robot_short_of_its_subgoal_has_not_looked_yet():
    planner, cells = planner_of(), corridor()
    decisions = [planner.plan(grid_of(cells), place(3, 1)) for _ in range(3)]
    assert [each.mode for each in decisions] == ["explore"] * 3
    assert math.dist(decisions[0].subgoal[:2], place(3, 1)[:2]) < 0.11


def glass():
    """A planner that has set aside the end of a corridor."""
    planner, cells = planner_of(), corridor()
    planner.set_aside(planner.plan(grid_of(cells), place(1, 1)).subgoal)
    decision = planner.plan(grid_of(cells), place(1, 1))
    assert decision.mode == "gave_up"
    assert decision.why.endswith("1 cells are still unknown after the robot looked at them")
    return planner, cells


def test_a_frontier_behind_glass_stays_aside_when_the_map_grows_and_its_origin_shifts():
    planner, cells = glass()
    grown = np.pad(cells, ((4, 1), (2, 3)), constant_values=OCCUPIED)
    corner = FRAME.to_map(-2.2 * PIXEL, -4.2 * PIXEL)  # of a pixel, too
    assert planner.plan(grid_of(grown, MapFrame(*corner, FRAME.yaw)), place(1, 1)).mode == "gave_up"


@pytest.mark.parametrize("change", ["known", "opened", "loop closed"])
def test_a_frontier_behind_glass_is_tried_again_when_the_map_changes_there(change):
    planner, cells = glass()
    robot = place(1, 1)
    if change == "known":
        cells[1, 8:] = FREE, UNKNOWN
    elif change == "opened":
        cells[2, 8] = FREE
    else:
        cells, robot = np.roll(np.pad(cells[:, ::-1], ((0, 0), (0, 8)), constant_values=OCCUPIED), 7, 1), place(10, 1)
        assert cells[1, 8] == UNKNOWN
    assert planner.plan(grid_of(cells), robot).mode == "explore"


@pytest.mark.parametrize(("resolution", "yaw"), [(PIXEL / 2, 0.0), (PIXEL, 0.05)])
def test_a_map_of_another_resolution_or_rotation_is_looked_at_anew(resolution, yaw):
    planner, cells = glass()
    repeats = round(PIXEL / resolution)
    frame = FRAME._replace(yaw=FRAME.yaw + yaw)
    grid = MetricMap(cells.repeat(repeats, 0).repeat(repeats, 1).astype(np.int8), resolution, frame)
    assert planner.plan(grid, place(1, 1, frame=frame)).mode == "explore"


def test_nothing_is_set_aside_from_beyond_the_map():
    planner, world = planner_of(), corridor()
    before = planner.plan(grid_of(world), place(1, 1, 0))
    for column, row in ((30, 1), (-30, 1), (1, 30), (1, -30)):
        planner.set_aside(place(column, row))
    assert before.mode == "explore"
    assert planner.plan(grid_of(world), place(1, 1, 0)) == before


# --- everything at random ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_robots_whose_maps_misbehave_leave_no_frontier_that_they_can_reach(shared_files, optimized):
    """`tests.oracles.metric_oracle` checks each decision, and whether anything was left at the end."""
    worlds, ends, slowest, failed = stories.worlds_of(shared_files("datasets/ros_maps", "*.yaml")), [], 0.0, []
    for number in STORIES:
        story = stories.story(number, worlds)
        try:
            told = story.tell(stories.planner_for(story.degrees))
        except Exception as error:
            failed.append(f"story {number}: {type(error).__name__}: {error}")
            continue
        ends.append(told)
        slowest = max(slowest, told.slowest)
    modes = collections.Counter(told.end for told in ends)
    decisions = sum(told.decisions for told in ends)
    print(f"{len(STORIES)} stories, {decisions} decisions, the slowest {slowest:.2f} s: {modes}")
    assert not failed, "\n".join(failed)
    assert slowest < MOST_SECONDS
    assert modes["gave_up"] > len(STORIES) / 2
