"""The planner on a robot: the batch planners' actions and the plain implementation's choices, whatever the grid."""

import functools
import inspect
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import ACTION_LETTERS, make_pose
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, OCCUPIED
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import online
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.decisions import Candidate, Decision, RobotPose, explain
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore
from dc2g_jax._src.planning.metric import MetricPlanner
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.planning.planners import MODE_NAMES, Frontier, Planner
from dc2g_jax._src.planning.rules import Rules, complete_rules
from dc2g_jax._src.runtime.errors import InputError
from experiments.benchmarks.extents import Window, WindowedEstimator
from tests.oracles import learned_score_oracle, numpy_gridworld as oracle
from tests.oracles.learned_score_oracle import WAY, Unclear
from tests.support import maps
from tests.support.compiling import compiled_count
from tests.support.exploration import (
    SENSING,
    STEP_LIMIT,
    LowestColumn,
    PlanAlone,
    Scattered,
    random_moment,
    random_worlds,
)
from tests.support.networks import random_network
from tests.support.refusals import refusal

#: Maps, and the largest that planners are made for: one program, three, and one for maps that go on beyond their edges.
SHAPE = (11, 29)
LARGEST = (14, 32)
LARGER = (33, 65)
OPEN_ENDED = (16, 16)


@functools.cache
def network() -> NetworkCostToGo:
    """A tiny network that has learned nothing."""
    return random_network(Architecture(widths=(4, 4, 4, 4), patch=2, embedding=0))


@functools.cache
def planner_of(name: str, largest: tuple[int, int] = LARGEST, open_ended: bool = False) -> OnlinePlanner:
    return OnlinePlanner(
        name,
        network=network(),
        sensing_range=SENSING,
        largest=OPEN_ENDED if open_ended else largest,
        open_ended=open_ended,
    )


def at_first(planner: OnlinePlanner, grid, pose) -> Decision:
    """The decision of a new search."""
    planner.start_anew()
    return planner.plan(grid, pose)


def observed(terrain, seen):
    return np.where(seen, terrain, 0).astype(np.uint8)


def cropped(grid):
    """The smallest part of a grid that holds everything observed, and its origin."""
    rows, columns = (np.flatnonzero((grid != 0).any(axis=axis)) for axis in (1, 0))
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], (int(columns[0]), int(rows[0]))


def episode(planner: OnlinePlanner, terrain, pose, crop: bool = False):
    """What a robot knows, where it is and what it is told, step by step; it does what it is told."""
    seen, decision = oracle.visible(pose, SENSING, terrain.shape), None
    for _ in range(STEP_LIMIT):
        grid, origin = cropped(observed(terrain, seen)) if crop else (observed(terrain, seen), (0, 0))
        decision = planner.plan(grid, pose, origin=origin)
        yield grid, pose, decision
        if decision.action is None:
            return
        pose = oracle.moved(pose, ACTION_LETTERS.index(decision.action), terrain.shape)
        assert pose == decision.path[1]
        seen |= oracle.visible(pose, SENSING, terrain.shape)


def assert_alike(decision: Decision, other: Decision) -> None:
    """The same choice for the same reason; estimates may differ in their last bits, and ranks after the first too."""
    assert (decision.mode, decision.path, decision.actions) == (other.mode, other.path, other.actions)
    ours, theirs = (sorted(each.candidates) for each in (decision, other))
    assert [each[:3] for each in ours] == [each[:3] for each in theirs]
    for one, another in zip(ours, theirs, strict=True):
        assert one.distance == another.distance
        assert one.cost_to_go == pytest.approx(another.cost_to_go, abs=1e-3)
        assert one.score == pytest.approx(another.score, abs=1e-3)


