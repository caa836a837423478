"""What is decided from the ground around a robot is what the whole map gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.grid import gridworld
from dc2g_jax.grid.poses import make_pose
from dc2g_jax.grid.sensing import line_of_sight
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.planning.nearby import nearby
from dc2g_jax.planning.planners import EXPLORE, Frontier
from dc2g_jax.planning.rules import complete_rules, reference_rules
from tests.support.exploration import random_worlds

STEPS = 80


@pytest.mark.parametrize("rules", [complete_rules(10, line_of_sight), reference_rules(9)])
def test_a_certain_decision_is_that_of_the_whole_map(rules):
    terrains, starts = random_worlds((45, 83), 700, episodes=12)
    worlds = world_from_terrain(np.moveaxis(terrains, 0, -1))
    planner = Frontier(rules)

    def decide_alone(belief, before):
        near = nearby(*jax.tree.map(lambda leaf: leaf[..., None], (belief, before)), rules)
        return near.certain, near.reachable[..., 0], near.first.action[0], near.first.length[0]

    def step(carry, _):
        belief, before = carry
        plan, reachable = planner.plan(belief, before)
        each = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), (belief, before))
        certain, nearby_reachable, action, length = jax.lax.map(lambda one: decide_alone(*one), each)
        same = (action == plan.action) & (length == plan.length) & (plan.mode == EXPLORE)
        same &= jnp.all(jnp.moveaxis(nearby_reachable, 0, -1) == reachable, axis=(0, 1))
        return (gridworld.step(worlds, belief, plan.action, rules.sensing), reachable), (certain, same, plan.mode)

    first = gridworld.reset(worlds, make_pose(*np.array(starts).T), rules.sensing)
    run = jax.jit(lambda: jax.lax.scan(step, (first, planner.init(worlds)), length=STEPS)[1])
    certain, same, mode = map(np.asarray, run())
    assert same[certain].all()
    exploring = mode == EXPLORE
    assert 0.2 < certain[exploring].mean() < 1
