"""Rivals against plain implementations: whole episodes action for action, and what they compute."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.choosing import Situation, exploring_poses
from dc2g_jax._src.planning.named import NETWORK_RIVALS, RIVALS, planner_with
from dc2g_jax._src.planning.planners import MODE_NAMES, reachable_cells
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.rollouts.results import action_letters
from dc2g_jax._src.rollouts.rollout import rollout
from dc2g_jax.rivals.right_hand import RightHand
from dc2g_jax.rivals.scores import (
    CostUtility,
    FrontierPotential,
    Hysteresis,
    NextBestView,
    RandomFrontier,
    VisibleUncertainty,
)
from dc2g_jax.rivals.subgoals import (
    MOST_REGIONS,
    Regions,
    chances,
    expected_costs,
    find_regions,
    rollout_costs,
    sampled_cells,
)
from tests.oracles import numpy_gridworld as oracle
from tests.planning.test_planners import scattered
from tests.support.exploration import SENSING, Scattered, belief_of, random_moment, random_worlds
from tests.support.refusals import refusal

RULES = complete_rules(SENSING)
STEP_LIMIT = 120
FIELD_OF_VIEW = len(oracle.sensing_offsets(SENSING, 0))


# --- episodes ------------------------------------------------------------------------------------------


def square_counts(cells, radius):
    """Cells of the set in the square around each cell, one by one."""
    height, width = cells.shape
    counts = np.zeros(cells.shape, int)
    for y, x in np.ndindex(height, width):
        rows, columns = slice(max(0, y - radius), y + radius + 1), slice(max(0, x - radius), x + radius + 1)
        counts[y, x] = cells[rows, columns].sum()
    return counts


def views(seen):
    """Unobserved cells in view of every pose."""
    return np.stack([oracle._counts(~seen, oracle.sensing_offsets(SENSING, heading)) for heading in range(4)])


def mixed(number):
    """MurmurHash3's last steps, on a Python number."""
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        number = (number ^ number >> shift) * factor % 2**32
    return number ^ number >> 16


def random_score(seen, terrain, pose, distance, kept):
    salt = 0
    for number in (*pose, int(seen.sum())):
        salt = mixed((salt + number + 1) % 2**32)
    cells = [[mixed((y * seen.shape[1] + x) ^ salt) >> 8 for x in range(seen.shape[1])] for y in range(len(seen))]
    return np.broadcast_to(np.array(cells), distance.shape)


def hysteresis_score(seen, terrain, pose, distance, kept):
    return distance - 3.0 * kept


def utility_score(seen, terrain, pose, distance, kept):
    utility = square_counts(~seen, SENSING).astype(np.float32) / np.float32((2 * SENSING + 1) ** 2)
    return np.float32(0.25 / SENSING) * distance.astype(np.float32) - utility


def view_score(seen, terrain, pose, distance, kept):
    with np.errstate(divide="ignore"):
        return np.float32(0.1) * distance.astype(np.float32) - np.log(views(seen).astype(np.float32))


def potential_score(seen, terrain, pose, distance, kept):
    costs = scattered(seen, np.where(seen, terrain, 0)).astype(np.float32)
    area = square_counts(~seen, 2 * SENSING).astype(np.float32) / np.float32((4 * SENSING + 1) ** 2)
    score = -(np.float32(0.5) * area + np.float32(0.5) * np.maximum(0, 1 - costs / np.float32(10)))
    return np.broadcast_to(score, distance.shape)


def uncertainty_score(seen, terrain, pose, distance, kept):
    """With a single outcome nothing is sure: every unobserved cell counts 1."""
    return -views(seen).astype(np.float32) / np.maximum(distance, 1).astype(np.float32)


CHOOSING = {
    "random": (RandomFrontier(RULES), random_score),
    "hysteresis": (Hysteresis(RULES, margin=3.0), hysteresis_score),
    "utility": (CostUtility(RULES, beta=0.25), utility_score),
    "view": (NextBestView(RULES, replan_fraction=0.5, discount=0.1), view_score),
    "potential": (FrontierPotential(RULES, estimator=Scattered(), farthest=10.0), potential_score),
    "uncertainty": (VisibleUncertainty(RULES, estimator=Scattered()), uncertainty_score),
}


