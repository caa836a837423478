"""Exploration decided from the ground around the robot, where that is certain to be what the whole map says.

The nearest frontier-expanding pose is most often a few actions away, however large the map. A window of the map around
the robot then holds all that the decision depends on.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from dc2g_jax.grid import bitboard, search
from dc2g_jax.grid.bitboard import WORD_BITS, Board
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.search import FirstAction
from dc2g_jax.planning.rules import Rules

#: Words and rows of a window: at least half a word of columns on either side of the robot, and a few rows more.
_WORDS, _ROWS = 2, 40


class _Window(NamedTuple):
    """A part of a map, all of the same size.

    Attributes:
      word: first word of its rows.
      row: first row.
    """

    word: Int[Array, ""]
    row: Int[Array, ""]

    def of(self, boards: Any) -> Any:
        """The window of every board of a tree."""
        return jax.tree.map(lambda board: self._cut(board), boards)

    def _cut(self, board: Array) -> Array:
        for start, size, axis in ((self.word, _WORDS, -3), (self.row, _ROWS, -2)):
            board = jax.lax.dynamic_slice_in_dim(board, start, size, axis)
        return board

    def put(self, board: Board, part: Board) -> Board:
        """The board with this part in the window."""
        return jax.lax.dynamic_update_slice(board, part, (self.word, self.row, jnp.int32(0)))


class Nearby(NamedTuple):
    """What the ground around the robot says.

    Attributes:
      certain: whether the whole map says the same: explore, no goal is reachable.
      reachable: reachable cells, of the whole map; where this is not certain, some of them.
      first: the first action toward the nearest frontier-expanding pose.
    """

    certain: Bool[Array, ""]
    reachable: Board
    first: FirstAction


def nearby(belief: Belief, before: Board, rules: Rules) -> Nearby | None:
    """Decide from what is around the robot; `None` for several robots, on small maps and where rules look anywhere.

    Args:
      belief: what the robot knows.
      before: cells known to be reachable, such as those of the step before.
      rules: what counts as frontier.
    """
    n_words, height, *batch = before.shape
    if batch != [1] or n_words <= _WORDS or height <= _ROWS or rules.reach is None:
        return None
    x, y = belief.pose.x[0], belief.pose.y[0]
    window = _Window(
        word=jnp.clip((x - WORD_BITS // 2) // WORD_BITS, 0, n_words - _WORDS),
        row=jnp.clip(y - _ROWS // 2, 0, height - _ROWS),
    )
    padding = ~jnp.asarray(bitboard.full(height, belief.width))[..., None]
    outside = padding if belief.outside is None else padding | belief.outside
    part = dataclasses.replace(
        belief,
        pose=Pose(belief.pose.x - WORD_BITS * window.word, belief.pose.y - window.row, belief.pose.heading),
        width=_WORDS * WORD_BITS,
        outside=window.of(outside),
        **window.of({name: getattr(belief, name) for name in ("classes", "seen", "traversable", "goals")}),
    )
    robot = bitboard.single(part.pose.x, part.pose.y, _WORDS, _ROWS)
    ground = bitboard.flood(robot | window.of(before), part.traversable)
    reachable = window.put(before, ground)
    # A set that holds the robot, and from which no step leads out, is all that is reachable.
    complete = ~bitboard.intersects(bitboard.neighbors(reachable) & ~reachable, belief.traversable)
    first = search.first_action(part.pose, rules.frontier_expanding(part, ground), ground)
    # Poses this far away are judged as on the whole map. At its edges there is nothing beyond the window.
    last_word, last_row = n_words - _WORDS, height - _ROWS
    sides = (
        (window.word > 0, part.pose.x),
        (window.word < last_word, _WORDS * WORD_BITS - 1 - part.pose.x),
        (window.row > 0, part.pose.y),
        (window.row < last_row, _ROWS - 1 - part.pose.y),
    )
    far = jnp.int32(height * WORD_BITS * n_words)
    margin = jnp.min(jnp.stack([jnp.where(inside, cells[0], far) for inside, cells in sides]))
    certain = complete & ~bitboard.intersects(reachable, belief.goals) & first.found & (first.length > 0)
    return Nearby(certain[0] & (first.length[0] + rules.reach <= margin), reachable, first)
