"""The gridworld: the robot, its belief and the effect of its actions (paper, section IV-B).

Pure functions on one robot or on a batch of robots. Batch axes come last, see `grid.bitboard`.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int, UInt8, UInt32

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.poses import Pose, moved
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.windows import window_around
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.runtime.errors import InputError


@struct.dataclass
class Belief(World):
    """A world as far as a robot has observed it since the episode began (the stand-in for a SLAM system); and its pose.

    Attributes:
      classes: bit planes of the observed class indices: plane `b` holds the cells whose index has bit `b`.
      traversable: board of observed traversable cells.
      goals: board of observed goal cells.
      width: columns of the grid.
      pose: pose of the robot.
      steps: actions taken so far, int32.
      seen: board of observed cells.
      outside: board of the cells that are not part of the map, if the grid is larger than the map. They are never
        observed and do not count as unobserved.
    """

    pose: Pose
    steps: Int[Array, "*batch"]
    seen: UInt32[Array, "n_words h *batch"]
    outside: UInt32[Array, "n_words h *batch"] | None = None


#: Fields of a belief that are boards.
BOARDS = ("classes", "traversable", "goals", "seen")


def belief_of(world: World, pose: Pose, steps: Int[Array, "*batch"], seen: UInt32[Array, "n_words h *batch"]) -> Belief:
    """The belief of a robot that has observed these cells of a world."""
    return Belief(
        classes=world.classes & seen,
        traversable=world.traversable & seen,
        goals=world.goals & seen,
        width=world.width,
        pose=pose,
        steps=steps,
        seen=seen,
    )


def check_axes(what: str, shape: tuple[int, ...], *expected: int | str) -> None:
    """Check a shape while a program is traced, so that the program itself does not.

    Args:
      what: what has this shape, for the message.
      shape: the shape.
      expected: size of each axis, or the name of an axis of any size.

    Raises:
      InputError: the shape is another, as that of results of `jax.vmap`, whose batch axis comes first.
    """
    sizes = tuple(size if isinstance(axis, str) else axis for axis, size in zip(expected, shape, strict=False))
    if shape != sizes or len(shape) != len(expected):
        raise InputError(
            f"batch axes come last: {what} are {list(shape)}, expected [{', '.join(map(str, expected))}]; "
            "with jax.vmap, give in_axes=-1 and out_axes=-1"
        )


def check_poses(world: World, pose: Pose) -> None:
    """Check that the boards of a world or a belief have the batch axes of these poses, and have them last.

    Raises:
      InputError: see `check_axes`.
    """
    for leaf in jax.tree.leaves(pose):
        words, shape = bitboard.word_count(world.width), leaf.shape
        check_axes(f"goals for poses {list(shape)}", world.goals.shape, words, "h", *shape)


def reset(world: World, pose: Pose, sensing: Kernel) -> Belief:
    """The belief at the start of an episode, after the observation from the first pose.

    Raises:
      InputError: world and pose are of different batches.
    """
    check_poses(world, pose)
    return belief_of(world, pose, jnp.zeros_like(pose.x), sensing.visible(pose, world.opaque, world.width))


def move(world: World, pose: Pose, action: Int[Array, "*batch"]) -> Pose:
    """The pose after an action. A robot stays in place if the cell ahead is off the map or not traversable.

    Raises:
      InputError: world and pose are of different batches.
    """
    check_poses(world, pose)
    ahead = moved(pose, action, world.height, world.width)
    free = bitboard.contains(world.traversable, ahead.x, ahead.y)
    return Pose(jnp.where(free, ahead.x, pose.x), jnp.where(free, ahead.y, pose.y), ahead.heading)


def step(world: World, belief: Belief, action: Int[Array, "*batch"], sensing: Kernel) -> Belief:
    """Take one action (see `move`), then observe. Shapes and dtypes of the belief do not change.

    Raises:
      InputError: world and belief are of different batches.
    """
    check_poses(belief, belief.pose)
    pose = move(world, belief.pose, action)
    n_words, height, *batch = belief.seen.shape
    if batch != [1]:
        seen = belief.seen | sensing.visible(pose, world.opaque, world.width)
        return belief_of(world, pose, belief.steps + 1, seen)
    # One robot changes what is near it. The other words of large boards stay as they are.
    window = window_around(pose, 1 + bitboard.word_count(2 * sensing.radius), 2 * sensing.radius + 1, (n_words, height))
    near = window.cut(world)
    visible = sensing.visible(window.pose(pose), near.opaque, world.width - window.column)
    part = belief_of(near, pose, belief.steps + 1, window.cut(belief.seen) | visible)
    boards = {name: window.put(getattr(belief, name), getattr(part, name)) for name in BOARDS}
    return dataclasses.replace(part, **boards)


def at_goal(world: World, pose: Pose) -> Bool[Array, "*batch"]:
    """Whether the robot stands on a goal cell.

    Raises:
      InputError: world and pose are of different batches.
    """
    check_poses(world, pose)
    return bitboard.contains(world.goals, pose.x, pose.y)


def belief_from_map(observed: UInt8[Array, "h w *batch"] | UInt8[np.ndarray, "h w *batch"], pose: Pose) -> Belief:
    """The belief of a robot that supplies its own partial map.

    Args:
      observed: class index of every cell, 0 for unobserved cells; see `grid.terrain`.
      pose: pose of the robot.

    Raises:
      InputError: map and pose are of different batches.
    """
    for leaf in jax.tree.leaves(pose):
        check_axes(f"maps for poses {list(leaf.shape)}", observed.shape, "h", "w", *leaf.shape)
    world = World.from_terrain(observed)
    return belief_of(world, pose, jnp.zeros_like(pose.x), functools.reduce(jnp.bitwise_or, world.classes))
