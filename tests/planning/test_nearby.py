"""What is decided from the ground around a robot is what the whole map gives."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import line_of_sight
from dc2g_jax._src.grid.terrain import ROAD
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.nearby import nearby
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL, Frontier
from dc2g_jax._src.planning.rules import complete_rules, reference_rules
from tests.support.exploration import random_worlds

STEPS = 160


def near_decision(belief, before, planner):
    """The decision of one robot from the ground around it, and whether it is certain, along a batch axis."""
    near, certain = nearby(belief, before, planner.decide, planner.rules.reach)
    return near, certain[None] & (near.mode != GAVE_UP)


@pytest.mark.parametrize(
    "rules", [pytest.param(complete_rules(10, line_of_sight), marks=pytest.mark.slow), reference_rules(14)]
)
def test_a_certain_decision_is_that_of_the_whole_map(rules):
    terrains, starts = random_worlds((60, 83), 700, doors=6, episodes=24)
    worlds = World.from_terrain(np.moveaxis(terrains, 0, -1))
    planner = Frontier(rules)

    def decide_alone(belief, before):
        one = jax.tree.map(lambda leaf: leaf[..., None], (belief, before))
        return jax.tree.map(lambda leaf: leaf[..., 0], near_decision(*one, planner))

    def step(carry, _):
        belief, before = carry
        plan, reachable = planner.plan(belief, before)
        each = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), (belief, before))
        near, certain = jax.lax.map(lambda one: decide_alone(*one), each)
        same = (near.action == plan.action) & (near.length == plan.length) & (near.mode == plan.mode)
        same &= jnp.all(jnp.moveaxis(near.reachable, 0, -1) == reachable, axis=(0, 1))
        return (gridworld.step(worlds, belief, plan.action, rules.sensing), reachable), (certain, same, plan.mode)

    first = gridworld.reset(worlds, make_pose(*np.array(starts).T), rules.sensing)
    run = jax.jit(lambda: jax.lax.scan(step, (first, planner.init(worlds)), length=STEPS)[1])
    certain, same, mode = map(np.asarray, run())
    assert same[certain].all()
    assert all(certain[mode == each].mean() > 0.2 for each in (EXPLORE, TO_GOAL))
    assert not certain.all()


def with_few_unseen(shape: tuple[int, int], pose: np.ndarray, offsets: np.ndarray):
    """Beliefs of robots on open ground who have seen all but cells at these offsets, int [xy unseen robot]."""
    robots = offsets.shape[-1]
    seen = np.ones((*shape, robots), bool)
    x, y = (np.clip(pose[axis] + offsets[axis], 0, shape[1 - axis] - 1) for axis in (0, 1))
    seen[y, x, np.arange(robots)] = False
    road = World.from_terrain(np.full(seen.shape, ROAD, np.uint8))
    seen = bitboard.pack(jnp.asarray(seen))
    return gridworld.belief_of(road, make_pose(*pose), jnp.zeros(robots, jnp.int32), seen)


def decided_nearby(belief, rules):
    """Each robot's decision from the ground around it: whether it is certain, its first action, and its length."""

    def alone(one):
        near, certain = near_decision(one, one.seen, Frontier(rules))
        return certain[0], near.action[0], near.length[0]

    each = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0)[..., None], belief)
    return map(np.asarray, jax.jit(functools.partial(jax.lax.map, alone))(each))


def test_what_is_unseen_beyond_any_side_of_the_window_counts():
    shape, rules, rng = (60, 150), complete_rules(2), np.random.default_rng(0)
    pose = rng.integers(0, [[shape[1]], [shape[0]], [4]], (3, 500))
    belief = with_few_unseen(shape, pose, rng.integers(-30, 31, (2, 3, 500)))
    plan, _ = jax.jit(Frontier(rules).plan)(belief, belief.seen)
    certain, action, length = decided_nearby(belief, rules)
    assert 0.1 < certain.mean() < 0.9
    np.testing.assert_array_equal(action[certain], plan.action[certain])
    np.testing.assert_array_equal(length[certain], plan.length[certain])


def test_nothing_is_beyond_the_border_of_the_map():
    x, y = np.array([[0, 89, 0, 89], [0, 0, 109, 109]])
    inward = np.array([np.where(x == 0, 5, -5), np.where(y == 0, 5, -5)])[:, None]
    certain, _, _ = decided_nearby(with_few_unseen((110, 90), np.array([x, y, range(4)]), inward), complete_rules(2))
    assert certain.all()
