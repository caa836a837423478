"""The gridworld: the robot, its belief and the effect of its actions (paper, section IV-B).

Pure functions on one robot or on a batch of robots. Batch axes come last, see `dc2g_jax.grid.bitboard`.
"""

import functools

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int, UInt8, UInt32

from dc2g_jax.grid import bitboard
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.poses import Pose, moved
from dc2g_jax.grid.sensing import Kernel
from dc2g_jax.grid.world import World, opaque_cells, unpack_classes, world_from_terrain


@struct.dataclass
class Belief:
    """Everything the robot has observed since the episode began (the stand-in for a SLAM system), and its pose.

    Attributes:
      pose: pose of the robot.
      steps: actions taken so far, int32.
      classes: bit planes of the observed class indices: plane `b` holds the cells whose index has bit `b`.
      seen: board of observed cells.
      traversable: board of observed traversable cells.
      goals: board of observed goal cells.
      width: columns of the grid.
      outside: board of the cells that are not part of the map, if the grid is larger than the map. They are never
        observed and do not count as unobserved.
    """

    pose: Pose
    steps: Int[Array, "*batch"]
    classes: UInt32[Array, "bit n_words h *batch"]
    seen: UInt32[Array, "n_words h *batch"]
    traversable: UInt32[Array, "n_words h *batch"]
    goals: UInt32[Array, "n_words h *batch"]
    width: int = struct.field(pytree_node=False)
    outside: UInt32[Array, "n_words h *batch"] | None = None

    @property
    def height(self) -> int:
        """Rows of the grid."""
        return self.seen.shape[1]

    @property
    def terrain(self) -> UInt8[Array, "h w *batch"]:
        """Observed class indices, 0 for unobserved cells."""
        return unpack_classes(self.classes, self.width)

    @property
    def opaque(self) -> Board:
        """Board of the observed cells that hide what is behind them."""
        return opaque_cells(self.classes)


def _observed(
    world: World, pose: Pose, steps: Int[Array, "*batch"], seen: UInt32[Array, "n_words h *batch"], sensing: Kernel
) -> Belief:
    """The belief after an observation from `pose`; `seen` are the cells seen before."""
    seen = seen | sensing.visible(pose, world.opaque, world.width)
    return Belief(
        pose=pose,
        steps=steps,
        classes=world.classes & seen,
        seen=seen,
        traversable=world.traversable & seen,
        goals=world.goals & seen,
        width=world.width,
    )


def reset(world: World, pose: Pose, sensing: Kernel) -> Belief:
    """The belief at the start of an episode, after the observation from the first pose."""
    return _observed(world, pose, jnp.zeros_like(pose.x), jnp.zeros_like(world.goals), sensing)


def step(world: World, belief: Belief, action: Int[Array, "*batch"], sensing: Kernel) -> Belief:
    """Take one action, then observe. Shapes and dtypes of the belief do not change."""
    pose = moved(belief.pose, action, belief.height, belief.width)
    return _observed(world, pose, belief.steps + 1, belief.seen, sensing)


def at_goal(world: World, pose: Pose) -> Bool[Array, "*batch"]:
    """Whether the robot stands on a goal cell."""
    return bitboard.contains(world.goals, pose.x, pose.y)


def belief_from_map(observed: UInt8[Array, "h w *batch"] | UInt8[np.ndarray, "h w *batch"], pose: Pose) -> Belief:
    """The belief of a robot that supplies its own partial map.

    Args:
      observed: class index of every cell, 0 for unobserved cells; see `dc2g_jax.grid.terrain`.
      pose: pose of the robot.
    """
    world = world_from_terrain(observed)
    return Belief(
        pose=pose,
        steps=jnp.zeros_like(pose.x),
        classes=world.classes,
        seen=functools.reduce(jnp.bitwise_or, world.classes),
        traversable=world.traversable,
        goals=world.goals,
        width=world.width,
    )