# --- the choice -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["dc2g", "frontier"])
def test_every_step_of_an_episode_is_that_of_the_batch_planner(name):
    batch_planner = planner_with(name, complete_rules(SENSING), network())
    plan, explored = jax.jit(lambda *given: batch_planner.plan(*given)), 0
    terrains, starts = random_worlds(SHAPE, 900, episodes=8)
    for terrain, start in zip(terrains, starts, strict=True):
        state = batch_planner.init(World.from_terrain(terrain))
        for grid, pose, decision in episode(planner_of(name), terrain, start):
            wanted, state = plan(belief_from_map(grid, make_pose(*pose)), state)
            assert decision.mode == MODE_NAMES[wanted.mode]
            assert len(decision.actions) == wanted.length
            if decision.action:
                assert decision.action == ACTION_LETTERS[wanted.action]
            explored += decision.mode == "explore"
    assert explored > 100


def scattered_planner() -> OnlinePlanner:
    """One whose estimator must not be given a grid larger than the map."""
    return OnlinePlanner(network=Scattered(), sensing_range=SENSING, largest=SHAPE)


#: Planners on a robot, and their estimates; none for frontier exploration.
PLANNERS = {
    "frontier": (lambda: planner_of("frontier"), None),
    "dc2g": (lambda: planner_of("dc2g"), jax.jit(network().estimate)),
    "another estimator": (scattered_planner, Scattered().estimate),
}


@pytest.mark.parametrize("name", PLANNERS)
def test_decisions_hold_what_the_plain_implementation_finds(name):
    (make, estimate), modes = PLANNERS[name], dict.fromkeys(("explore", "to_goal", "gave_up"), 0)
    planner = make()
    for seed in range(60):
        terrain, seen, pose = random_moment(seed, SHAPE, 0.8)
        if seed % 2:
            terrain = np.where(terrain == FRONT_DOOR, 3, terrain).astype(np.uint8)
        grid, free = observed(terrain, seen), seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        decision, reached = at_first(planner, grid, pose), oracle.reachable(free, *pose[:2])
        doors = reached & (terrain == FRONT_DOOR)
        found = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
        mode = "to_goal" if doors.any() else "explore" if found.any() else "gave_up"
        assert decision.mode == mode
        modes[mode] += 1
        if mode == "gave_up":
            assert decision == Decision(None, mode, None, (), "", tuple)
            assert decision.candidates == ()
            continue
        targets = np.stack([doors] * 4)
        if mode == "explore":
            check_candidates(planner, decision, found, grid, pose, estimate)
            targets = found if estimate is None else at(decision.subgoal, found.shape)
        actions = oracle.shortest_actions(free, pose, targets)
        assert decision.actions == "".join(ACTION_LETTERS[action] for action in actions)
        check_path(decision, pose, SHAPE)
    assert min(modes.values()) > 1, modes


def at(pose, shape):
    """The set of one pose."""
    cells = np.zeros(shape, bool)
    cells[pose[::-1]] = True
    return cells


def check_candidates(planner: OnlinePlanner, decision: Decision, found, grid, pose, estimate) -> None:
    """Candidates are those of the plain implementation, and the first is the subgoal."""
    ranked = decision.candidates
    assert [each.score for each in ranked] == sorted(each.score for each in ranked)
    assert ranked[0][:3] == decision.subgoal
    distance = oracle.distances_from(np.isin(grid, oracle.TRAVERSABLE_CLASSES), pose)
    assert all(each.distance == distance[each.heading, each.y, each.x] for each in ranked)
    if estimate is None:
        nearest = np.where(found, distance, 10**6).min(axis=0)
        assert sorted((each.y, each.x) for each in ranked) == [tuple(cell) for cell in np.argwhere(found.any(axis=0))]
        assert all(each.score == each.distance == nearest[each.y, each.x] for each in ranked)
        return
    weights = dict(zip(TERMS, np.asarray(planner._planner.weights).tolist(), strict=True))
    costs = np.asarray(estimate(grid, ())).mean(axis=0)
    if np.isin(grid, learned_score_oracle.PLAIN_CLASSES).all():
        costs = np.zeros(SHAPE)
    try:
        wanted = learned_score_oracle.candidates(grid, pose, found, None, costs, weights, SENSING)
    except Unclear:
        return
    assert sorted(each[:3] for each in ranked) == sorted(each.pose for each in wanted)
    by_pose = {each.pose: each for each in wanted}
    for each in ranked:
        other = by_pose[each[:3]]
        way = sum(weights[term] * other.terms[term] for term in WAY)
        assert each.cost_to_go == pytest.approx(other.cost, abs=1e-3)
        assert each.score == pytest.approx(other.score, abs=1e-3)
        assert each.penalty == pytest.approx(other.score - other.cost - way, abs=1e-3)
    assert shown_sum(decision.why) == pytest.approx(ranked[0].score, abs=0.16), decision.why


