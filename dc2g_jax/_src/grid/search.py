"""Shortest plans over poses (x, y, heading) and exact cost-to-go over cells.

A wavefront is a pose set that grows by one action per step. The work of a search is therefore its length in actions
times the number of words in the map. Batch axes come last, see `grid.bitboard`.
"""

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt32

from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.loops import for_each_until, repeated, until
from dc2g_jax._src.grid.poses import ACTION_LETTERS, FORWARD_ACTION, HEADINGS, Pose, PoseSet, moved, only
from dc2g_jax._src.grid.squares import shifted

#: Integer costs of a straight and of a diagonal step. Their quotient is sqrt 2 to nine digits and they have no common
#: divisor, so that sums order paths by their cost and tell the number of steps of each kind.
_STRAIGHT, _DIAGONAL = 13860, 19601

#: Integer cost of cells without a path.
_NO_PATH = 2**31 - 1 - _DIAGONAL

#: Wavefront steps between checks for growth on a CPU. Most searches end before the first check.
_STEPS_BETWEEN_LOOKS = 32


def _pose_count(free: Board) -> int:
    """Number of poses on a board, its padding included."""
    return HEADINGS * free.shape[0] * free.shape[1] * bitboard.WORD_BITS


class _Search(NamedTuple):
    """State of a wavefront search.

    Attributes:
      reached: poses reached so far.
      length: steps of the wavefront so far.
      active: whether the wavefront still grows. It stops on arrival, so each search of a batch ends by itself.
    """

    reached: PoseSet
    length: Int[Array, "*batch"]
    active: Bool[Array, "*batch"]


def _search(
    start: PoseSet,
    active: Bool[Array, "*batch"],
    free: Board,
    forward: int,
    targets: Any,
    reached_of: Callable[[PoseSet, Any], Bool[Array, "target *batch"]],
) -> tuple[Bool[Array, "target *batch"], Int[Array, "*batch"]]:
    """Grow a wavefront over free cells until it arrives or stops growing.

    On a CPU, the searches of a batch run until the last one ends. Elsewhere, the batch shrinks as searches end.

    Args:
      start: first poses of the wavefront.
      active: whether there is anything to search for.
      free: cells that the wavefront may cover.
      forward: 1 to grow along the actions, -1 to grow against them.
      targets: where to arrive; arrays with the batch axes last.
      reached_of: `(pose set, targets) ->` which of the targets are in the set. A search ends once any of them is.

    Returns:
      Which targets were reached, and the number of steps of the wavefront.
    """

    def grow(search: _Search, free: Board, targets: Any) -> _Search:
        reached = poses.grown(search.reached, free & -search.active.astype(jnp.uint32), forward)
        arrived = jnp.any(reached_of(reached, targets), axis=0)
        return _Search(reached, search.length + search.active, search.active & ~arrived)

    def still_growing(later: _Search, before: _Search) -> _Search:
        return later._replace(active=later.active & ~poses.is_empty(later.reached ^ before.reached))

    def grow_until_all_have_arrived(search: _Search) -> _Search:
        def go_on(carry: tuple[_Search, Array]) -> Bool[Array, ""]:
            return jnp.any(carry[0].active) & (carry[1] < _STEPS_BETWEEN_LOOKS)

        def grow_once(carry: tuple[_Search, Array]) -> tuple[_Search, Array]:
            return grow(carry[0], free, targets), carry[1] + 1

        return still_growing(jax.lax.while_loop(go_on, grow_once, (search, jnp.int32(0)))[0], search)

    def grow_some(steps: int, search: _Search, given: tuple[Board, Any]) -> _Search:
        later = jax.lax.fori_loop(0, steps, lambda _, search: grow(search, *given), search, unroll=True)
        return still_growing(later, search)

    def result(search: _Search, given: tuple[Board, Any]) -> tuple[Array, Array]:
        return reached_of(search.reached, given[1]), search.length

    most = _pose_count(free) + 1

    def together(first: _Search, given: tuple[Board, Any]) -> tuple[Array, Array]:
        last = until(lambda search: ~jnp.any(search.active), grow_until_all_have_arrived, first, most=most)
        return result(last, given)

    def each(first: _Search, given: tuple[Board, Any]) -> tuple[Array, Array]:
        return for_each_until(lambda search: search.active, grow_some, result, first, given, most=most)

    length = jnp.zeros(active.shape, jnp.int32)
    first = _Search(start, length, active & ~jnp.any(reached_of(start, targets), axis=0))
    return jax.lax.platform_dependent(first, (free, targets), cpu=together, default=each)


@struct.dataclass
class FirstAction:
    """The first action of a shortest plan.

    Attributes:
      action: 0 forward, 1 turn left, 2 turn right; forward if there is no plan.
      length: number of actions in the plan; 0 if there is no plan or the pose is already a target.
      found: whether a plan exists.
    """

    action: Int[Array, "*batch"]
    length: Int[Array, "*batch"]
    found: Bool[Array, "*batch"]


