"""Poses (column, row, heading), the three actions, and sets of poses.

A *pose set* is a stack of four boards, one a heading: `uint32[4, h, n_words]`.
"""

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Int, UInt32

from dc2g_jax.grid import bitboard
from dc2g_jax.grid.bitboard import Board

#: Heading -> (dx, dy) of one cell forward; x grows to the right, y downward.
FORWARD = ((1, 0), (0, 1), (-1, 0), (0, -1))
HEADINGS = len(FORWARD)

#: Actions: one cell forward, turn left (heading - 1), turn right (heading + 1). Each costs one step.
FORWARD_ACTION, LEFT_ACTION, RIGHT_ACTION = 0, 1, 2
ACTION_LETTERS = "FLR"

PoseSet = UInt32[Array, "heading h n_words"]


@struct.dataclass
class Pose:
    """A robot's pose.

    Attributes:
      x: column, int32.
      y: row, growing downward, int32.
      heading: 0 = +x, 1 = +y, 2 = -x, 3 = -y, int32.
    """

    x: Int[Array, "*batch"]
    y: Int[Array, "*batch"]
    heading: Int[Array, "*batch"]


def make_pose(x: ArrayLike, y: ArrayLike, heading: ArrayLike) -> Pose:
    """A pose from plain integers, or poses from integer arrays of equal shape."""
    return Pose(x=jnp.asarray(x, jnp.int32), y=jnp.asarray(y, jnp.int32), heading=jnp.asarray(heading, jnp.int32))


def every_heading(cells: Board) -> PoseSet:
    """All poses that stand on one of the cells."""
    return jnp.broadcast_to(cells, (HEADINGS, *cells.shape))


def only(pose: Pose, height: int, n_words: int) -> PoseSet:
    """The set that holds one pose alone."""
    cell = bitboard.single(pose.x, pose.y, height, n_words)
    return jnp.where((jnp.arange(HEADINGS) == pose.heading)[:, None, None], cell, jnp.uint32(0))


def moved_forward(poses: PoseSet, cells: int = 1) -> PoseSet:
    """Every pose of the set moved `cells` forward along its own heading (backward if negative)."""
    return jnp.stack(
        [bitboard.shift(poses[heading], cells * dx, cells * dy) for heading, (dx, dy) in enumerate(FORWARD)]
    )


def turned_left(poses: PoseSet) -> PoseSet:
    """Every pose of the set turned left."""
    return jnp.roll(poses, -1, axis=0)


def turned_right(poses: PoseSet) -> PoseSet:
    """Every pose of the set turned right."""
    return jnp.roll(poses, 1, axis=0)
