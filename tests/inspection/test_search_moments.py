"""Moments of a search for its figures, and what a network predicts at one of them."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from dc2g_jax.estimation.weights import fresh_weights
from dc2g_jax.inspection.search_figures import plot_prediction
from dc2g_jax.inspection.search_moments import choose_legs, prediction_at
from dc2g_jax.objectnav.classes import GOALS, PLANT
from dc2g_jax.objectnav.guides import TrueCost
from dc2g_jax.objectnav.midlevel import EncoderArchitecture, SmallEncoder, TrainedEncoder
from dc2g_jax.objectnav.predicted_costs import PredictedCosts
from dc2g_jax.objectnav.simulation import reset, site_of
from tests.support.two_rooms import AGENT, two_rooms


def test_the_last_two_moments_show_the_goal_reacher_if_it_takes_over():
    assert choose_legs(np.zeros(41, bool), 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.arange(41) >= 36, 5) == [0, 12, 24, 36, 40]
    assert choose_legs(np.arange(41) >= 20, 5) == [0, 10, 20, 30, 40]
    assert choose_legs(np.ones(3, bool), 5) == [0, 1, 2]


@struct.dataclass
class EastIsGood:
    """Predicts that costs fall by 0.1, or a meter, from column to column, and that the first row is occupied."""

    def estimate(self, maps, target, features, heading):
        costs = jnp.broadcast_to(-0.1 * jnp.arange(maps.shape[-1]), maps.shape[1:])
        return jnp.zeros(maps.shape[1:]).at[0].set(0.9), costs


def test_a_prediction_lies_beside_the_truth_of_the_same_cells(tmp_path):
    world, side = two_rooms().world, AGENT.mapping.local
    key, small = jax.random.key(0), EncoderArchitecture((4, 5, 6), features=7)
    robot = reset(key, jnp.array([2.55, -2.05, 0.0]), jnp.int32(GOALS.index(PLANT)), AGENT, 5)
    site = site_of(world, "two_rooms", AGENT)
    costs = PredictedCosts(EastIsGood(), TrainedEncoder(fresh_weights(SmallEncoder, small, key), small))
    distances = TrueCost().init(world, 0.2)
    found = jax.tree.map(np.asarray, prediction_at(robot, site, distances, AGENT, costs))
    assert found.occupied[0].all()
    assert not found.occupied[1:].any()
    np.testing.assert_allclose(found.cost[1:], np.broadcast_to(np.arange(side)[::-1], (side - 1, side)), atol=1e-4)
    # The robot is in row 20 and column 25 of the house, and in the middle of its local map.
    rows, columns = np.nonzero(world.free)
    row, column = rows + side // 2 - 20, columns + side // 2 - 25
    assert not found.truly_occupied[row, column].any()
    assert (~found.truly_occupied).sum() == len(rows)
    distance = distances[robot.target][rows, columns]
    np.testing.assert_allclose(found.true_cost[row, column], distance - distance.min(), atol=1e-5)
    for path in plot_prediction(tmp_path / "fig4", found, "plant"):
        assert path.stat().st_size > 5_000