def shown_sum(why: str) -> float:
    """The sum of the terms that a reason shows, each rounded to a tenth."""
    _, terms = why.split(" = ")
    named = re.findall(r"(-?|[+-] )([\d.]+) (?:predicted cost-to-go|for the way there|for what it reveals)", terms)
    return sum(float(sign.strip() + term) for sign, term in named)


def check_path(decision: Decision, pose, shape) -> None:
    assert decision.path[0] == pose
    for letter, before, after in zip(decision.actions, decision.path[:-1], decision.path[1:], strict=True):
        assert oracle.moved(before, ACTION_LETTERS.index(letter), shape) == after
    assert decision.path[-1] == decision.subgoal
    assert decision.action == (decision.actions[0] if decision.actions else None)


def test_reasons(street):
    planner = planner_of("frontier")
    at_door = planner.plan(street, (2, 0, 3))
    assert (at_door.action, at_door.mode, at_door.path) == (None, "to_goal", ((2, 0, 3),))
    assert at_door.why == "to goal: the robot stands on the door at (2, 0)"
    assert planner.plan(street, (2, 1, 3)).why == "to goal: the door at (2, 0) is reachable in 1 action"
    doorless = np.where(street == FRONT_DOOR, 7, street).astype(np.uint8)
    why = planner.plan(doorless, (2, 3, 0)).why
    assert why == "gave up: no door is reachable, and nothing unobserved can be seen from anywhere reachable"
    corridor = np.full((1, 5), 3, np.uint8)
    corridor[0, 4] = 0
    why = planner.plan(corridor, (0, 0, 1)).why
    assert why == "explore: (0, 0) facing east is the nearest of 4 candidates, 1 action away; next best 2 at (1, 0)"
    why = planner.plan(corridor[:, 3:], (0, 0, 1)).why
    assert why == "explore: (0, 0) facing east is the only candidate, 1 action away"


@pytest.mark.parametrize(
    ("terms", "wanted"),
    [
        ((17.2, 28, 30.4, -0.8), "30.4 = 17.2 predicted cost-to-go + 14.0 for the way there - 0.8 for what it reveals"),
        ((17.2, 1, 19.7, 2.0), "19.7 = 17.2 predicted cost-to-go + 0.5 for the way there + 2.0 for what it reveals"),
        ((17.2, 28, 17.2, 0.0), "17.2 = 17.2 predicted cost-to-go"),
        ((0.0, 28, -1.0, -15.0), "-1.0 = 14.0 for the way there - 15.0 for what it reveals"),
        ((0.0, 1, -2.0, -2.0), "-2.0 = -2.0 for what it reveals"),
        ((0.0, 1, 0.0, 0.0), "0.0 = 0.0 predicted cost-to-go"),
        ((None, 28, 7.0, 0.0), "7.0"),
    ],
)
def test_a_reason_shows_how_the_score_comes_about(terms, wanted):
    cost_to_go, distance, score, penalty = terms
    best = Candidate(4, 5, 0, cost_to_go, distance, score, penalty)
    path = [RobotPose(0, 5, 0)] * distance + [RobotPose(4, 5, 0)]
    others = [best, best._replace(x=9, score=40.0)]
    place = "explore: (4, 5) facing east has the lowest score of 2 candidates"
    wanted += f", {distance} action{'s' if distance > 1 else ''} away"
    assert explain("explore", path, others) == f"{place}, {wanted}; next best 40.0 at (9, 5)"
    for other, shown in ((score, f"{score:.1f}"), (score + 0.02, "0.02 more")):
        close = [best, best._replace(x=9, score=other)]
        assert explain("explore", path, close) == f"{place}, {wanted}; next best {shown} at (9, 5)"


