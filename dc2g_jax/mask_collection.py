"""Observation masks taken along the paths of planners (the masks of Algorithm 1, from robots rather than by hand)."""

import functools
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int, Int8, UInt32

from dc2g_jax.datasets.masks import Moments, moments_along
from dc2g_jax.grid.sensing import Kernel
from dc2g_jax.grid.world import World
from dc2g_jax.planning.planners import Planner
from dc2g_jax.rollout import Episodes, rollout

_EPISODES_PER_CALL = 128


class Masks(NamedTuple):
    """Observation masks and the worlds they belong to.

    Attributes:
      boards: observed cells.
      world: index of each mask's world.
    """

    boards: UInt32[np.ndarray, "masks h n_words"]
    world: Int[np.ndarray, "masks"]


@functools.partial(jax.jit, static_argnames=("sensing",))
def _moments(
    worlds: World,
    episodes: Episodes,
    actions: Int8[Array, "b t"],
    times: Int[Array, "b k"],
    *,
    sensing: Kernel,
) -> Moments:
    own_worlds = jax.tree.map(lambda leaf: leaf[episodes.world], worlds)
    return jax.vmap(functools.partial(moments_along, sensing=sensing))(own_worlds, episodes.start, actions, times)


def collect_masks(
    planner: Planner,
    worlds: World,
    episodes: Episodes,
    *,
    sensing: Kernel,
    per_episode: int,
    seed: int,
    step_limit: int = 300,
) -> Masks:
    """Run a planner and keep what its robots had seen at random moments while no goal was in reach.

    Args:
      planner: leads the robots.
      worlds: stack of worlds of one size.
      episodes: world index and first pose of each episode.
      sensing: the robots' field of view.
      per_episode: moments drawn from each episode; those with a goal in reach are left out.
      seed: of the moments.
      step_limit: actions after which an episode ends.
    """
    done = rollout(planner, worlds, episodes, sensing=sensing, step_limit=step_limit)
    rng = np.random.default_rng(seed)
    times = (rng.random((len(episodes), per_episode)) * done.steps[:, None]).astype(np.int32)
    boards, owners = [], []
    for first in range(0, len(episodes), _EPISODES_PER_CALL):
        # The last call repeats the last episode, so that all calls have one shape.
        part = np.minimum(np.arange(first, first + _EPISODES_PER_CALL), len(episodes) - 1)
        some = jax.tree.map(lambda leaf, part=part: leaf[part], episodes)
        moments = _moments(worlds, some, done.actions[part], times[part], sensing=sensing)
        keep = np.array(moments.exploring)
        keep[len(episodes) - first :] = False
        boards.append(np.asarray(moments.seen)[keep])
        owners.append(np.broadcast_to(np.asarray(some.world)[:, None], keep.shape)[keep])
    return Masks(boards=np.concatenate(boards), world=np.concatenate(owners))
