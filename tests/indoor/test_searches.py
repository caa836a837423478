"""Many searches at once: one robot after the other and all together do the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.label_noise import NoiseLevels
from dc2g_jax.indoor.maps.classes import GOALS, OBJECT_CLASSES
from dc2g_jax.indoor.search.searches import is_active, leg, reset, sample_episodes, search_all, site_of
from tests.support.two_rooms import AGENT, two_rooms


@pytest.fixture(scope="module")
def found():
    house = two_rooms()
    episodes = sample_episodes([house], 3, seed=2)
    ended = []
    return house, episodes, search_all(AGENT, [house], episodes, limit=12, on_progress=ended.append), ended


def test_every_search_ends(found):
    _, episodes, made, ended = found
    assert made.track.shape == (len(episodes), 13, 5)
    assert ended[-1] == len(episodes)
    assert ((made.steps == 12) | made.declared).all()
    for track, episode in zip(made.track, episodes, strict=True):
        np.testing.assert_allclose(track[0, :3], (episode.x, episode.y, episode.yaw), rtol=1e-6)
    again = search_all(AGENT, [found[0]], episodes, limit=12)
    jax.tree.map(np.testing.assert_array_equal, again, made)


@pytest.mark.slow
def test_robots_in_a_batch_do_what_they_do_one_by_one(found):
    house, episodes, made, _ = found
    starts = jnp.array([(one.x, one.y, one.yaw) for one in episodes], jnp.float32)
    targets = jnp.array([GOALS.index(OBJECT_CLASSES.index(one.target)) for one in episodes])
    keys = jax.random.split(jax.random.key(0), len(episodes))
    robots = jax.vmap(lambda key, search: reset(key, search, AGENT, 12))(keys, (starts, targets))
    site = jax.tree.map(lambda leaf: jnp.asarray(leaf), site_of(house.world, house.name, AGENT))

    @jax.jit
    @jax.vmap
    def next_leg(robot):
        return jax.lax.cond(is_active(robot), lambda robot: leg(robot, site, AGENT), lambda robot: robot, robot)

    for _ in range(3):
        robots = next_leg(robots)
    np.testing.assert_allclose(robots.track, made.track, atol=1e-3)
    np.testing.assert_array_equal(robots.periods, made.steps)


@pytest.mark.slow
def test_drift_moves_where_a_robot_believes_to_be_and_not_where_it_is(found):
    house, (episode, *_), _, _ = found
    start, target = jnp.array([episode.x, episode.y, episode.yaw]), jnp.int32(0)
    site = site_of(house.world, house.name, AGENT)
    next_leg = jax.jit(lambda robot, noise: leg(robot, site, AGENT.replace(noise=noise)))
    for noise in (NoiseLevels(0.0), NoiseLevels(0.0, position_drift=0.3, yaw_drift=0.1)):
        first = reset(jax.random.key(0), (start, target), AGENT, 30)
        robot = next_leg(next_leg(next_leg(first, noise), noise), noise)
        drift = robot.drift
        assert np.any(drift != 0) == np.any(noise.position_drift != 0)
        x, y, yaw = robot.track[robot.periods, :3]
        np.testing.assert_array_equal(robot.true.position, (x, y))
        np.testing.assert_allclose(robot.vehicle.position, drift[:2] + jnp.stack([x, y]), atol=1e-6)
        np.testing.assert_allclose(robot.vehicle.yaw, drift[2] + yaw, atol=1e-6)
