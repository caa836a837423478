"""The planner in meters: plain loops in the map frame, maps turned, mirrored and grown, and coarser cells."""

import collections
import functools
import math

import numpy as np
import pytest

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.planning.metric import MetricPlanner
from dc2g_jax._src.planning.metric_map import MetricMap, MetricPose
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import complete_rules
from tests.support.metric_maps import FRAME, FREE, OCCUPIED, PIXEL, REACH, TURNS, UNKNOWN, grid_of, place, planner_of
from tests.support.networks import random_network
from tests.support.refusals import refusal


@functools.cache
def without_occlusion() -> Frontier:
    return Frontier(complete_rules(REACH))


def random_moment(seed: int, shape=(9, 13), free: float = 0.6):
    """Random pixels, and a robot on one that is free."""
    rng = np.random.default_rng(seed)
    unknown = (1 - free) * rng.choice([0.1, 0.5])
    cells = rng.choice([FREE, OCCUPIED, UNKNOWN], shape, p=[free, 1 - free - unknown, unknown])
    row, column = (int(rng.integers(size)) for size in shape)
    cells[row, column] = FREE
    return cells, (column, row, int(rng.integers(4)))


# --- plain loops, with y upward ---------------------------------------------------------------------------------------


def actions_from(free: set, start) -> dict:
    """Actions to every pose."""
    found, queue = {start: 0}, collections.deque([start])
    while queue:
        column, row, turns = pose = queue.popleft()
        dx, dy = TURNS[turns]
        nexts = [(column, row, (turns + turn) % 4) for turn in (1, -1)]
        if (column + dx, row + dy) in free:
            nexts.append((column + dx, row + dy, turns))
        for other in nexts:
            if other not in found:
                found[other] = found[pose] + 1
                queue.append(other)
    return found


def frontier_poses(cells: np.ndarray, robot) -> dict:
    """Poses from which an unknown neighbor of reachable ground is in view, and the actions to each."""
    height, width = cells.shape
    pixels = {(x, y): cells[y, x] for x in range(width) for y in range(height)}
    free = {at for at, value in pixels.items() if value == FREE} | {robot[:2]}
    actions = actions_from(free, robot)
    beside = {(x + dx, y + dy) for x, y, _ in actions for dx, dy in TURNS}
    wanted = {at for at in beside if pixels.get(at, UNKNOWN) == UNKNOWN} - {robot[:2]}

    def sees(pose, at) -> bool:
        dx, dy, (ahead_x, ahead_y) = at[0] - pose[0], at[1] - pose[1], TURNS[pose[2]]
        ahead, aside = dx * ahead_x + dy * ahead_y, dx * ahead_y - dy * ahead_x
        return abs(aside) < ahead and dx * dx + dy * dy <= REACH * REACH

    return {pose: n for pose, n in actions.items() if pose != robot and any(sees(pose, at) for at in wanted)}


def test_subgoals_and_candidates_are_those_of_plain_loops():
    modes: collections.Counter = collections.Counter()
    for seed in range(40):
        cells, robot = random_moment(seed, free=(0.6, 0.3)[seed % 2])
        decision = planner_of(planner=without_occlusion()).plan(grid_of(cells), place(*robot))
        wanted = frontier_poses(cells, robot)
        modes[decision.mode] += 1
        assert (decision.mode == "gave_up") == (not wanted)
        if not wanted:
            continue
        nearest: dict = {}
        for (column, row, _), actions in wanted.items():
            nearest[column, row] = min(actions, nearest.get((column, row), actions))
        found = {tuple(np.round(each.pose[:2], 6)): each.distance for each in decision.candidates}
        assert found == {tuple(np.round(place(*at)[:2], 6)): actions for at, actions in nearest.items()}
        least = min(wanted.values())
        ends = [place(*pose) for pose, actions in wanted.items() if actions == least]
        assert any(same_pose(decision.subgoal, end) for end in ends)
        assert len(decision.path) == least + 1
        check_path(decision, cells, place(*robot))
    assert min(modes["explore"], modes["gave_up"]) > 2, modes


