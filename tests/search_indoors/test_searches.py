"""Many searches at once: one robot after the other and all together do the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.search_indoors.maps.classes import GOALS, OBJECT_CLASSES
from dc2g_jax._src.search_indoors.maps.mapping import IndoorMapSettings
from dc2g_jax._src.search_indoors.search.searches import is_active, leg, reset, sample_episodes, search_all, site_of
from tests.support.refusals import refusal
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


def test_cells_of_another_size_are_refused(found):
    house, episodes, _, _ = found
    fine = AGENT.replace(mapping=IndoorMapSettings(cells=120, local=60, cell_size=0.05))
    refusal(lambda: search_all(fine, [house], episodes), house.name, "0.1 m", "0.05 m", "make them alike")