def test_a_planner_of_ones_own_shows_its_own_candidates_and_scores():
    rules = complete_rules(SENSING)
    alone, lowest = (
        OnlinePlanner(planner, sensing_range=SENSING, largest=SHAPE)
        for planner in (PlanAlone(rules), LowestColumn(rules))
    )
    explored = 0
    for seed in range(12):
        terrain, seen, pose = random_moment(seed, SHAPE, 0.8)
        grid = observed(np.where(terrain == FRONT_DOOR, 3, terrain).astype(np.uint8), seen)
        wanted = planner_of("frontier").plan(grid, pose)
        found = at_first(alone, grid, pose)
        assert (found, found.candidates, found.why) == (wanted, wanted.candidates, wanted.why)
        found = at_first(lowest, grid, pose)
        assert found.mode == wanted.mode
        assert sorted(each[:2] for each in found.candidates) == sorted(each[:2] for each in wanted.candidates)
        for each in found.candidates:
            assert (each.score, each.cost_to_go) == (each.x, None)
        if found.mode == "explore":
            explored += 1
            assert found.subgoal.x == min(each.x for each in wanted.candidates)
            assert found.subgoal == found.candidates[0][:3]
    assert explored > 5


def test_an_estimator_with_an_extent_is_asked_about_it_alone():
    side, prior = 7, 50.0
    planner = OnlinePlanner(
        network=WindowedEstimator(Scattered(), Window(side, prior)), sensing_range=SENSING, largest=SHAPE
    )
    found = {"inside": 0, "beyond": 0}
    for seed in range(30):
        terrain, seen, pose = random_moment(seed, SHAPE, 0.8)
        grid = observed(np.where(terrain == FRONT_DOOR, 3, terrain).astype(np.uint8), seen)
        window = np.pad(grid, side)[pose[1] + side - 3 : pose[1] + side + 4, pose[0] + side - 3 : pose[0] + side + 4]
        costs = np.asarray(Scattered().estimate(window, ()))[0]
        for each in at_first(planner, grid, pose).candidates:
            x, y = each.x - pose[0] + 3, each.y - pose[1] + 3
            inside = 0 <= x < side and 0 <= y < side
            assert each.cost_to_go == pytest.approx(costs[y, x] if inside else prior)
            found["inside" if inside else "beyond"] += 1
    assert min(found.values()) > 5, found


# --- the grid the map is laid into, and where the map lies ------------------------------------------------------------


@pytest.mark.parametrize("name", ["frontier", "dc2g"])
def test_decisions_do_not_depend_on_the_grid(name):
    fitting, larger = planner_of(name), planner_of(name, LARGER)
    for seed in range(25):
        shape = ((5, 7), (11, 29), (14, 32), (12, 31), (1, 32))[seed % 5]
        terrain, seen, pose = random_moment(seed, shape, 0.8)
        grid = observed(terrain, seen)
        assert_alike(at_first(fitting, grid, pose), at_first(larger, grid, pose))


def test_a_robot_that_sees_all_around_explores_by_what_it_sees():
    planner = OnlinePlanner("frontier", sensing_range=SENSING, field_of_view=360, largest=SHAPE)
    terrains, starts = random_worlds(SHAPE, 900, episodes=4)
    for terrain, pose in zip(terrains, starts, strict=True):
        seen = oracle.visible(pose, SENSING, SHAPE, 360)
        reached = oracle.reachable(seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES), *pose[:2])
        wanted = oracle.frontier_expanding_complete(seen, reached, pose, SENSING, 360)
        decision = planner.plan(observed(terrain, seen), pose)
        if decision.mode == "explore":
            found = [[each.y, each.x] for each in decision.candidates]
            assert sorted(found) == np.argwhere(wanted.any(axis=0)).tolist()


