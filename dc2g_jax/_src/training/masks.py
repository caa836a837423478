"""Observation masks: the cells that a moving robot has seen at some moment (the masks of Algorithm 1)."""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Int, Int8, UInt32

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.poses import Pose, moved
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.world import World


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
    height, width = world.height, world.width

    def look(carry: tuple[Pose, Array], action: Array) -> tuple[tuple[Pose, Array], tuple[Pose, Array]]:
        pose, seen = carry
        pose = moved(pose, action, height, width)
        seen = seen | sensing.visible(pose, world.opaque, width)
        return (pose, seen), (pose, seen)

    first = (start, sensing.visible(start, world.opaque, width))
    _, (poses, seen) = jax.lax.scan(look, first, actions.astype(jnp.int32))
    poses, seen = jax.tree.map(lambda one, rest: jnp.concatenate([one[None], rest])[times], first, (poses, seen))

    def out_of_reach(pose: Pose, seen: UInt32[Array, "n_words h"]) -> Bool[Array, ""]:
        robot = bitboard.single(pose.x, pose.y, *seen.shape)
        reachable = bitboard.flood(robot, world.traversable & seen)
        return ~bitboard.intersects(reachable, world.goals)

    return Moments(seen=seen, exploring=jax.vmap(out_of_reach)(poses, seen))
