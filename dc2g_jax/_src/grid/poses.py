"""Poses (column, row, heading), the three actions, and sets of poses.

A *pose set* is a stack of four boards, one per heading: `uint32[4, n_words, h]`. Batch axes come last, see
`grid.bitboard`.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int, UInt32

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.bitboard import WORD_BITS, Board

#: Heading -> (dx, dy) of one cell forward; x grows to the right, y downward.
FORWARD = ((1, 0), (0, 1), (-1, 0), (0, -1))
HEADINGS = len(FORWARD)

#: Actions: one cell forward, turn left (heading - 1), turn right (heading + 1). Each costs one step.
FORWARD_ACTION, LEFT_ACTION, RIGHT_ACTION = 0, 1, 2
ACTION_LETTERS = "FLR"

PoseSet = UInt32[Array, "heading n_words h *batch"]


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


def moved(pose: Pose, action: Int[Array, "*batch"], height: int, width: int) -> Pose:
    """The pose after an action, whatever is in the cell ahead: see `gridworld.move`. It stays on the map."""
    delta = jnp.asarray(FORWARD, jnp.int32)[pose.heading.astype(jnp.uint32)]
    forward = action == FORWARD_ACTION
    turn = jnp.where(action == LEFT_ACTION, -1, jnp.where(action == RIGHT_ACTION, 1, 0)).astype(jnp.int32)
    return Pose(
        x=jnp.clip(pose.x + jnp.where(forward, delta[..., 0], 0), 0, width - 1),
        y=jnp.clip(pose.y + jnp.where(forward, delta[..., 1], 0), 0, height - 1),
        heading=(pose.heading + turn) & (HEADINGS - 1),
    )


def every_heading(cells: Board) -> PoseSet:
    """All poses on the given cells, in all four headings."""
    return jnp.broadcast_to(cells, (HEADINGS, *cells.shape))


def with_headings(headings: Bool[Array, "heading *batch"], cells: Board) -> PoseSet:
    """All poses on the given cells in the given headings."""
    return jnp.where(headings[:, None, None], cells, jnp.uint32(0))


def only(pose: Pose, n_words: int, height: int) -> PoseSet:
    """The set that holds a single pose."""
    headings = jax.lax.broadcasted_iota(jnp.int32, (HEADINGS, *pose.heading.shape), 0) == pose.heading
    return with_headings(headings, bitboard.single(pose.x, pose.y, n_words, height))


def contains(poses: PoseSet, pose: Pose) -> Bool[Array, "*batch"]:
    """Whether the pose, which must be in bounds, is in the set."""
    n_words, height, *batch = poses.shape[1:]
    side_by_side = poses.reshape(HEADINGS * n_words, height, *batch)
    return bitboard.contains(side_by_side, pose.x + pose.heading * (n_words * WORD_BITS), pose.y)


def occupied(poses: PoseSet) -> Board:
    """The cells of the poses in the set."""
    return poses[0] | poses[1] | poses[2] | poses[3]


def is_empty(poses: PoseSet) -> Bool[Array, "*batch"]:
    """Whether the set is empty."""
    return bitboard.is_empty(occupied(poses))


def unpack(poses: PoseSet, width: int) -> Bool[Array, "heading h w *batch"]:
    """Unpack a pose set into boolean grids of `width` columns."""
    return jax.vmap(lambda board: bitboard.unpack(board, width))(poses)


def numbers(planes: UInt32[Array, "bit heading n_words h *batch"], width: int) -> Int[Array, "heading h w *batch"]:
    """The number of every pose, from a pose set for each bit, highest first."""
    return jax.vmap(lambda planes: bitboard.numbers(planes, width), in_axes=1)(planes)


def pack(poses: Bool[Array, "heading h w *batch"]) -> PoseSet:
    """The inverse of `unpack`."""
    return jnp.stack([bitboard.pack(grid) for grid in poses])


def grown(poses: PoseSet, free: Board, forward: int = 1) -> PoseSet:
    """The set with the poses on free cells one action after its own; or one action before them if `forward` is -1."""
    along_x, along_y = poses[0] | poses[2], poses[1] | poses[3]
    # A single stack: compilers make no vector code of loops over several.
    return jnp.stack(
        [
            poses[heading] | free & (bitboard.shift(poses[heading], forward * dx, forward * dy) | turned)
            for heading, ((dx, dy), turned) in enumerate(zip(FORWARD, (along_y, along_x) * 2, strict=True))
        ]
    )