def test_beyond_a_map_of_known_size_there_is_nothing_to_explore():
    road = np.full((6, 6), 3, np.uint8)
    assert planner_of("dc2g").plan(road, (2, 2, 0)).mode == "gave_up"
    assert planner_of("dc2g", open_ended=True).plan(road, (2, 2, 0)).mode == "explore"
    beyond = planner_of("frontier", open_ended=True).plan(road, (2, 2, 0))
    # From every cell on the border something can be seen.
    border = {(x, y) for x in range(6) for y in range(6) if {x, y} & {0, 5}}
    assert border <= {(each.x, each.y) for each in beyond.candidates}


@pytest.mark.parametrize("open_ended", [False, True])
@pytest.mark.parametrize("name", ["frontier", "dc2g"])
def test_everything_is_in_the_coordinates_of_the_origin(name, open_ended):
    def moved(pose):
        return (pose[0] - 1000, pose[1] + 7, *pose[2:])

    planner = planner_of(name, open_ended=open_ended)
    for seed in range(6):
        terrain, seen, pose = random_moment(seed, (11, 15), 0.8)
        here, there = (
            planner.plan(observed(terrain, seen), place(pose), origin=place((0, 0)))
            for place in (lambda pose: pose, moved)
        )
        assert there.actions == here.actions
        assert there.path == tuple(moved(each) for each in here.path)
        assert there.candidates == tuple(Candidate(*moved(each)) for each in here.candidates)


def test_an_open_ended_map_may_grow_in_all_directions_at_every_step():
    """Cut to what has been observed, the map grows as the robot goes; its decisions are those in the whole world."""
    directions = set()
    for seed in range(6):
        terrain = np.pad(maps.random_terrain(seed, (14, 14), 0.8, doors=0), 1, constant_values=2)
        terrain[2 + seed, 3] = 3
        terrain[14, 13 - seed] = FRONT_DOOR
        start = maps.random_pose(seed, np.isin(terrain, oracle.TRAVERSABLE_CLASSES) & (terrain != FRONT_DOOR))
        success, letters, _ = oracle.run_episode(
            terrain, start, "frontier", rules="complete",
            sensing_radius=SENSING, expanding_radius=SENSING, max_steps=STEP_LIMIT,
        )  # fmt: skip
        steps = list(episode(planner_of("frontier", open_ended=True), terrain, start, crop=True))
        assert "".join(decision.action or "" for _, _, decision in steps) == letters
        assert (steps[-1][-1].mode == "to_goal") == success
        directions |= directions_of_growth(terrain, start, letters)
    assert directions == {"left", "up", "right", "down"}


def directions_of_growth(terrain, pose, letters: str) -> set[str]:
    grid = observed(terrain, oracle.visible(pose, SENSING, terrain.shape))
    (before, (left, top)), found = cropped(grid), set()
    for letter in letters:
        pose = oracle.moved(pose, ACTION_LETTERS.index(letter), terrain.shape)
        grid = np.where(oracle.visible(pose, SENSING, terrain.shape), terrain, grid)
        after, (new_left, new_top) = cropped(grid)
        found |= {"left"} if new_left < left else set()
        found |= {"up"} if new_top < top else set()
        found |= {"right"} if new_left + after.shape[1] > left + before.shape[1] else set()
        found |= {"down"} if new_top + after.shape[0] > top + before.shape[0] else set()
        before, left, top = after, new_left, new_top
    return found


@pytest.mark.parametrize("name", ["frontier", "dc2g"])
def test_no_size_of_map_compiles_anything(name):
    planner = planner_of(name, LARGER)
    compiled = compiled_count(online._look), compiled_count(online._first_state)
    for height, width in ((1, 1), (3, 32), (33, 2), (32, 32), (32, 33), (33, 64), (33, 65)):
        decision = planner.plan(np.full((height, width), 3, np.uint8), (0, 0, 0))
        assert decision.mode == "gave_up"
        corner = np.full((height, width), 3, np.uint8)
        corner[-1, -1] = 0 if height * width > 1 else 3
        planner.plan(corner, (0, 0, 0))
    assert (compiled_count(online._look), compiled_count(online._first_state)) == compiled


