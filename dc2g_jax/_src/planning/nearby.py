"""Exploration decided from the ground around the robot, where the whole map is certain to say the same.

However large the map, the nearest frontier-expanding pose is most often a few actions away. A window of the map around
the robot then holds all that the decision depends on.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.bitboard import WORD_BITS, Board
from dc2g_jax._src.grid.gridworld import BOARDS, Belief
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.windows import Window, window_around
from dc2g_jax._src.runtime.programs import apart

#: Words and rows of a window: 15 cells or more on either side of the robot.
_WORDS, _ROWS = 2, 48


class Decided(NamedTuple):
    """A decision without its poses.

    Attributes:
      action: the next action.
      mode: plan mode, see `planning.planners`.
      length: number of actions of the plan.
      reachable: reachable cells.
    """

    action: Int[Array, "*batch"]
    mode: Int[Array, "*batch"]
    length: Int[Array, "*batch"]
    reachable: Board


def _margin(window: Window, pose: Pose, n_words: int, height: int) -> Int[Array, ""]:
    """Cells between the robot and the nearest side of the window beyond which the map goes on.

    Args:
      window: the window.
      pose: the robot's, in the window.
      n_words: words in a row of the map.
      height: rows of the map.
    """
    x, y = pose.x[0], pose.y[0]
    sides = (
        (window.word > 0, x),
        (window.word + window.words < n_words, window.words * WORD_BITS - 1 - x),
        (window.row > 0, y),
        (window.row + window.rows < height, window.rows - 1 - y),
    )
    return jnp.min(jnp.stack([jnp.where(goes_on, cells, WORD_BITS * n_words + height) for goes_on, cells in sides]))


def nearby(
    belief: Belief, before: Board, decide: Callable[[Belief, Board], Decided], reach: int | None
) -> tuple[Decided, Bool[Array, ""]] | None:
    """Decide from the ground around the robot.

    Args:
      belief: what the robot knows.
      before: cells known to be reachable, such as those of the step before.
      decide: makes a decision to go to the nearest frontier-expanding pose, or to a reachable goal, from a belief and
        cells known to be reachable.
      reach: distance beyond which only reachability matters to a pose, see `planning.rules.Rules`.

    Returns:
      The decision, and whether the whole map gives the same unless the robot gave up; if not, only some of its
      reachable cells may be there.
      `None` for several robots, on small maps, and without `reach`.
    """
    n_words, height, *batch = before.shape
    if batch != [1] or n_words <= _WORDS or height <= _ROWS or reach is None:
        return None
    window = window_around(belief.pose, _WORDS, _ROWS, (n_words, height))
    # A window has whole words. Bits beyond the map's last column are outside the map.
    outside = jnp.broadcast_to(jnp.asarray(~bitboard.full(1, belief.width))[..., None], (n_words, height, 1))
    part = dataclasses.replace(
        belief,
        pose=window.pose(belief.pose),
        width=_WORDS * WORD_BITS,
        outside=window.cut(outside if belief.outside is None else outside | belief.outside),
        **{name: window.cut(getattr(belief, name)) for name in BOARDS},
    )
    near = apart(decide, part, window.cut(before))
    reachable = window.put(before, near.reachable)
    # These cells are connected to the robot. If no step leads out of them, they are all that is reachable.
    all_reachable = bitboard.is_empty(bitboard.neighbors(reachable) & ~reachable & belief.traversable)
    goals, goals_near = bitboard.count(reachable & belief.goals), bitboard.count(near.reachable & part.goals)
    # Poses no farther away than the nearest one found have all that they depend on within the window.
    depends_on = near.length + jnp.where(goals_near > 0, 0, reach)
    within = depends_on <= _margin(window, part.pose, n_words, height)
    certain = all_reachable & (goals == goals_near) & within
    return near._replace(reachable=reachable), certain[0]
