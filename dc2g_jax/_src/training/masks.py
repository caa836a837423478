"""Observation masks: what robots have seen at moments of rollouts, instead of the hand-drawn masks of Algorithm 1."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float, Int, Int8, UInt32

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import DC2G, Frontier, Planner
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.programs import jit
from dc2g_jax._src.rollouts.devices import deal, gather, mesh_of, on_each, replicate
from dc2g_jax._src.rollouts.rollout import Episodes, rollout

_EPISODES_PER_CALL = 128

#: Errors of the leading planners: standard deviations of the logarithm of the cost-to-go's error.
_NOISE = (0.2, 0.5, 1.0)

#: Number of planners of `leading_planners`.
LEADERS = 1 + len(_NOISE)


def _smooth_noise(rng: np.random.Generator, height: int, width: int) -> Float[np.ndarray, "h w"]:
    """A smooth random field of zero mean and unit standard deviation, float32."""
    coarse = rng.standard_normal((8, 8)).astype(np.float32)
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return (field - field.mean()) / field.std()


def leading_planners(rules: Rules, height: int, width: int, *, seed: int) -> list[Planner]:
    """Planners whose robots explore about as well as those that will use the network, in diverse ways.

    These are frontier exploration, and DC2G with the exact cost-to-go times smooth log-normal errors of increasing
    size.

    Args:
      rules: rules of the planners.
      height: rows of the maps.
      width: columns of the maps.
      seed: seed of the errors.
    """
    rng = np.random.default_rng([seed, rules.sensing.radius])
    errors = [jnp.asarray(noise * _smooth_noise(rng, height, width)) for noise in _NOISE]
    return [
        Frontier(rules=rules),
        *(DC2G(estimator=ExactCostToGo(log_error=error), rules=rules) for error in errors),
    ]


class Masks(NamedTuple):
    """Observation masks and their worlds.

    Attributes:
      boards: observed cells.
      world: index of each mask's world.
    """

    boards: UInt32[np.ndarray, "masks n_words h"]
    world: Int[np.ndarray, "masks"]


@struct.dataclass
class Moments:
    """Moments of one episode.

    Attributes:
      seen: board of the cells observed so far.
      exploring: whether no goal is reachable yet, so that a planner would ask for a cost-to-go.
    """

    seen: UInt32[Array, "*batch n_words h"]
    exploring: Bool[Array, "*batch"]


def moments_along(
    world: World, start: Pose, actions: Int8[Array, "t"], times: Int[Array, "k"], *, sensing: Kernel
) -> Moments:
    """The cells that a robot that takes `actions` from `start` has seen after `times[k]` actions.

    Path and sensor are independent: any kernel may be used along any path.

    Args:
      world: the map.
      start: first pose.
      actions: actions taken; actions beyond the largest of `times` have no effect.
      times: numbers of actions, each from 0 to `len(actions)`.
      sensing: field of view.
    """

    def look(carry: tuple[Pose, Array], action: Array) -> tuple[tuple[Pose, Array], tuple[Pose, Array]]:
        pose, seen = carry
        pose = gridworld.move(world, pose, action)
        seen = seen | sensing.visible(pose, world.opaque, world.width)
        return (pose, seen), (pose, seen)

    first = (start, sensing.visible(start, world.opaque, world.width))
    _, (poses, seen) = jax.lax.scan(look, first, actions.astype(jnp.int32))
    poses, seen = jax.tree.map(lambda one, rest: jnp.concatenate([one[None], rest])[times], first, (poses, seen))

    def out_of_reach(pose: Pose, seen: UInt32[Array, "n_words h"]) -> Bool[Array, ""]:
        robot = bitboard.single(pose.x, pose.y, *seen.shape)
        reachable = bitboard.flood(robot, world.traversable & seen)
        return ~bitboard.intersects(reachable, world.goals)

    return Moments(seen=seen, exploring=jax.vmap(out_of_reach)(poses, seen))


@functools.partial(jit, static_argnames=("mesh", "sensing"))
def _moments(
    dealt: tuple[Episodes, Int8[Array, "devices own t"], Int[Array, "devices own k"]],
    worlds: World,
    *,
    mesh: Mesh,
    sensing: Kernel,
) -> Moments:
    """What was seen in episodes, from their actions, at some of their moments."""

    def own(part: tuple[Episodes, Array, Array], worlds: World) -> Moments:
        episodes, actions, times = part
        own_worlds = jax.tree.map(lambda leaf: leaf[..., episodes.world], worlds)
        along = jax.vmap(functools.partial(moments_along, sensing=sensing), in_axes=(-1, 0, 0, 0))
        return along(own_worlds, episodes.start, actions, times)

    return on_each(own, mesh, dealt, worlds)


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
    """Run a planner and collect the observed cells of its robots at random moments without a reachable goal.

    Args:
      planner: planner of the robots.
      worlds: stack of worlds of one size.
      episodes: world index and first pose of each episode; at least one.
      sensing: field of view of the robots.
      per_episode: moments sampled from each episode; those with a reachable goal are dropped.
      seed: seed of the moments.
      step_limit: actions after which an episode ends.
    """
    done = rollout(planner, worlds, episodes, sensing=sensing, step_limit=step_limit)
    rng = np.random.default_rng(seed)
    times = (rng.random((len(episodes), per_episode)) * done.steps[:, None]).astype(np.int32)
    boards, owners, mesh = [], [], mesh_of()
    worlds = replicate(worlds, mesh)
    for first in range(0, len(episodes), _EPISODES_PER_CALL):
        # The last call repeats the last episode, so that all calls have the same shape.
        part = np.minimum(np.arange(first, first + _EPISODES_PER_CALL), len(episodes) - 1)
        some = jax.tree.map(lambda leaf, part=part: leaf[part], episodes)
        dealt = deal((some, done.actions[part], times[part]), len(part), mesh)
        moments = gather(_moments(dealt, worlds, mesh=mesh, sensing=sensing), len(part))
        keep = moments.exploring & (np.arange(first, first + len(part)) < len(episodes))[:, None]
        boards.append(moments.seen[keep])
        owners.append(np.broadcast_to(np.asarray(some.world)[:, None], keep.shape)[keep])
    return Masks(boards=np.concatenate(boards), world=np.concatenate(owners))


def by_house(parts: Sequence[Masks]) -> Masks:
    """Concatenate collections of masks, ordered by house.

    Raises:
      InputError: there are no masks.
    """
    if not any(len(part.world) for part in parts):
        raise InputError(
            "no mask: wherever a robot starts in these houses, it sees a front door at once, so there is nothing to "
            "learn; give larger houses, or robots that see less far"
        )
    boards, world = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(world, kind="stable")
    return Masks(boards[order], world[order])