def test_maps_of_up_to_100_by_100_cells_are_expected():
    for planner in (OnlinePlanner, MetricPlanner):
        assert inspect.signature(planner).parameters["largest"].default == (100, 100)


@struct.dataclass
class Anew(Planner):
    """Frontier exploration whose scores are the number of decisions of the search. It knows no changes of the map."""

    rules: Rules = struct.field(pytree_node=False)

    def init(self, world):
        return Frontier(self.rules).init(world), jnp.float32(0)

    def assess(self, belief, state):
        assessment, reachable = Frontier(self.rules).assess(belief, state[0])
        score = jnp.full((belief.height, belief.width), state[1] + 1)
        return assessment.replace(score=score), (reachable, state[1] + 1)


@struct.dataclass
class GoesOn(Anew):
    """The same, and it does."""

    def revised(self, state, changed):
        return Frontier(self.rules).revised(state[0], changed), state[1]


def test_a_search_goes_on_or_starts_anew():
    road = np.full(SHAPE, 3, np.uint8)
    road[:, 20:] = 0
    grown, fewer, other = road.copy(), road.copy(), road.copy()
    grown[:, 20:22], fewer[:4, 3:9], other[3:, :20] = 3, 0, 7
    planners = [
        OnlinePlanner(kind(complete_rules(SENSING)), sensing_range=SENSING, largest=SHAPE) for kind in (GoesOn, Anew)
    ]

    def decisions(grid, left=0):
        """How many decisions the searches have made."""
        return [planner.plan(grid, (left, 0, 0), origin=(left, 0)).candidates[0].score for planner in planners]

    assert [decisions(grid) for grid in (road, road, grown)] == [[1, 1], [2, 2], [3, 3]]
    assert [decisions(grid) for grid in (fewer, road)] == [[4, 1], [5, 2]]  # some cells are lost, then seen again
    assert [decisions(grid) for grid in (other, other)] == [[1, 1], [2, 2]]  # another map
    assert [decisions(other, left=1) for _ in range(2)] == [[1, 1], [2, 2]]
    for planner in planners:
        refusal(lambda: planner.plan(other[:0], (1, 0, 0), origin=(1, 0)), "shape (0, 29)")  # noqa: B023
    assert decisions(other, left=1) == [3, 3]


@pytest.mark.parametrize("name", ["frontier", "dc2g"])
def test_a_robot_that_is_carried_to_other_ground_starts_anew(name):
    planner, rooms = planner_of(name), np.full((9, 13), FREE, np.uint8)
    rooms[:, 6], rooms[1, 1], rooms[6:, 9:] = OCCUPIED, FRONT_DOOR, 0
    planner.start_anew()
    assert planner.plan(rooms, (3, 3, 0)).mode == "to_goal"
    carried = planner.plan(rooms, (9, 3, 0))
    assert carried.mode == "explore"
    assert_alike(carried, at_first(planner, rooms, (9, 3, 0)))


def test_planners_that_wrap_others_go_on_or_start_anew():
    """The bound counts the decisions of a search; it ends where cells change, or starts anew with the search."""
    rules, road = complete_rules(SENSING), np.full(SHAPE, 3, np.uint8)
    road[:, 20:] = 0
    changed = np.where(np.arange(SHAPE[1]) == 10, 7, road).astype(np.uint8)
    for wrapped, taken in ((PlanAlone(rules), [1, 2, 1]), (planner_with("dc2g", rules, network()), [1, 2, 3])):
        planner, counts = OnlinePlanner(Bounded(wrapped, rules, 2.0, 3.0), sensing_range=SENSING, largest=SHAPE), []
        for grid in (road, road, changed):
            planner.plan(grid, (3, 3, 0))
            counts.append(int(planner._memory.state.taken))
        assert counts == taken