def same_pose(one: MetricPose, other: MetricPose) -> bool:
    turned = math.remainder(one.yaw - other.yaw, math.tau)
    return math.dist(one[:2], other[:2]) < 1e-6 and abs(turned) < 1e-6


def check_path(decision, cells: np.ndarray, start: MetricPose) -> None:
    """One cell ahead or a quarter turn at a time, over free pixels."""
    assert decision.path[0] == start
    assert decision.path[-1] == decision.subgoal
    for before, after in zip(decision.path[:-1], decision.path[1:], strict=True):
        turn = abs(math.remainder(after.yaw - before.yaw, math.tau))
        ahead = before.x + PIXEL * math.cos(before.yaw), before.y + PIXEL * math.sin(before.yaw)
        assert math.dist(after[:2], before[:2] if turn > 1 else ahead) < 1e-6
        assert turn == pytest.approx(math.pi / 2 if turn > 1 else 0, abs=1e-6)
    free = [place(column, row)[:2] for row, column in np.argwhere(cells == FREE)]
    assert all(min(math.dist(pose[:2], at) for at in free) < 1e-6 for pose in decision.path)


# --- the same ground in other grids -----------------------------------------------------------------------------------


def summary(decision, moved=lambda x, y: (x, y)):
    """What must not change: mode, length of the path, all candidates. Of equally near ones, any may be the subgoal."""
    places = np.array([moved(*each.pose[:2]) for each in decision.candidates]).reshape(-1, 2).round(5).tolist()
    distances = (each.distance for each in decision.candidates)
    return decision.mode, len(decision.path), sorted(zip(places, distances, strict=True))


@pytest.mark.parametrize("pixels", [1, 2, 3])
def test_a_map_turned_mirrored_or_grown_gives_the_same_subgoals(pixels):
    explored, width, frame = 0, 18, MapFrame(0.0, 0.0, 0.7)
    across = width * PIXEL

    def plan(cells, frame, pose):
        return planner_of(pixels).plan(grid_of(cells, frame), pose)

    def mirrored(x, y):
        right, up = frame.to_grid(x, y)
        return frame.to_map(across - right, up)

    for seed in range(12):
        cells, robot = random_moment(seed, (12, width), free=(0.7, 0.95)[seed % 2])
        here = place(*robot, frame=frame)
        wanted = plan(cells, frame, here)
        explored += wanted.mode == "explore"
        grown = np.pad(cells, ((5, 1), (7, 2)), constant_values=UNKNOWN)
        corner = frame.to_map(-7 * PIXEL, -5 * PIXEL)
        assert summary(plan(grown, MapFrame(*corner, frame.yaw), here)) == summary(wanted)
        corner = frame.to_map(across, 0.0)
        assert summary(plan(cells.T[::-1], MapFrame(*corner, frame.yaw + math.pi / 2), here)) == summary(wanted)
        there = MetricPose(*mirrored(*here[:2]), 2 * frame.yaw + math.pi - here.yaw)
        assert summary(plan(cells[:, ::-1], frame, there)) == summary(wanted, mirrored)
    assert explored > 8


@pytest.mark.parametrize(("away", "turns"), [(0.5, 0), (-0.7, 0), (0.8, 1)])
def test_the_yaw_is_taken_as_the_nearest_quarter_turn(away, turns):
    cells, robot = random_moment(4, free=0.95)
    pose = place(*robot)
    snapped = place(*robot[:2], robot[2] + turns)
    there, here = (planner_of().plan(grid_of(cells), each) for each in (pose._replace(yaw=pose.yaw + away), snapped))
    assert there.path[1:] == here.path[1:]


# --- coarser cells ----------------------------------------------------------------------------------------------------


def test_gives_up_only_if_no_pixel_is_left_to_explore():
    modes: collections.Counter = collections.Counter()
    for seed in range(30):
        cells, robot = random_moment(seed, free=(0.3, 0.5, 0.75)[seed % 3])
        decision = planner_of(3, without_occlusion()).plan(grid_of(cells), place(*robot))
        # (In coarse cells there may be more to look at: pixels that no ground leads to.)
        assert decision.mode == "explore" or not frontier_poses(cells, robot)
        modes[decision.mode, round(decision.cell_size / PIXEL)] += 1
    assert modes["gave_up", 1] > 2
    assert modes["explore", 3] > 2
    assert modes["explore", 1] > 2


