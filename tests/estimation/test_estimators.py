"""Who is asked for an estimate, and when."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

import dc2g_jax as dc2g
from dc2g_jax._src.estimation.checkpoints import SHIPPED_NETWORK, save_network
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import WHOLE_MAP, ExactCostToGo, trait, update_where
from dc2g_jax._src.estimation.padding import PaddedNetwork, padded
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.terrain import FREE, FRONT_DOOR, NOTHING, OCCUPIED, OUTSIDE, ROAD, UNKNOWN
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import LearnedScore
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import DC2G, EXPLORE, TO_GOAL
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.planning.selection import ExpectedCost, linear
from tests.support import maps
from tests.support.networks import random_network
from tests.support.refusals import refusal

SHAPE = (7, 33)
asked: list[int] = []


@struct.dataclass
class Counting:
    """Notes how many maps it is given at a time, and tells every cell what it is and how much of the map is known."""

    def init(self, world) -> Any:
        return jnp.arange(world.goals.shape[-1]) if world.goals.ndim > 2 else jnp.int32(0)

    def estimate(self, terrain, state: Any):
        jax.debug.callback(lambda: asked.append(terrain.shape[-1]))
        answer = (terrain + 100 * jnp.sum(terrain != 0, axis=(0, 1)) + 10000 * state).astype(jnp.float32)
        return jnp.stack([answer, -answer])


@pytest.fixture(autouse=True)
def nobody_asked_yet():
    asked.clear()


def some_beliefs(count: int):
    terrain = np.stack([maps.random_terrain(seed, SHAPE, 0.8) for seed in range(count)], axis=-1)
    terrain *= np.stack([maps.random_cells(seed, SHAPE, 0.5) for seed in range(count)], axis=-1)
    return terrain, belief_from_map(terrain, make_pose(*np.zeros((3, count), int)))


@pytest.mark.parametrize("count", [1, 3, 16, 37, 300])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_wanted_robots_get_new_estimates_and_the_others_keep_theirs(count, share):
    terrain, belief = some_beliefs(count)
    wanted = np.random.default_rng(count).random(count) < share
    state, old = jnp.arange(count), jnp.full((2, *SHAPE, count), -1.0)

    def estimate(inputs, before):
        belief, state = inputs
        return Counting().estimate(belief.terrain, state)

    update = jax.jit(lambda *arguments: update_where(estimate, *arguments))
    new = jax.block_until_ready(update(jnp.asarray(wanted), (belief, state), old))
    jax.effects_barrier()
    whole = terrain + 100 * (terrain != 0).sum(axis=(0, 1)) + 10000 * np.arange(count)
    np.testing.assert_array_equal(new, np.where(wanted, np.stack([whole, -whole]), -1))
    assert wanted.sum() <= sum(asked) <= wanted.sum() + max(3, count // 16)


def test_an_estimate_stands_until_something_new_is_seen(street):
    planner, sensing = DC2G(Counting(), complete_rules(2)), complete_rules(2).sensing
    world = World.from_terrain(street)
    plan = jax.jit(planner.plan)
    belief, state = gridworld.reset(world, make_pose(9, 5, 2), sensing), planner.init(world)
    decision, state = plan(belief, state)
    assert int(decision.mode) == EXPLORE
    jax.effects_barrier()
    assert len(asked) == 1

    again, state = plan(belief, state)
    jax.effects_barrier()
    assert len(asked) == 1
    jax.tree.map(np.testing.assert_array_equal, again, decision)

    belief = gridworld.step(world, belief, decision.action, sensing)
    plan(belief, state)
    jax.effects_barrier()
    assert len(asked) == 2


def test_nobody_asks_on_the_way_to_a_goal_in_reach(street):
    planner = DC2G(Counting(), complete_rules(2))
    decision, _ = planner.plan(belief_from_map(street, make_pose(9, 5, 2)), planner.init(World.from_terrain(street)))
    jax.effects_barrier()
    assert int(decision.mode) == TO_GOAL
    assert not asked


class Worst(ExpectedCost):
    """Scores by the highest cost, which is no weighted sum."""

    def summary(self, costs):
        return jnp.max(costs, axis=0, keepdims=True)


class Spread(ExpectedCost):
    """Scores by how far the outcomes lie apart."""

    @linear
    def summary(self, costs):
        return costs[-1:] - costs[:1]


@pytest.mark.parametrize("rule", [ExpectedCost(0.0), Worst(0.0), Spread(0.0)])
def test_a_planner_goes_by_the_summary(street, rule):
    network, world = random_network(Architecture(widths=(4, 4, 4, 4))), World.from_terrain(street)
    belief = gridworld.reset(world, make_pose(4, 5, 1), complete_rules(3).sensing)
    planner = DC2G(network, complete_rules(3), rule)
    estimate = planner.assess(belief, planner.init(world))[0].cost_to_go
    wanted = rule.summary(network.estimate(belief.terrain, ()))[0]
    np.testing.assert_allclose(estimate, wanted, rtol=1e-4, atol=1e-4)


def test_a_network_predicts_nothing_without_classes():
    kinds = np.array([UNKNOWN, FREE, OCCUPIED, FRONT_DOOR, NOTHING, OUTSIDE], np.uint8)
    plain = np.random.default_rng(0).choice(kinds, (*SHAPE, 3))
    plain[4, 20, 1] = ROAD
    costs = random_network(Architecture(widths=(4, 4, 4, 4))).estimate(jnp.asarray(plain), ())
    assert costs.shape == (5, *SHAPE, 3)
    assert [bool(jnp.any(costs[..., robot])) for robot in range(3)] == [False, True, False]


def test_an_estimator_of_any_class_has_the_traits_of_the_protocol():
    network = random_network(Architecture(widths=(4, 4), side=30))
    assert [trait(network, name) for name in ("side", "is_compact", "in_cells")] == [30, True, True]
    for estimator in (Counting(), ExactCostToGo(), None):
        assert [trait(estimator, name) for name in ("side", "is_compact", "extent")] == [None, False, WHOLE_MAP]
        assert padded(estimator) is estimator
    assert padded(network) == PaddedNetwork(network)


def test_several_networks_are_their_mean(tmp_path):
    small = Architecture(widths=(4, 8), patch=2, embedding=0)
    networks = [random_network(small, seed) for seed in range(3)]
    networks[0] = dataclasses.replace(networks[0], score=dc2g.load_network().score)
    places = [str(save_network(tmp_path / str(seed), network)) for seed, network in enumerate(networks)]
    ensemble = dc2g.load_network(",".join(places))
    terrain = jnp.asarray(some_beliefs(5)[0])
    costs = [network.estimate(terrain, ()) for network in networks]
    state = ensemble.init(World.from_terrain(terrain))
    np.testing.assert_allclose(ensemble.estimate(terrain, state), np.mean(costs, axis=0), rtol=1e-5)
    for name in ("in_cells", "knows_outside", "extent", "needs_classes", "side"):
        assert trait(ensemble, name) == trait(networks[0], name)
    assert trait(ensemble, "score") == networks[0].score
    assert isinstance(planner_with("dc2g", complete_rules(4), ensemble), LearnedScore)
    in_grid = padded(ensemble)
    assert in_grid.knows_outside
    costs = [padded(network).estimate(terrain, ()) for network in networks]
    np.testing.assert_allclose(in_grid.estimate(terrain, state), np.mean(costs, axis=0), rtol=1e-5)


def test_networks_that_are_not_alike_have_no_mean(tmp_path):
    other = str(save_network(tmp_path / "other", random_network(Architecture(widths=(4, 8)))))
    shipped = str(resource(SHIPPED_NETWORK))
    refusal(lambda: dc2g.load_network(f"{shipped},{other}"), other, "architecture", shipped, "alike")
    for place in (f"{shipped},", f"{shipped}, {shipped}", f"{shipped},clues:Clues"):
        refusal(lambda place=place: dc2g.load_network(place), place, "each once")


def test_a_folder_may_have_a_comma_in_its_name(tmp_path):
    network = random_network(Architecture(widths=(4, 8)))
    loaded = dc2g.load_network(save_network(tmp_path / "one, two", network))
    assert loaded.architecture == network.architecture
