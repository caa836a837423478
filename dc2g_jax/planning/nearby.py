"""Exploration decided from the ground around the robot, where the whole map is certain to say the same.

However large the map, the nearest frontier-expanding pose is most often a few actions away. A window of the map around
the robot then holds all that the decision depends on.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.bitboard import WORD_BITS, Board
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.search import FirstAction
from dc2g_jax.planning.rules import Rules
from dc2g_jax.programs import apart

#: Words and rows of a window: 15 cells or more on either side of the robot.
_WORDS, _ROWS = 2, 32


class Nearby(NamedTuple):
    """A decision to explore, made from the ground around the robot.

    Attributes:
      certain: whether the whole map gives the same decision.
      reachable: reachable cells of the whole map; only some of them where the decision is not certain.
      first: first action toward the nearest frontier-expanding pose.
    """

    certain: Bool[Array, ""]
    reachable: Board
    first: FirstAction


def _margin(window: tuple[Array, Array], pose: Pose, n_words: int, height: int) -> Int[Array, ""]:
    """Cells between the robot and the nearest side of the window beyond which the map goes on.

    Args:
      window: first word and first row.
      pose: the robot's, in the window.
      n_words: words in a row of the map.
      height: rows of the map.
    """
    (word, row), x, y = window, pose.x[0], pose.y[0]
    sides = (
        (word > 0, x),
        (word + _WORDS < n_words, _WORDS * WORD_BITS - 1 - x),
        (row > 0, y),
        (row + _ROWS < height, _ROWS - 1 - y),
    )
    return jnp.min(jnp.stack([jnp.where(goes_on, cells, WORD_BITS * n_words + height) for goes_on, cells in sides]))


def nearby(belief: Belief, before: Board, rules: Rules) -> Nearby | None:
    """Decide where to explore from the ground around the robot.

    Args:
      belief: what the robot knows.
      before: cells known to be reachable, such as those of the step before.
      rules: what counts as frontier.

    Returns:
      The decision; `None` for several robots, on small maps, and where `rules` do not say how far they look.
    """
    n_words, height, *batch = before.shape
    if batch != [1] or n_words <= _WORDS or height <= _ROWS or rules.reach is None:
        return None
    word = jnp.clip((belief.pose.x[0] - WORD_BITS // 2) // WORD_BITS, 0, n_words - _WORDS)
    row = jnp.clip(belief.pose.y[0] - _ROWS // 2, 0, height - _ROWS)

    def cut(board: UInt32[Array, "*planes n_words h 1"]) -> UInt32[Array, "*planes words rows 1"]:
        words = jax.lax.dynamic_slice_in_dim(board, word, _WORDS, axis=-3)
        return jax.lax.dynamic_slice_in_dim(words, row, _ROWS, axis=-2)

    # A window has whole words. Bits beyond the map's last column are outside the map.
    outside = jnp.asarray(~bitboard.full(height, belief.width))[..., None]
    part = dataclasses.replace(
        belief,
        pose=Pose(belief.pose.x - WORD_BITS * word, belief.pose.y - row, belief.pose.heading),
        width=_WORDS * WORD_BITS,
        outside=cut(outside if belief.outside is None else outside | belief.outside),
        **{name: cut(getattr(belief, name)) for name in ("classes", "seen", "traversable", "goals")},
    )

    def decide(part: Belief, before: Board) -> tuple[Board, FirstAction]:
        robot = bitboard.single(part.pose.x, part.pose.y, _WORDS, _ROWS)
        ground = bitboard.flood(robot | before, part.traversable)
        return ground, search.first_action(part.pose, rules.frontier_expanding(part, ground), ground)

    ground, first = apart(decide, part, cut(before))
    reachable = jax.lax.dynamic_update_slice(before, ground, (word, row, 0))
    # These cells are connected to the robot. If no step leads out of them, they are all that is reachable.
    leads_out = bitboard.neighbors(reachable) & ~reachable & belief.traversable
    explores = first.found & bitboard.is_empty(leads_out | (reachable & belief.goals))
    # Poses no farther away than the nearest one found have all that they depend on within the window.
    within = first.length + rules.reach <= _margin((word, row), part.pose, n_words, height)
    return Nearby((explores & within)[0], reachable, first)