def test_in_an_open_ended_world_the_frame_stays_while_there_is_a_margin():
    planner = OnlinePlanner("frontier", sensing_range=8, largest=(40, 40), open_ended=True)
    frames = []
    for first, side in ((0, 12), (-8, 20), (-9, 21), (-9, 39), (5, 12)):
        planner.plan(np.full((side, side), 3, np.uint8), (6, 6, 0), origin=(first, first))
        frames.append(planner._memory.frame)
    assert frames[0] == frames[1] == (-32, -32, 76, 76)
    assert frames[2] == (-41, -41, 85, 85)
    assert frames[3] == (-33, -33, 87, 87)  # at most the largest map with its margin
    assert frames[4] == (-27, -27, 76, 76)  # another map


def test_cells_may_change_between_calls():
    """A map is planned in as it is: ground that turned out blocked, or was never there, is forgotten."""
    planner, road = planner_of("dc2g"), np.full((9, 9), 3, np.uint8)
    road[8, 8] = FRONT_DOOR
    assert planner.plan(road, (0, 0, 0)).mode == "to_goal"
    blocked = road.copy()
    blocked[5] = 7
    assert planner.plan(blocked, (0, 0, 0)).mode == "gave_up"
    lost = road.copy()
    lost[5] = 0
    assert planner.plan(lost, (0, 0, 0)).mode == "explore"
    assert planner.plan(road, (0, 0, 0)).mode == "to_goal"


@pytest.mark.parametrize("seed", range(4))
def test_exploration_ends_whatever_the_weights_of_the_score(seed):
    """A robot on an unchanged map keeps to its subgoal, or two poses could call it back and forth."""
    rng = np.random.default_rng(seed)
    weights = jnp.asarray(rng.normal(size=len(TERMS)), jnp.float32)
    planner = OnlinePlanner(LearnedScore(complete_rules(SENSING), weights), sensing_range=SENSING, largest=LARGEST)
    free = rng.random(SHAPE) < 0.8
    y, x = np.argwhere(free)[0].tolist()
    pose, seen, without_news = (x, y, 0), np.zeros(SHAPE, bool), 0
    for _ in range(40 * free.sum()):
        before, seen = seen.sum(), seen | oracle.visible(pose, SENSING, SHAPE)
        without_news = 0 if seen.sum() > before else without_news + 1
        assert without_news <= 4 * free.sum()
        decision = planner.plan(np.where(seen, np.where(free, FREE, OCCUPIED), 0).astype(np.uint8), pose)
        if decision.action is None:
            break
        pose = oracle.driven(pose, "FLR".index(decision.action), free)
    assert decision.mode == "gave_up"


# --- bad input --------------------------------------------------------------------------------------------------------

ROAD = np.full((5, 6), 3, np.uint8)


def with_cell(value: int) -> np.ndarray:
    grid = ROAD.copy()
    grid[2, 1] = value
    return grid


