"""Packed sets of grid cells.

A *board* holds one set of cells of an `h x w` grid as `uint32[h, n_words]`: bit `i` of word `j` in row `y`
is the cell in column `32 j + i`. Set algebra on boards is `&`, `|` and `~` on whole words, so one operation
handles 32 cells. Bits beyond column `w - 1` are padding: every set built here and intersected with a set of
in-bounds cells keeps them zero.

All functions work on leading batch axes too, except where a docstring says otherwise.
"""

from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, UInt32

WORD_BITS = 32

Board = UInt32[Array, "*batch h n_words"]
Offsets = Iterable[tuple[int, int]]


def word_count(width: int) -> int:
    """Number of 32-bit words that hold a row of `width` cells."""
    return -(-width // WORD_BITS)


def pack(cells: Bool[Array, "*batch h w"]) -> Board:
    """Pack a boolean grid into a board."""
    width = cells.shape[-1]
    n_words = word_count(width)
    padding = [(0, 0)] * (cells.ndim - 1) + [(0, n_words * WORD_BITS - width)]
    bits = jnp.pad(jnp.asarray(cells, jnp.uint32), padding)
    bits = bits.reshape(*cells.shape[:-1], n_words, WORD_BITS)
    return jnp.sum(bits << jnp.arange(WORD_BITS, dtype=jnp.uint32), axis=-1, dtype=jnp.uint32)


def unpack(board: Board, width: int) -> Bool[Array, "*batch h w"]:
    """Unpack a board into a boolean grid of `width` columns."""
    bits = (board[..., None] >> jnp.arange(WORD_BITS, dtype=jnp.uint32)) & jnp.uint32(1)
    return bits.reshape(*board.shape[:-1], -1)[..., :width].astype(bool)


def full(height: int, width: int) -> UInt32[np.ndarray, "h n_words"]:
    """The board of all in-bounds cells, as a NumPy constant."""
    bits_left = np.clip(width - WORD_BITS * np.arange(word_count(width)), 0, WORD_BITS)
    row = (np.uint64(1) << bits_left.astype(np.uint64)) - np.uint64(1)
    return np.tile(row.astype(np.uint32), (height, 1))


def single(x: Int[Array, ""], y: Int[Array, ""], height: int, n_words: int) -> Board:
    """The board that holds the one cell in column `x`, row `y`, which must be in bounds (no batch axes)."""
    bit = jnp.left_shift(jnp.uint32(1), (x % WORD_BITS).astype(jnp.uint32))
    here = (jnp.arange(height) == y)[:, None] & (jnp.arange(n_words) == x // WORD_BITS)
    return jnp.where(here, bit, jnp.uint32(0))


def contains(board: Board, x: Int[Array, ""], y: Int[Array, ""]) -> Bool[Array, ""]:
    """Is the in-bounds cell in column `x`, row `y` in the set (no batch axes)?"""
    return intersects(board, single(x, y, *board.shape))


def is_empty(board: Board, axes: tuple[int, ...] | None = None) -> Bool[Array, "..."]:
    """Is the set empty? Over all axes, or over the given ones."""
    return ~jnp.any(board != 0, axis=axes)


def intersects(a: Board, b: Board) -> Bool[Array, ""]:
    """Do two sets share a cell? Over all axes."""
    return jnp.any((a & b) != 0)


def count(board: Board) -> Int[Array, "*batch"]:
    """Number of cells in the set."""
    return jnp.sum(jax.lax.population_count(board).astype(jnp.int32), axis=(-2, -1))


def first(board: Board) -> Board:
    """The set's first cell in raster order alone (row by row, left to right); empty for an empty set.

    No batch axes.
    """
    words = board.reshape(-1)
    is_first_word = jnp.arange(words.size) == jnp.argmax(words != 0)
    lowest_bit = words & (~words + jnp.uint32(1))
    return jnp.where(is_first_word, lowest_bit, jnp.uint32(0)).reshape(board.shape)


def _shift_axis(board: Board, amount: int, axis: int) -> Board:
    """Move whole rows (`axis=-2`) or words (`axis=-1`) by `amount`, filling with zeros."""
    size = board.shape[axis]
    if amount == 0:
        return board
    if abs(amount) >= size:
        return jnp.zeros_like(board)
    kept = jax.lax.slice_in_dim(board, max(0, -amount), size - max(0, amount), axis=board.ndim + axis)
    padding = [(0, 0, 0)] * board.ndim
    padding[axis] = (max(0, amount), max(0, -amount), 0)
    return jax.lax.pad(kept, jnp.uint32(0), padding)


def _shift_columns(board: Board, dx: int) -> Board:
    """Move the set by `dx` columns. Cells moved past the last word vanish."""
    words, bits = divmod(dx, WORD_BITS)
    low = _shift_axis(board, words, -1)
    if bits == 0:
        return low
    carried = _shift_axis(board, words + 1, -1)
    return (low << jnp.uint32(bits)) | (carried >> jnp.uint32(WORD_BITS - bits))


def shift(board: Board, dx: int, dy: int) -> Board:
    """Move the set by `dx` columns (to larger x) and `dy` rows (to larger y).

    Cells moved off the map vanish; cells moved past column `w - 1` may lie in the padding until the result is
    intersected with a set of in-bounds cells.
    """
    return _shift_axis(_shift_columns(board, dx), dy, -2)


def neighbours(board: Board) -> Board:
    """Cells with a 4-neighbour in the set."""
    return shift(board, 1, 0) | shift(board, -1, 0) | shift(board, 0, 1) | shift(board, 0, -1)


def flood(seed: Board, free: Board) -> Board:
    """Cells of `free` that are 4-connected to `seed` through `free`, and `seed & free` itself (no batch axes).

    A seed that already holds a part of the answer (the last step's, say) makes the flood shorter by as much.
    """
    inside = seed & free

    def grow(carry: tuple[Board, Array]) -> tuple[Board, Array]:
        reached, _ = carry
        grown = reached | (neighbours(reached) & free)
        return grown, jnp.any(grown != reached)

    return jax.lax.while_loop(lambda carry: carry[1], grow, (inside, ~is_empty(inside)))[0]


def _runs(offsets: Offsets) -> list[tuple[int, int, int]]:
    """Split offsets into horizontal runs `(dy, dx of the offset nearest to 0, length)` on one side of `dx = 0`."""
    runs: list[tuple[int, int, int]] = []
    for dy, right, distance in sorted((dy, dx >= 0, abs(dx)) for dx, dy in offsets):
        sign = 1 if right else -1
        if runs:
            last_dy, last_dx, length = runs[-1]
            if last_dy == dy and sign * (distance - length) == last_dx and (last_dx >= 0) == right:
                runs[-1] = (dy, last_dx, length + 1)
                continue
        runs.append((dy, sign * distance, 1))
    return runs


def cells_that_see(targets: Board, offsets: Offsets) -> Board:
    """Cells `p` for which `p + offset` is in `targets` for at least one of the constant `offsets` `(dx, dy)`.

    Offsets are handled a horizontal run at a time, and a run of length `n` as the union of two runs whose
    length is a power of two, so that the work grows with the number of rows and not with the number of offsets.
    Runs lie on one side of `dx = 0`, so that cells only ever move outward and none is lost at an edge.
    """
    runs = _runs(offsets)
    longest = max((length for _, _, length in runs), default=1)
    seeing = jnp.zeros_like(targets)
    for sign in (1, -1):
        # doubled[k]: cells from which one of the 2^k cells on that side, the own one included, is a target
        doubled = [targets]
        while 2 ** len(doubled) <= longest:
            last = doubled[-1]
            doubled.append(last | shift(last, -sign * 2 ** (len(doubled) - 1), 0))
        for dy, dx, length in runs:
            if (dx >= 0) != (sign > 0):
                continue
            power = length.bit_length() - 1
            rest = length - 2**power
            row = shift(doubled[power], -dx, -dy)
            seeing |= row if rest == 0 else row | shift(doubled[power], -(dx + sign * rest), -dy)
    return seeing