def test_passages_as_narrow_as_a_pixel_are_found():
    cells = np.full((9, 30), OCCUPIED)
    cells[:, :9] = cells[:, 20:] = FREE
    cells[4, 9:20] = FREE
    cells[:, 29] = UNKNOWN
    cells[[0, -1]] = OCCUPIED
    cells[:, 0] = OCCUPIED
    planner = planner_of(3)
    decision = planner.plan(grid_of(cells), place(3, 4))
    assert decision.mode == "explore"
    assert decision.cell_size == pytest.approx(PIXEL)
    assert planner.plan(grid_of(cells), place(24, 4)).cell_size == pytest.approx(3 * PIXEL)


def test_sizes_between_the_halves_are_tried_too():
    """A passage of seven pixels always holds whole cells of three, but here none of five, nor of four."""
    cells = np.full((20, 40), OCCUPIED)
    cells[1:19, 1:15] = cells[6:13, 15:] = FREE
    cells[:, 39] = UNKNOWN
    grid = MetricMap(cells, PIXEL, MapFrame(0.0, 0.0, 0.0))
    decision = planner_of(5, smallest_cell=0.15).plan(grid, (0.4, 0.5, 0.0))
    assert decision.mode == "explore"
    assert decision.cell_size == pytest.approx(3 * PIXEL)


@pytest.mark.parametrize(
    ("pixel", "cell_size", "sensing_range", "planned", "away"),
    [
        (0.05, 0.05, 0.2, 0.05, 0.2),
        (0.2, 0.25, 1.6, 0.4, 1.6),  # as many cells of 0.25 m would be 2.4 m
        (0.1, 0.25, 1.6, 0.3, 1.5),
        (0.05, 0.1, 0.3, 0.05, 0.3),  # halved, where as many cells would be 0.15 m
    ],
)
def test_the_sensing_range_is_in_meters_whatever_the_cells(pixel, cell_size, sensing_range, planned, away):
    """Down a corridor, the nearest subgoal is as far from what is unknown as the robot sees."""
    width = round(planned / pixel)
    cells = np.pad(np.full((width, 15 * width), FREE), 3 * width, constant_values=OCCUPIED)
    cells[3 * width : 4 * width, 15 * width :] = UNKNOWN
    planner = MetricPlanner("frontier", cell_size=cell_size, sensing_range=sensing_range, largest=(16, 16))
    decision = planner.plan(MetricMap(cells, pixel, MapFrame(0.0, 0.0, 0.0)), (3.5 * planned, 3.5 * planned, 0.0))
    assert (decision.mode, decision.cell_size) == ("explore", pytest.approx(planned))
    assert 15.5 * planned - decision.subgoal.x == pytest.approx(away)


@pytest.mark.parametrize(("degrees", "x", "turns"), [(None, 1.35, 1), (90, 1.35, 1), (360, 1.25, 0)])
def test_a_robot_that_sees_all_around_need_not_turn(degrees, x, turns):
    """To see what is beside a corridor."""
    cells = np.pad(np.full((1, 15), FREE), 3, constant_values=OCCUPIED)
    cells[2, 13] = UNKNOWN
    planner = MetricPlanner(cell_size=0.1, sensing_range=0.2, field_of_view=degrees, largest=(16, 32))
    decision = planner.plan(MetricMap(cells, 0.1, MapFrame(0.0, 0.0, 0.0)), (0.35, 0.35, 0.0))
    assert decision.subgoal == pytest.approx((x, 0.35, -math.pi / 2 * turns))


def test_a_planner_of_ones_own_keeps_its_range_in_cells():
    planner = planner_of(2, without_occlusion())
    sealed = np.pad(np.full((4, 4), FREE), 2, constant_values=OCCUPIED)
    assert planner.plan(grid_of(sealed), place(3, 3)).cell_size == pytest.approx(PIXEL)


