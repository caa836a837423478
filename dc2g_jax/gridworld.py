"""The gridworld: what the robot is, what it knows, and what an action does (paper, section IV-B).

Pure functions on one robot; use `jax.vmap` for many.
"""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int, UInt8, UInt32

from dc2g_jax.grid import bitboard
from dc2g_jax.grid.poses import FORWARD, FORWARD_ACTION, HEADINGS, LEFT_ACTION, RIGHT_ACTION, Pose
from dc2g_jax.grid.sensing import Kernel, visible
from dc2g_jax.grid.world import World, world_from_terrain


@struct.dataclass
class Belief:
    """Everything the robot has observed since the episode began (the stand-in for a SLAM system), and its pose.

    Attributes:
      pose: where the robot is.
      steps: actions taken so far, int32.
      terrain: observed class indices, 0 where nothing has been observed.
      seen: board of observed cells.
      traversable: board of observed traversable cells.
      goals: board of observed goal cells.
    """

    pose: Pose
    steps: Int[Array, "*batch"]
    terrain: UInt8[Array, "*batch h w"]
    seen: UInt32[Array, "*batch h n_words"]
    traversable: UInt32[Array, "*batch h n_words"]
    goals: UInt32[Array, "*batch h n_words"]

    @property
    def height(self) -> int:
        """Rows of the map."""
        return self.terrain.shape[-2]

    @property
    def width(self) -> int:
        """Columns of the map."""
        return self.terrain.shape[-1]


def _observed(
    world: World, pose: Pose, steps: Int[Array, ""], seen: UInt32[Array, "h n_words"], sensing: Kernel
) -> Belief:
    """The belief after looking around from `pose`, having seen `seen` before."""
    height, width = world.terrain.shape
    seen = seen | visible(sensing, pose, height, width)
    return Belief(
        pose=pose,
        steps=steps,
        terrain=jnp.where(bitboard.unpack(seen, width), world.terrain, jnp.uint8(0)),
        seen=seen,
        traversable=world.traversable & seen,
        goals=world.goals & seen,
    )


def reset(world: World, pose: Pose, sensing: Kernel) -> Belief:
    """The belief at the start of an episode: what is seen from the first pose."""
    return _observed(world, pose, jnp.int32(0), jnp.zeros_like(world.goals), sensing)


def moved(pose: Pose, action: Int[Array, ""], height: int, width: int) -> Pose:
    """The pose after an action. A step forward off the map stays in place."""
    delta = jnp.asarray(FORWARD, jnp.int32)[pose.heading]
    forward = action == FORWARD_ACTION
    turn = jnp.where(action == LEFT_ACTION, -1, jnp.where(action == RIGHT_ACTION, 1, 0)).astype(jnp.int32)
    return Pose(
        x=jnp.clip(pose.x + jnp.where(forward, delta[0], 0), 0, width - 1),
        y=jnp.clip(pose.y + jnp.where(forward, delta[1], 0), 0, height - 1),
        heading=(pose.heading + turn) % HEADINGS,
    )


def step(world: World, belief: Belief, action: Int[Array, ""], sensing: Kernel) -> Belief:
    """Take one action, then look around. Shapes and dtypes of the belief stay what they are."""
    pose = moved(belief.pose, action, belief.height, belief.width)
    return _observed(world, pose, belief.steps + 1, belief.seen, sensing)


def at_goal(world: World, pose: Pose) -> Bool[Array, ""]:
    """Does the robot stand on a goal cell?"""
    return bitboard.contains(world.goals, pose.x, pose.y)


def belief_from_map(observed: UInt8[Array, "h w"] | UInt8[np.ndarray, "h w"], pose: Pose) -> Belief:
    """The belief of a robot that brings its own partial map.

    Args:
      observed: class index of every cell, 0 where nothing has been observed; see `dc2g_jax.grid.terrain`.
      pose: where the robot is.
    """
    world = world_from_terrain(observed)
    return Belief(
        pose=pose,
        steps=jnp.int32(0),
        terrain=world.terrain,
        seen=bitboard.pack(world.terrain != 0),
        traversable=world.traversable,
        goals=world.goals,
    )
