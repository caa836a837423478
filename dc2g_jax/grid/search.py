"""Shortest plans over poses (x, y, heading) and exact cost-to-go over cells.

Wavefronts grow as whole pose sets, one action a step, so the work of a search is its length in actions times the
number of words in the map.
"""

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax.grid import bitboard
from dc2g_jax.grid.bitboard import Board
from dc2g_jax.grid.poses import HEADINGS, Pose, PoseSet, moved_forward, only, turned_left, turned_right


def _predecessors(poses: PoseSet) -> PoseSet:
    """Poses from which one action leads into the set."""
    return moved_forward(poses, -1) | turned_left(poses) | turned_right(poses)


def _successors(poses: PoseSet) -> PoseSet:
    """Poses into which one action leads from the set."""
    return moved_forward(poses) | turned_left(poses) | turned_right(poses)


@struct.dataclass
class FirstAction:
    """The first action of a shortest plan.

    Attributes:
      action: 0 forward, 1 turn left, 2 turn right; forward where there is no plan.
      length: number of actions in the plan; 0 where there is none or the pose is a target already.
      found: does a plan exist?
    """

    action: Int[Array, "*batch"]
    length: Int[Array, "*batch"]
    found: Bool[Array, "*batch"]


def first_action(pose: Pose, targets: PoseSet, free: Board) -> FirstAction:
    """First action of the lexicographically smallest shortest plan from `pose` into `targets` (Algorithm 2, line 12).

    Actions are ordered forward, left, right. The wavefront grows backward from the targets and stops at the robot,
    so neither a distance field nor a table of parents is kept: the set of the last step before the robot is hit
    holds just the poses that are one action closer.

    Args:
      pose: where the robot is.
      targets: poses to reach; those not on free cells are ignored.
      free: cells the robot may use; a plan never leaves them.
    """
    robot = only(pose, *free.shape)
    start = targets & free

    def grow(carry: tuple[PoseSet, PoseSet, Array, Array]) -> tuple[PoseSet, PoseSet, Array, Array]:
        reached, _, length, _ = carry
        grown = reached | (_predecessors(reached) & free)
        go_on = jnp.any(grown != reached) & ~bitboard.intersects(grown, robot)
        return grown, reached, length + 1, go_on

    go_on = ~bitboard.is_empty(start) & ~bitboard.intersects(start, robot)
    reached, closer, length, _ = jax.lax.while_loop(
        lambda carry: carry[3], grow, (start, jnp.zeros_like(start), jnp.int32(0), go_on)
    )
    found = bitboard.intersects(reached, robot)
    successors = (moved_forward(robot), turned_left(robot), turned_right(robot))
    hits = jnp.stack([bitboard.intersects(closer, successor) for successor in successors])
    action = jnp.argmax(hits).astype(jnp.int32)
    return FirstAction(action=action, length=jnp.where(found, length, 0), found=found)


def distances(pose: Pose, free: Board, width: int) -> Int[Array, "heading h w"]:
    """Length in actions of the shortest plan from `pose` to every pose over free cells, -1 where there is none.

    The counts are kept bit-sliced while the wavefront grows: plane `b` holds the poses whose distance has bit `b`.
    """
    height, n_words = free.shape
    bits = max(1, (HEADINGS * height * width).bit_length())
    start = only(pose, height, n_words) & free
    plane_index = jnp.arange(bits, dtype=jnp.int32)[:, None, None, None]

    def grow(carry: tuple[PoseSet, Array, Array, Array]) -> tuple[PoseSet, Array, Array, Array]:
        reached, planes, length, _ = carry
        new = _successors(reached) & free & ~reached
        length = length + 1
        in_plane = ((length >> plane_index) & 1) == 1
        planes = planes | jnp.where(in_plane, new, jnp.uint32(0))
        return reached | new, planes, length, jnp.any(new != 0)

    planes = jnp.zeros((bits, *start.shape), jnp.uint32)
    reached, planes, _, _ = jax.lax.while_loop(
        lambda carry: carry[3], grow, (start, planes, jnp.int32(0), ~bitboard.is_empty(start))
    )
    weights = jnp.left_shift(jnp.int32(1), plane_index)
    lengths = jnp.sum(bitboard.unpack(planes, width) * weights, axis=0, dtype=jnp.int32)
    return jnp.where(bitboard.unpack(reached, width), lengths, -1)