@pytest.mark.parametrize(("smallest", "pixels"), [(None, 1), (1, 1), (2, 2), (3, 3)])
def test_cells_are_halved_down_to_the_smallest(smallest, pixels):
    sealed = np.pad(np.full((8, 8), FREE), 4, constant_values=OCCUPIED)
    planner = planner_of(4, smallest_cell=None if smallest is None else smallest * 0.05)
    decision = planner.plan(grid_of(sealed), place(6, 6))
    assert (decision.mode, decision.subgoal) == ("gave_up", None)
    assert decision.cell_size == pytest.approx(pixels * PIXEL)


# --- doors and classes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pixels", [1, 3])
def test_a_detected_door_is_the_goal_even_in_a_wall(pixels):
    world = np.pad(np.full((12, 15), FREE), 1, constant_values=OCCUPIED)
    decision = planner_of(pixels).plan(grid_of(world), place(3, 3), doors=[place(16, 7)[:2], (1e6, -1e6)])
    assert decision.mode == "to_goal"
    assert math.dist(decision.subgoal[:2], place(16, 7)[:2]) < pixels * PIXEL
    assert decision.why.startswith(f"to goal: the door at ({decision.subgoal.x:.2f}, {decision.subgoal.y:.2f}) m is")
    there = planner_of(pixels).plan(grid_of(world), decision.subgoal, doors=[place(16, 7)[:2]])
    assert (there.mode, len(there.path)) == ("to_goal", 1)


def test_classes_by_the_robots_own_labels():
    labels = {7: "road", 9: "house", 100: "front_door"}
    cells = np.full((6, 9), 7)
    cells[:, 8], cells[2, 8] = 9, 100
    planner = planner_of(2, "frontier", labels=labels)
    decision = planner.plan(grid_of(cells), place(1, 1))
    assert decision.mode == "to_goal"
    assert math.dist(decision.subgoal[:2], place(8, 2)[:2]) < 2 * PIXEL
    cells[cells == 100] = -1
    assert planner.plan(grid_of(cells), place(1, 1)).mode == "explore"
    cells[3, 4] = 8
    refusal(lambda: planner.plan(grid_of(cells), place(1, 1)), "the map holds 8 in column 4, row 3", "labels")


def test_thresholds_are_those_of_map_saver():
    """As in `nav2_map_server`: free up to 25, occupied from 65, between them unknown."""
    for value, mode in ((0, "gave_up"), (25, "gave_up"), (26, "explore"), (64, "explore"), (65, "gave_up")):
        world = np.pad(np.full((3, 5), FREE), 1, constant_values=100)
        world[2, 5] = value
        assert planner_of().plan(grid_of(world), place(1, 1)).mode == mode, value


def test_a_network_predicts_nothing_from_an_occupancy_map():
    """Neither from cells that were set aside nor from a door behind a wall."""
    cells, robot = random_moment(4, free=0.95)
    cells[:2, :3] = OCCUPIED
    network = random_network(Architecture(widths=(4, 4, 4, 4)))
    planner = MetricPlanner(cell_size=0.05, sensing_range=REACH * 0.05, largest=(16, 16), network=network)
    for doors in ([], [place(1, 0)[:2]]):
        decision = planner.plan(grid_of(cells), place(*robot), doors=doors)
        assert decision.mode == "explore"
        assert {each.cost_to_go for each in decision.candidates} == {0.0}
        assert "cost-to-go" not in decision.why
        planner.set_aside(decision.subgoal)


def test_the_planner_goes_by_a_network_where_there_are_classes():
    cells, robot = random_moment(4, free=0.95)
    network, labels = random_network(Architecture(widths=(4, 4, 4, 4))), {FREE: "road", OCCUPIED: "house"}
    decision = planner_of(planner="dc2g", labels=labels, network=network).plan(grid_of(cells), place(*robot))
    assert decision.mode == "explore"
    assert decision.candidates
    assert not {0.0, None} & {each.cost_to_go for each in decision.candidates}


# --- bad input --------------------------------------------------------------------------------------------------------

ROOM = np.full((4, 5), FREE)


def test_lists_and_tuples_become_a_map():
    grid = MetricMap(ROOM.tolist(), PIXEL, (1, 2, 0))
    np.testing.assert_array_equal(grid.cells, ROOM)
    assert grid.origin == MapFrame(1.0, 2.0, 0.0)
    assert MetricMap(ROOM, PIXEL, (1e7, -1e7, 0)).origin == MapFrame(1e7, -1e7, 0.0)  # as far away as a map may be