def first_action(pose: Pose, targets: PoseSet, free: Board) -> FirstAction:
    """First action of the lexicographically smallest shortest plan from `pose` into `targets` (Algorithm 2, line 12).

    Actions are ordered forward, left, right. The wavefront grows backward from the targets and stops one action short
    of the robot. Of the robot's three next poses it has then reached exactly those that are one action closer, so
    neither a distance field nor a table of parents is needed.

    Args:
      pose: pose of the robot.
      targets: poses to reach; targets outside the free cells are ignored.
      free: cells the robot may use; a plan never leaves them.
    """
    start = targets & free
    columns, height = free.shape[0] * bitboard.WORD_BITS, free.shape[1]
    next_poses = [moved(pose, jnp.int32(action), height, columns) for action in range(len(ACTION_LETTERS))]

    def closer(reached: PoseSet, next_poses: list[Pose]) -> Bool[Array, "action *batch"]:
        return jnp.stack([poses.contains(reached, next_pose) for next_pose in next_poses])

    there = poses.contains(start, pose)
    active = ~there & bitboard.contains(free, pose.x, pose.y) & ~poses.is_empty(start)
    actions, length = _search(start, active, free, -1, next_poses, closer)
    actions &= active
    on_the_way = jnp.any(actions, axis=0)
    return FirstAction(
        action=jnp.where(on_the_way, jnp.argmax(actions, axis=0), FORWARD_ACTION).astype(jnp.int32),
        length=jnp.where(on_the_way, length + 1, 0),
        found=there | on_the_way,
    )


def first_headings(
    pose: Pose, x: Int[Array, "*batch"], y: Int[Array, "*batch"], free: Board
) -> Bool[Array, "heading *batch"]:
    """The headings in which a robot can first arrive on the cell in column `x`, row `y`, over free cells.

    None if it is unreachable.
    """

    def there(reached: PoseSet, cell: tuple[Array, Array]) -> Bool[Array, "heading *batch"]:
        return jnp.stack([bitboard.contains(reached[heading], *cell) for heading in range(HEADINGS)])

    start = only(pose, *free.shape[:2]) & free
    active = bitboard.contains(free, pose.x, pose.y) & bitboard.contains(free, x, y)
    return _search(start, active, free, 1, (x, y), there)[0]


#: Wavefront steps between checks whether all is found.
_STEPS_BETWEEN_CHECKS = 8


def _count(
    pose: Pose,
    free: Board,
    wanted: PoseSet,
    find: Callable[[PoseSet, PoseSet], PoseSet],
    counted: Callable[[PoseSet], Array],
) -> tuple[PoseSet, UInt32[Array, "bit ..."]]:
    """Find poses in the order of their distance from a pose, and count the steps to them, bit-sliced.

    A step of the wavefront adds one to the count of all that is not yet found. Consecutive numbers differ in one bit of
    Gray code, so adding one is an exclusive or with one plane.

    Args:
      pose: where the wavefront begins.
      free: cells that it may cover.
      wanted: poses to find.
      find: `(poses reached, poses found before) ->` the wanted poses found.
      counted: what has a count of its own: maps a pose set to itself or to its cells.

    Returns:
      The poses that were found; and one more than the steps to them, as binary numbers, highest bit first. Each plane
      holds those whose number has that bit, and nothing else.
    """
    start = only(pose, *free.shape[:2]) & free

    def grow(_: Any, carry: tuple[PoseSet, PoseSet, Array, Array]) -> tuple[PoseSet, PoseSet, Array, Array]:
        reached, found, planes, number = carry
        reached = poses.grown(reached, free)
        found = find(reached, found)
        bit = jax.lax.population_count(number & ~(number + 1))  # the one that differs in the next number
        plane = jax.lax.dynamic_index_in_dim(planes, bit, 0, keepdims=False)
        planes = jax.lax.dynamic_update_index_in_dim(planes, plane ^ ~counted(found), bit, 0)
        return reached, found, planes, number + 1

    def grow_some(carry: tuple[Any, Array]) -> tuple[Any, Array]:
        search = repeated(_STEPS_BETWEEN_CHECKS, grow, carry[0])
        missing = jnp.any(counted(wanted) & ~counted(search[1]))
        return search, missing & jnp.any(search[0] != carry[0][0])

    found = start & wanted
    # The numbers are 1 where the wavefront begins and 2 elsewhere: 01 and 11 in Gray code.
    planes = jnp.zeros(((_pose_count(free) + 1).bit_length(), *counted(found).shape), jnp.uint32)
    planes = planes.at[0].set(~jnp.uint32(0)).at[1].set(~counted(found))
    first = (start, found, planes, jnp.int32(2)), jnp.any(wanted)
    (_, found, planes, _), _ = until(lambda carry: ~carry[1], grow_some, first, most=_pose_count(free) + 1)
    bits = itertools.accumulate(planes[::-1] & counted(found), jnp.bitwise_xor)  # from Gray code
    return found, jnp.stack(list(bits))