#: Moves between cells, `(dx, dy)`: the four a robot can make, and the eight of the paper's cost-to-go images.
FOUR_CONNECTED = ((1, 0), (-1, 0), (0, 1), (0, -1))
EIGHT_CONNECTED = (*FOUR_CONNECTED, (1, 1), (1, -1), (-1, 1), (-1, -1))


def _grown_goals(traversable: Bool[Array, "h w"], goals: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The goal cells, grown by 3x3 squares until they touch traversable ground (unchanged where they never do)."""

    def grow(cells: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
        rows = cells | jnp.pad(cells, ((1, 0), (0, 0)))[:-1] | jnp.pad(cells, ((0, 1), (0, 0)))[1:]
        return rows | jnp.pad(rows, ((0, 0), (1, 0)))[:, :-1] | jnp.pad(rows, ((0, 0), (0, 1)))[:, 1:]

    ground = traversable & ~goals

    def lonely(cells: Bool[Array, "h w"]) -> Bool[Array, ""]:
        return jnp.any(goals) & jnp.any(ground) & ~jnp.any(grow(cells) & ground)

    return jax.lax.while_loop(lonely, grow, goals)


def cost_to_go(
    traversable: Bool[Array, "h w"],
    goals: Bool[Array, "h w"],
    *,
    moves: tuple[tuple[int, int], ...] = EIGHT_CONNECTED,
) -> Float[Array, "h w"]:
    """Exact least travel cost from every cell to the nearest goal cell, in cells (Algorithm 1, line 5).

    Over traversable cells and goal cells; a straight step costs 1 and a diagonal one sqrt 2, also past corners. Where
    no goal cell touches traversable ground the goal is grown by 3x3 squares until it does. The least cost is kept as
    two whole numbers, straight and diagonal steps, so that it is rounded once and equal costs compare equal.

    Args:
      traversable: cells a robot may drive on.
      goals: goal cells.
      moves: steps between cells: `EIGHT_CONNECTED` as in the paper, or `FOUR_CONNECTED` as the robot drives.

    Returns:
      float32 costs; infinity where not traversable or cut off from every goal.
    """
    goals = _grown_goals(traversable, goals)
    free = traversable | goals

    def moved(values: Array, dx: int, dy: int, fill: float) -> Array:
        padded = jnp.pad(values, 1, constant_values=fill)
        return jax.lax.slice(padded, (1 - dy, 1 - dx), (1 - dy + values.shape[0], 1 - dx + values.shape[1]))

    def relax(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        straight, diagonal, cost, _ = carry
        best_straight, best_diagonal, best = straight, diagonal, cost
        for dx, dy in moves:
            is_diagonal = abs(dx * dy)
            new_straight = moved(straight, dx, dy, 0) + (1 - is_diagonal)
            new_diagonal = moved(diagonal, dx, dy, 0) + is_diagonal
            reached = free & jnp.isfinite(moved(cost, dx, dy, jnp.inf))
            new = jnp.where(reached, new_straight + jnp.sqrt(jnp.float32(2)) * new_diagonal, jnp.inf)
            better = new < best
            best_straight = jnp.where(better, new_straight, best_straight)
            best_diagonal = jnp.where(better, new_diagonal, best_diagonal)
            best = jnp.where(better, new, best)
        return best_straight, best_diagonal, best, jnp.any(best < cost)

    zero = jnp.zeros(goals.shape, jnp.int32)
    start = (zero, zero, jnp.where(goals, jnp.float32(0), jnp.float32(jnp.inf)), jnp.any(goals))
    return jax.lax.while_loop(lambda carry: carry[3], relax, start)[2]