def choosing_episode(terrain, pose, score, enough):
    """An episode of a planner that heads for the lowest score, and keeps to it until `enough` cells are new."""
    ground, goals = np.isin(terrain, oracle.TRAVERSABLE_CLASSES), terrain == oracle.FRONT_DOOR
    seen = oracle.visible(pose, SENSING, terrain.shape)
    chosen, seen_then = np.zeros((4, *terrain.shape), bool), np.zeros_like(seen)
    letters, mode = "", "explore"
    while not goals[pose[1], pose[0]] and len(letters) < STEP_LIMIT:
        free = seen & ground
        reached = oracle.reachable(free, *pose[:2])
        if (goals & reached).any():
            mode, actions = "to_goal", oracle.plan_to_goal(free, pose, goals & reached, "complete")
        else:
            poses = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
            if (seen & ~seen_then).sum() >= max(1, enough) or not (chosen & poses).any():
                distance = oracle.distances_from(free, pose)
                scores = np.asarray(score(seen, terrain, pose, distance, chosen & poses), float)
                lowest = np.min(scores, where=poses, initial=np.inf)
                chosen = poses & (scores <= lowest + 1e-5 * (1 + abs(lowest)))
                seen_then = seen.copy()
            mode, actions = "explore", oracle.shortest_actions(free, pose, chosen & poses)
        if actions is None:
            return letters, "gave_up"
        pose = oracle.moved(pose, actions[0], terrain.shape)
        letters += oracle.ACTION_LETTERS[actions[0]]
        seen |= oracle.visible(pose, SENSING, terrain.shape)
    return letters, mode


def right_hand_episode(terrain, pose):
    """The same for a robot with its right hand on the wall, who looks for another wall after going around in vain."""
    ground, goals = np.isin(terrain, oracle.TRAVERSABLE_CLASSES), terrain == oracle.FRONT_DOOR
    height, width = terrain.shape
    seen, walked = oracle.visible(pose, SENSING, terrain.shape), set()
    letters, mode, at_wall, looking, seen_before = "", "explore", False, False, np.zeros(terrain.shape, bool)
    while not goals[pose[1], pose[0]] and len(letters) < STEP_LIMIT:
        free = seen & ground
        reached = oracle.reachable(free, *pose[:2])
        poses = oracle.frontier_expanding_complete(seen, reached, pose, SENSING)
        moved = letters.endswith("F")
        at_wall = at_wall and not looking
        if (seen != seen_before).any():
            walked, looking = set(), False
        looking = looking or (moved and pose in walked)
        if moved:
            walked.add(pose)
        seen_before = seen.copy()

        def state_of(turn, pose=pose, free=free, seen=seen):
            dx, dy = oracle.STEPS[(pose[2] + turn) % 4]
            x, y = pose[0] + dx, pose[1] + dy
            if not (0 <= x < width and 0 <= y < height):
                return "blocked"
            return "free" if free[y, x] else "blocked" if seen[y, x] else "unknown"

        mode = "explore"
        if (goals & reached).any():
            mode, actions = "to_goal", oracle.plan_to_goal(free, pose, goals & reached, "complete")
        elif looking or not poses.any():
            actions = oracle.shortest_actions(free, pose, poses)
        elif at_wall and moved and state_of(1) != "blocked":
            actions = [2]
        elif state_of(0) == "free":
            actions = [0]
        else:
            actions, at_wall = [1], True
        if actions is None:
            return letters, "gave_up"
        pose = oracle.moved(pose, actions[0], terrain.shape)
        letters += oracle.ACTION_LETTERS[actions[0]]
        seen |= oracle.visible(pose, SENSING, terrain.shape)
    return letters, mode


def check_episodes(planner, episode, first_seed):
    terrains, starts = random_worlds((11, 33), first_seed)
    episodes = jnp.arange(len(starts)), make_pose(*np.array(starts).T)
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    done = rollout(planner, worlds, *episodes, sensing=field_of_view(SENSING), step_limit=STEP_LIMIT, slots=4)
    for index, (terrain, pose) in enumerate(zip(terrains, starts, strict=True)):
        expected = episode(terrain, pose)
        assert (action_letters(done, index), MODE_NAMES[done.mode[index]]) == expected, index


@pytest.mark.parametrize(
    "name",
    [name if name in ("random", "uncertainty") else pytest.param(name, marks=pytest.mark.slow) for name in CHOOSING],
)
def test_episodes_of_rivals_that_choose(name):
    planner, score = CHOOSING[name]
    enough = planner.replan_fraction * FIELD_OF_VIEW
    check_episodes(planner, lambda terrain, pose: choosing_episode(terrain, pose, score, enough), 2000)


def test_episodes_of_the_right_hand_rule():
    check_episodes(RightHand(RULES), right_hand_episode, 2100)


# --- what they compute ---------------------------------------------------------------------------------


def random_regions(rng, count):
    """Regions of which some may be missing: start, between and present as arrays of NumPy, and all together."""
    present = rng.random(count) < 0.8
    present[0] = True
    start, between = rng.random(count) * 9, rng.random((count, count)) * 9
    costs = (jnp.asarray(one, jnp.float32) for one in (start, between))
    return start, between, present, Regions(jnp.asarray(present), None, None, *costs)