def distances(pose: Pose, free: Board, width: int) -> Int[Array, "heading h w *batch"]:
    """Length in actions of a shortest plan from `pose` to every pose over free cells, -1 for unreachable poses."""
    _, planes = _count(
        pose, free, poses.every_heading(free), find=lambda reached, _: reached, counted=lambda found: found
    )
    return poses.numbers(planes, width) - 1


def nearest_headings(
    pose: Pose, candidates: PoseSet, free: Board, width: int
) -> tuple[PoseSet, Int[Array, "h w *batch"]]:
    """The nearest candidate headings of every cell, and the number of actions to reach them over free cells.

    The pose of the robot must not be a candidate. Candidates that cannot be reached are ignored. The number is -1 on
    cells without candidates.
    """

    def find(reached: PoseSet, nearest: PoseSet) -> PoseSet:
        return nearest | candidates & reached & ~poses.occupied(nearest)

    nearest, planes = _count(pose, free, candidates, find, counted=poses.occupied)
    return nearest, bitboard.numbers(planes, width) - 1


#: Moves between cells, `(dx, dy)`: the four a robot can make, and the eight of the paper's cost-to-go images.
FOUR_CONNECTED = ((1, 0), (-1, 0), (0, 1), (0, -1))
EIGHT_CONNECTED = (*FOUR_CONNECTED, (1, 1), (1, -1), (-1, 1), (-1, -1))


def _grown_goals(traversable: Bool[Array, "h w *batch"], goals: Bool[Array, "h w *batch"]) -> Bool[Array, "h w *batch"]:
    """The goal cells, grown by 3x3 squares until they touch traversable ground (unchanged where they never do)."""

    def grow(cells: Bool[Array, "h w *batch"]) -> Bool[Array, "h w *batch"]:
        rows = cells | shifted(cells, 0, 1, False) | shifted(cells, 0, -1, False)
        return rows | shifted(rows, 1, 0, False) | shifted(rows, -1, 0, False)

    def somewhere(cells: Bool[Array, "h w *batch"]) -> Bool[Array, "*batch"]:
        return jnp.any(cells, axis=(0, 1))

    ground = traversable & ~goals
    can_touch = somewhere(goals) & somewhere(ground)

    def lonely(cells: Bool[Array, "h w *batch"]) -> Bool[Array, "*batch"]:
        return can_touch & ~somewhere(grow(cells) & ground)

    return until(
        lambda cells: ~jnp.any(lonely(cells)),
        lambda cells: jnp.where(lonely(cells), grow(cells), cells),
        goals,
        most=max(goals.shape[:2]),
    )


def cost_to_go(
    traversable: Bool[Array, "h w *batch"],
    goals: Bool[Array, "h w *batch"],
    *,
    moves: tuple[tuple[int, int], ...] = EIGHT_CONNECTED,
) -> Float[Array, "h w *batch"]:
    """Exact least travel cost from every cell to the nearest goal cell, in cells (Algorithm 1, line 5).

    Steps lead over traversable cells and goal cells. A straight step costs 1, a diagonal step sqrt 2; diagonal steps
    past corners are allowed. Where no goal cell touches traversable ground, the goal is dilated by 3x3 squares until it
    does. A path's steps of each kind are kept in one integer that orders paths by their cost. The cost is therefore
    rounded only once, and equal costs compare equal. It is exact up to 150,000 cells with 13,859 diagonal steps.

    Args:
      traversable: cells a robot may drive on.
      goals: goal cells.
      moves: allowed steps between cells: `EIGHT_CONNECTED` as in the paper, or `FOUR_CONNECTED` as the robot drives.

    Returns:
      float32 costs; infinity on cells that are not traversable or cannot reach a goal.
    """
    goals = _grown_goals(traversable, goals)
    free = traversable | goals

    def relax(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        least, _ = carry
        nearer = least
        for dx, dy in moves:
            nearer = jnp.minimum(nearer, shifted(least, dx, dy, _NO_PATH) + (_DIAGONAL if dx and dy else _STRAIGHT))
        nearer = jnp.where(free, nearer, _NO_PATH)
        return nearer, jnp.any(nearer < least)

    start = (jnp.where(goals, 0, _NO_PATH), jnp.any(goals))
    # A cheapest path has fewer steps than there are cells.
    least, _ = until(lambda carry: ~carry[1], relax, start, most=goals.shape[0] * goals.shape[1] + 1)
    diagonal = least % _STRAIGHT * pow(_DIAGONAL, -1, _STRAIGHT) % _STRAIGHT
    straight = (least - diagonal * _DIAGONAL) // _STRAIGHT
    return jnp.where(least < _NO_PATH, straight + jnp.sqrt(jnp.float32(2)) * diagonal, jnp.inf)
