"""Random frontier: the yardstick below which a planner has learned nothing from the map."""

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, UInt32

from dc2g_jax.grid import Belief, bitboard
from dc2g_jax.planning import ChoosingPlanner, PoseValues, Situation


def _mixed(number: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
    """A number whose bits all depend on all bits of another one (the last steps of MurmurHash3, Appleby 2011)."""
    number = (number ^ (number >> 16)) * jnp.uint32(0x85EBCA6B)
    number = (number ^ (number >> 13)) * jnp.uint32(0xC2B2AE35)
    return number ^ (number >> 16)


@struct.dataclass
class RandomFrontier(ChoosingPlanner):
    """Goes to a frontier-expanding cell at random, all alike, and chooses again when it reveals nothing more.

    Random numbers are a hash of the robot's pose and of how much it has seen. So the planner is a pure function, and
    an episode can be repeated.
    """

    def score(self, belief: Belief, situation: Situation) -> PoseValues:
        """A random number of every cell."""
        salt = jnp.zeros_like(belief.pose.x).astype(jnp.uint32)
        for number in (belief.pose.x, belief.pose.y, belief.pose.heading, bitboard.count(belief.seen)):
            salt = _mixed(salt + number.astype(jnp.uint32) + jnp.uint32(1))
        shape = (belief.height, belief.width, *(1 for _ in salt.shape))
        cell = jnp.arange(belief.height * belief.width, dtype=jnp.uint32).reshape(shape)
        numbers = _mixed(cell ^ salt) >> 8  # a float holds 24 bits exactly
        return jnp.broadcast_to(numbers.astype(jnp.float32), situation.distance.shape)