@pytest.mark.parametrize(
    ("grid", "pose", "doors", "words"),
    [
        (lambda: grid_of(ROOM), (0, 0), (), ["pose is (0, 0)", "3 numbers"]),
        (lambda: grid_of(ROOM), "here", (), ["pose is 'here'"]),
        (lambda: grid_of(ROOM), (0, math.nan, 0), (), ["pose nan"]),
        (lambda: grid_of(ROOM), (0, 0, 1e300), (), ["pose 1e+300"]),
        (lambda: grid_of(ROOM), (0.0, 0.0, 0.0), (), ["(0.00, 0.00) m", "off the map of 5 x 4", "map frame"]),
        (lambda: grid_of(ROOM), place(1, 1), [(1, 2, 3)], ["door is (1, 2, 3)", "2 numbers"]),
        (lambda: grid_of(ROOM), place(1, 1), [(1, math.inf)], ["door inf"]),
        (lambda: grid_of(ROOM + 101), place(1, 1), (), ["holds 101 in column 0, row 0", "100 (occupied)"]),
        (lambda: grid_of(ROOM - 2), place(1, 1), (), ["cell of the map, -2", "-1: unknown"]),
        (lambda: grid_of(ROOM[0]), place(1, 1), (), ["shape (5,)", "int8 [rows columns]"]),
        (lambda: grid_of(ROOM[:0]), place(1, 1), (), ["shape (0, 5)", "int8 [rows columns]"]),
        (lambda: MetricMap(ROOM + 0.5, 1.0, FRAME), place(1, 1), (), ["float64"]),
        (lambda: MetricMap(ROOM, 0.0, FRAME), place(1, 1), (), ["resolution 0.0"]),
        (lambda: MetricMap(ROOM, math.nan, FRAME), place(1, 1), (), ["resolution nan"]),
        (lambda: MetricMap([[0], [0, 0]], 1.0, FRAME), place(1, 1), (), ["[[0], [0, 0]]", "int8 [rows columns]"]),
        (lambda: MetricMap(ROOM, 1.0, (0, 0)), place(1, 1), (), ["origin is (0, 0)", "3 numbers"]),
        (lambda: MetricMap(ROOM, 1.0, MapFrame(0, 1e9, 0)), place(1, 1), (), ["origin 1000000000"]),
    ],
)
def test_bad_input_is_one_line(grid, pose, doors, words):
    refusal(lambda: planner_of().plan(grid(), pose, doors=doors), *words)


def test_a_range_below_the_cells_of_a_map_is_one_line():
    planner = planner_of(5)  # of 0.25 m, seen up to 0.75 m
    pose = (*FRAME.to_map(1.2, 1.2), 0.0)
    refusal(lambda: planner.plan(MetricMap(ROOM, 0.8, FRAME), pose), "sensing_range 0.75", "cell_size, 0.8 m")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cell_size": 0}, ["cell_size 0", "meters"]),
        ({"sensing_range": math.inf}, ["sensing_range inf"]),
        ({"sensing_range": 0.2}, ["sensing_range 0.2 is less than cell_size, 0.25 m"]),
        ({"field_of_view": -1}, ["field of view -1", "from 1 to 360 degrees"]),
        ({"smallest_cell": 0.3}, ["smallest_cell 0.3", "at most 0.25", "cell_size"]),
        ({"smallest_cell": -1.0}, ["smallest_cell -1.0"]),
        ({"labels": {1: "lawn"}}, ["value 1 in labels", "'lawn'", "grass"]),
        ({"labels": {-1: "road"}}, ["labels: value -1", "0 to 127"]),
        ({"planner": "oracle"}, ["'oracle'"]),
        ({"planner": None}, ["planner for a robot is called None", "dc2g"]),
    ],
)
def test_planners_that_cannot_be_made(options, words):
    refusal(lambda: MetricPlanner(**{"cell_size": 0.25, "sensing_range": 3.0, **options}), *words)