@pytest.mark.parametrize(
    ("grid", "pose", "origin", "words"),
    [
        (ROAD.astype(np.int32), (1, 2, 0), (0, 0), ["int32", "uint8"]),
        (ROAD[0], (1, 2, 0), (0, 0), ["(6,)", "[rows columns]"]),
        ([[3, 3], [3]], (0, 0, 0), (0, 0), ["grid is [[3, 3], [3]]", "uint8 [rows columns]"]),
        (ROAD[:0], (1, 2, 0), (0, 0), ["(0, 6)", "uint8 [rows columns]"]),
        (np.full((15, 5), 3, np.uint8), (1, 2, 0), (0, 0), ["(15, 5)", "at most 14 rows", "larger"]),
        (np.full((5, 33), 3, np.uint8), (1, 2, 0), (0, 0), ["(5, 33)", "32 columns", "larger"]),
        (with_cell(16), (0, 0, 0), (0, 0), ["grid[2, 1] 16", "from 0 to 15", "dc2g_jax.grid.CLASS"]),
        (ROAD, (6, 2, 0), (0, 0), ["(6, 2)", "columns 0 to 5", "origin"]),
        (ROAD, (1, 2, 0), (0, 3), ["(1, 2)", "rows 3 to 7", "origin"]),
        (ROAD, (-1, 2, 0), (0, 0), ["(-1, 2)", "off the map"]),
        (ROAD, (1, 2, 4), (0, 0), ["heading 4", "0 to 3", "-y"]),
        (ROAD, (1, 2, -1), (0, 0), ["heading -1"]),
        (ROAD, (1.5, 2, 0), (0, 0), ["pose is (1.5, 2, 0)", "3 whole numbers"]),
        (ROAD, (1, 2), (0, 0), ["pose is (1, 2)", "3 whole numbers"]),
        (ROAD, None, (0, 0), ["pose", "None"]),
        (ROAD, ROAD, (0, 0), ["pose is array([[3, 3", "..."]),
        (ROAD, (1, 2, 0), (0.0, 0), ["origin is (0.0, 0)", "2 whole numbers"]),
        (with_cell(0), (1, 2, 0), (0, 0), ["(1, 2)", "not been observed", "15"]),
        (with_cell(7), (1, 2, 0), (0, 0), ["(1, 2)", "'house'", "15"]),
    ],
)
def test_bad_input_is_one_line_with_the_value_and_the_remedy(grid, pose, origin, words):
    with pytest.raises(InputError) as refused:
        planner_of("frontier").plan(grid, pose, origin=origin)
    message = str(refused.value)
    assert "\n" not in message
    assert all(word in message for word in words), message


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"planner": "oracle"}, ["'oracle'", "frontier, dc2g, dc2g_uncertain"]),
        ({"planner": "true_cost_to_go"}, ["'true_cost_to_go'", "one of your own"]),
        ({"planner": Frontier(complete_rules(3))}, ["sensing_range 8", "rules say 3"]),
        ({"network": "nowhere"}, ["nowhere"]),
        ({"sensing_range": 0}, ["sensing_range 0", "from 1 to 64 cells"]),
        ({"sensing_range": 65}, ["sensing_range 65", "from 1 to 64 cells"]),
        ({"largest": (0, 5)}, ["largest 0", "at least 1"]),
        ({"largest": (5,)}, ["largest", "whole numbers"]),
        ({"largest": 50}, ["largest is 50", "whole numbers"]),
        ({"sensing_range": 2.5}, ["sensing_range 2.5", "whole number"]),
        ({"field_of_view": 400}, ["field of view 400", "from 1 to 360 degrees"]),
        ({"field_of_view": 180, "settings": "reference"}, ["field of view 180", "'reference'", "90 degrees only"]),
        (
            {"planner": Frontier(complete_rules(8, degrees=120)), "field_of_view": 90},
            ["field_of_view 90", "rules say 120 degrees", "leave it out"],
        ),
        ({"largest": (5.5, 5)}, ["5.5", "whole numbers"]),
    ],
)
def test_planners_that_cannot_be_made(options, words):
    with pytest.raises(InputError) as refused:
        OnlinePlanner(**options)
    assert all(word in str(refused.value) for word in words), refused.value


def test_an_estimate_that_is_no_number_is_refused():
    broken = NetworkCostToGo(
        weights=jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), network().weights),
        architecture=network().architecture,
    )
    grid = np.full((3, 3), 3, np.uint8)
    grid[2, 2] = 0
    with pytest.raises(InputError, match="weights"):
        OnlinePlanner(network=broken, sensing_range=SENSING, largest=LARGEST).plan(grid, (0, 0, 0))


def test_a_class_of_ones_own_is_named_by_its_module():
    by_name, by_class = (
        OnlinePlanner(name, largest=(8, 8)) for name in ("frontier", f"{Frontier.__module__}:Frontier")
    )
    assert by_class.plan(ROAD, (2, 3, 0)).action == by_name.plan(ROAD, (2, 3, 0)).action
    with pytest.raises(InputError, match="'no_such_module:Mine': cannot be imported"):
        OnlinePlanner("no_such_module:Mine", largest=(8, 8))
