"""Frontier cells and frontier-expanding poses (Algorithm 2, lines 6 to 8).

There are two definitions: that of the paper's text (`complete`) and that of the authors' published code (`reference`).
"""

from typing import Any

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import PoseSet, only
from dc2g_jax._src.grid.sensing import Kernel


def unseen(belief: Belief) -> Board:
    """In-bounds cells that have not been observed."""
    beyond = bitboard.complement(belief.seen, belief.width)
    return beyond if belief.outside is None else beyond & ~belief.outside


def _reachable_but_here(pose_set: PoseSet, belief: Belief, reachable: Board) -> PoseSet:
    """The poses on reachable cells, without the one the robot is in."""
    return pose_set & reachable & ~only(belief.pose, *reachable.shape[:2])


def frontier_cells(belief: Belief, reachable: Board) -> Board:
    """Reachable cells with an unobserved in-bounds 4-neighbor (paper, section III-D)."""
    return reachable & bitboard.neighbors(unseen(belief))


def complete(belief: Belief, reachable: Board, sensing: Any) -> PoseSet:
    """Reachable poses, not the current one, that see an unobserved 4-neighbor of a frontier cell.

    Every such pose reveals something when it is reached, so exploration ends. If the set is empty, the goal is
    unreachable.

    Args:
      belief: belief of the robot.
      reachable: observed traversable cells connected to the robot.
      sensing: the robot's field of view: a `Kernel`, or anything with `poses_that_see`.
    """
    targets = unseen(belief) & bitboard.neighbors(frontier_cells(belief, reachable))
    return _reachable_but_here(sensing.poses_that_see(targets, belief.opaque), belief, reachable)


def reference(belief: Belief, reachable: Board, expanding: Kernel) -> PoseSet:
    """Reachable poses, not the current one, whose `expanding` kernel covers a frontier cell (the authors' code).

    A frontier cell here is any observed cell, traversable or not, with an unobserved in-bounds 4-neighbor.

    Args:
      belief: belief of the robot.
      reachable: observed traversable cells connected to the robot.
      expanding: see `grid.sensing.expanding_kernel`.
    """
    frontier = belief.seen & bitboard.neighbors(unseen(belief))
    return _reachable_but_here(expanding.poses_that_see(frontier, belief.opaque), belief, reachable)