def test_bellmans_recursion_finds_the_best_of_all_orders():
    rng = np.random.default_rng(1)
    for _ in range(10):
        start, between, present, regions = random_regions(rng, 4)
        success, gain, loss = rng.random(4), rng.random(4) * 9, rng.random() * 9

        def cost_of(order, start=start, between=between, success=success, gain=gain, loss=loss):
            cost, reached = 0.0, 1.0
            for before, one in zip((None, *order), order, strict=False):
                way = start[one] if before is None else between[before, one]
                cost += reached * (way + success[one] * gain[one] + (1 - success[one]) * loss)
                reached *= 1 - success[one]
            return cost

        orders = list(itertools.permutations(np.flatnonzero(present)))
        expected = [min([cost_of(order) for order in orders if order[0] == one], default=np.inf) for one in range(4)]
        success, gain = (jnp.asarray(one, jnp.float32) for one in (success, gain))
        np.testing.assert_allclose(expected_costs(regions, success, gain, loss), expected, rtol=1e-5)


def test_chances_count_the_combinations_in_which_a_region_is_best():
    outcomes = np.array([[1.0, 2.0, 9.0], [3.0, 2.5, 8.0]])
    wins = np.zeros(2)
    for one, other in itertools.product(outcomes[:, 0], outcomes[:, 1]):
        wins[int(other < one)] += 1 / 4
    found = chances(jnp.asarray(outcomes), jnp.array([True, True, False]))
    np.testing.assert_allclose(found, [*wins, 0])


def test_rollouts_are_searches_by_hand():
    rng = np.random.default_rng(2)
    for _ in range(10):
        start, between, present, regions = random_regions(rng, 5)
        there = rng.random((6, 5)) * 9
        expected = np.full(5, np.inf)
        for first in np.flatnonzero(present):
            costs = []
            for goal in there:
                here, cost, left = first, start[first], set(np.flatnonzero(present))
                while here != min(np.flatnonzero(present), key=lambda one, goal=goal: goal[one]):
                    left -= {here}
                    following = min(left, key=lambda one, here=here: between[here, one])
                    cost, here = cost + 3 + between[here, following], following
                costs.append(cost + goal[here])
            expected[first] = np.mean(costs)
        found = rollout_costs(regions, jnp.asarray(there, jnp.float32), 3.0)
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_samples_are_in_proportion_to_their_weights():
    found = sampled_cells(jnp.asarray([[0.0, 1.0], [1.0, 1.0], [3.0, 0.0]]), 8)
    assert [np.bincount(column, minlength=3).tolist() for column in np.asarray(found).T] == [[0, 2, 6], [4, 4, 0]]


def test_regions_are_the_pieces_of_the_frontier_in_the_order_of_their_costs():
    seen_some, reach, find = 0, jax.jit(reachable_cells), jax.jit(find_regions)
    explored = jax.jit(functools.partial(exploring_poses, rules=RULES))
    for seed in range(20):
        terrain, seen, pose = random_moment(seed, (12, 40), 0.7)
        belief = belief_of(terrain, seen, pose)
        reachable = reach(belief, jnp.zeros_like(belief.seen))
        free = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        distance = oracle.distances_from(free, pose)
        candidates = explored(belief, reachable)
        situation = Situation(reachable, candidates, jnp.asarray(distance), candidates, ())
        cost = np.random.default_rng(seed).permutation(terrain.size).reshape(terrain.shape).astype(np.float32)
        regions = find(belief, situation, jnp.asarray(cost))
        open_cells = np.asarray(bitboard.unpack(frontiers.frontier_cells(belief, reachable), belief.width))
        open_cells = open_cells & np.asarray(bitboard.unpack(jnp.bitwise_or.reduce(candidates, axis=0), belief.width))
        pieces, count = ndimage.label(open_cells | oracle._neighbor_of(open_cells))
        best = sorted(min(cost[open_cells & (pieces == piece)]) for piece in range(1, count + 1))[:MOST_REGIONS]
        found = np.asarray(regions.at(jnp.asarray(cost)))[np.asarray(regions.present)]
        assert found.tolist() == best
        places = [(int(x), int(y)) for x, y in zip(regions.x, regions.y, strict=True)][: len(best)]
        for one, (x, y) in enumerate(places):
            assert regions.start[one] == min(way for way in distance[:, y, x] if way >= 0)
            ways = oracle.distances_from(free, (x, y, 0))
            assert [min(ways[:, row, column]) for column, row in places] == regions.between[one, : len(best)].tolist()
        seen_some += len(best)
    assert seen_some > 12


def test_a_network_without_cells_cannot_lead_a_rival():
    from experiments.translator.network import TranslatorArchitecture, TranslatorCostToGo

    translator = TranslatorCostToGo(weights=(), architecture=TranslatorArchitecture(size=32, base_filters=2))
    for name in NETWORK_RIVALS:
        refusal(lambda name=name: planner_with(name, RULES, translator), repr(name), "costs in cells")


def test_names_are_those_of_classes():
    assert planner_with("next_best_view", RULES) == NextBestView(RULES)
    assert len({type(planner_with(name, RULES)) for name in RIVALS}) == len(RIVALS)
    assert math.isinf(planner_with("random_frontier", RULES).replan_fraction)
