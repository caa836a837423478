"""Windows: the part of a large grid around one robot, in whole words and rows."""

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, UInt32

from dc2g_jax._src.grid.bitboard import WORD_BITS, word_and_bit
from dc2g_jax._src.grid.poses import Pose

_Boards = TypeVar("_Boards")


@dataclasses.dataclass(frozen=True)
class Window:
    """A part of a grid of one robot, see `window_around`.

    Attributes:
      word: first word of a row.
      row: first row.
      words: words in a row.
      rows: rows.
    """

    word: Int[Array, ""]
    row: Int[Array, ""]
    words: int
    rows: int

    @property
    def column(self) -> Int[Array, ""]:
        """First column."""
        return WORD_BITS * self.word

    def pose(self, pose: Pose) -> Pose:
        """A pose on the grid, in the window's cells."""
        return Pose(pose.x - self.column, pose.y - self.row, pose.heading)

    def cut(self, boards: _Boards) -> _Boards:
        """The window's part of boards `[... n_words h 1]`."""

        def part(board: UInt32[Array, "*planes n_words h 1"]) -> UInt32[Array, "*planes words rows 1"]:
            words = jax.lax.dynamic_slice_in_dim(board, self.word, self.words, axis=-3)
            return jax.lax.dynamic_slice_in_dim(words, self.row, self.rows, axis=-2)

        return jax.tree.map(part, boards)

    def put(self, boards: _Boards, parts: _Boards) -> _Boards:
        """The boards with these parts in place of the window's."""

        def changed(board: Array, part: Array) -> Array:
            return jax.lax.dynamic_update_slice(board, part, (*[0] * (board.ndim - 3), self.word, self.row, 0))

        return jax.tree.map(changed, boards, parts)


def window_around(pose: Pose, words: int, rows: int, grid: tuple[int, int]) -> Window:
    """The window with the robot in the middle, or as near to it as the grid's edges allow.

    The robot has at least `16 * (words - 1)` columns and `(rows - 1) // 2` rows of the grid on every side, or all.
    `grid` holds the words in a row of the grid and its rows; a window is not larger.
    """
    words, rows = min(words, grid[0]), min(rows, grid[1])
    word, _ = word_and_bit(pose.x[0] - WORD_BITS // 2 * (words - 1))
    row = pose.y[0] - rows // 2
    return Window(jnp.clip(word, 0, grid[0] - words), jnp.clip(row, 0, grid[1] - rows), words, rows)
