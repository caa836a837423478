"""Packed sets of grid cells.

A *board* holds one set of cells of an `h x w` grid as `uint32[n_words, h]`: bit `i` of word `j` in row `y`
is the cell in column `32 j + i`. Set algebra on boards is `&`, `|` and `~` on whole words, so one operation
handles 32 cells. Bits beyond column `w - 1` are padding. They stay zero in every set that is intersected with a set
of in-bounds cells.

Words of the same column of words are adjacent in memory. One vector instruction then handles as many rows as it has
lanes, and a shift by rows is a shifted view. Functions take one board or a batch of boards. Batch axes come last, here
and in all code built on boards: a thousand boards are `uint32[n_words, h, 1000]`. The lanes of a vector then handle
different robots, which is faster than a batch axis in front.
"""

import collections
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, UInt32

from dc2g_jax._src.grid.loops import for_each_until, repeated, until
from dc2g_jax._src.runtime.programs import apart

WORD_BITS = 32

#: Steps of a flood between checks for growth on a CPU: a check costs more than a step.
_STEPS_PER_CHECK = 4

Board = UInt32[Array, "n_words h *batch"]
Offsets = tuple[tuple[int, int], ...]

#: Programs call a function many times with arrays of one shape. It is traced for the first call, and its operations are
#: inlined in all of them.
_traced_once = functools.partial(jax.jit, inline=True)  # noqa: TID251, since all arguments are arrays


def word_count(width: int) -> int:
    """Number of 32-bit words that hold a row of `width` cells."""
    return -(-width // WORD_BITS)


def pack(cells: Bool[Array, "h w *batch"]) -> Board:
    """Pack a boolean grid into a board."""
    height, width, *batch = cells.shape
    n_words = word_count(width)
    padding = [(0, 0)] * cells.ndim
    padding[1] = (0, n_words * WORD_BITS - width)
    bits = jnp.pad(jnp.asarray(cells, jnp.uint32), padding).reshape(height, n_words, WORD_BITS, *batch)
    place = jax.lax.broadcasted_iota(jnp.uint32, bits.shape, 2)
    return jnp.swapaxes(jnp.sum(bits << place, axis=2, dtype=jnp.uint32), 0, 1)


def _bits(board: Board) -> UInt32[Array, "h 32*n_words *batch"]:
    """The bits of a board, cell by cell."""
    n_words, height, *batch = board.shape
    place = jax.lax.broadcasted_iota(jnp.uint32, (height, n_words, WORD_BITS, *batch), 2)
    bits = (jnp.swapaxes(board, 0, 1)[:, :, None] >> place) & jnp.uint32(1)
    return bits.reshape(height, n_words * WORD_BITS, *batch)


@functools.partial(_traced_once, static_argnames="width")
def unpack(board: Board, width: int) -> Bool[Array, "h w *batch"]:
    """Unpack a board into a boolean grid of `width` columns."""
    return apart(lambda board: _bits(board)[:, :width].astype(bool), board)


@functools.partial(_traced_once, static_argnames="width")
def numbers(planes: UInt32[Array, "bit n_words h *batch"], width: int) -> Int[Array, "h w *batch"]:
    """The number of every cell of a grid of `width` columns, from a board for each bit, highest first."""

    def unpacked(planes: UInt32[Array, "bit n_words h *batch"]) -> Int[Array, "h w *batch"]:
        number = functools.reduce(lambda number, bits: 2 * number + bits, map(_bits, planes))
        return number[:, :width].astype(jnp.int32)

    return apart(unpacked, planes)


def full(height: int, width: int) -> UInt32[np.ndarray, "n_words h"]:
    """The board of all in-bounds cells, as a NumPy constant."""
    bits_left = np.clip(width - WORD_BITS * np.arange(word_count(width)), 0, WORD_BITS)
    row = (np.uint64(1) << bits_left.astype(np.uint64)) - np.uint64(1)
    return np.tile(row.astype(np.uint32)[:, None], (1, height))


def complement(board: Board, width: int) -> Board:
    """The in-bounds cells that are not in the set, of a grid of `width` columns."""
    return ~board & full(1, width).reshape(-1, *(1 for _ in board.shape[1:]))


def word_and_bit(x: Int[Array, "*batch"]) -> tuple[Int[Array, "*batch"], UInt32[Array, "*batch"]]:
    """Word and bit of a column. `//` and `%` also handle signs, which takes many times as long as shift and mask."""
    return x >> (WORD_BITS.bit_length() - 1), (x & (WORD_BITS - 1)).astype(jnp.uint32)


def single(x: Int[Array, "*batch"], y: Int[Array, "*batch"], n_words: int, height: int) -> Board:
    """The board that holds the one cell in column `x`, row `y`, which must be in bounds."""
    shape = (n_words, height, *x.shape)
    word, row = (jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (0, 1))
    own_word, bit = word_and_bit(x)
    return jnp.where((row == y) & (word == own_word), jnp.uint32(1) << bit, jnp.uint32(0))


def _word_at(board: Board, word: Int[Array, "*batch"], row: Int[Array, "*batch"]) -> UInt32[Array, "*batch"]:
    n_words, height, *batch = board.shape
    words = board.reshape(n_words * height, *batch)
    return jnp.take_along_axis(words, (word * height + row)[None], axis=0, mode="promise_in_bounds")[0]


def contains(board: Board, x: Int[Array, "*batch"], y: Int[Array, "*batch"]) -> Bool[Array, "*batch"]:
    """Whether the set contains the cell in column `x`, row `y`, which must be in bounds."""
    word, bit = word_and_bit(x)
    return ((_word_at(board, word, y) >> bit) & 1) == 1


def is_empty(board: Board) -> Bool[Array, "*batch"]:
    """Whether the set is empty."""
    return ~jnp.any(board != 0, axis=(0, 1))


def intersects(a: Board, b: Board) -> Bool[Array, "*batch"]:
    """Whether two sets share a cell."""
    return ~is_empty(a & b)


def count(board: Board) -> Int[Array, "*batch"]:
    """Number of cells in the set."""
    return jnp.sum(jax.lax.population_count(board).astype(jnp.int32), axis=(0, 1))


def first(board: Board) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"]]:
    """Column and row of the set's first cell in raster order (row by row, left to right); (0, 0) for an empty set."""
    n_words, height = board.shape[:2]
    word, row = (jax.lax.broadcasted_iota(jnp.int32, board.shape, axis) for axis in (0, 1))
    beyond = n_words * height
    number = jnp.min(jnp.where(board != 0, row * n_words + word, beyond), axis=(0, 1))
    number = jnp.where(number == beyond, 0, number).astype(jnp.uint32)
    first_row, first_word = (part.astype(jnp.int32) for part in jnp.divmod(number, jnp.uint32(n_words)))
    bits = _word_at(board, first_word, first_row)
    lowest_bit = jax.lax.population_count((bits & (~bits + jnp.uint32(1))) - jnp.uint32(1)).astype(jnp.int32)
    return jnp.where(bits == 0, 0, first_word * WORD_BITS + lowest_bit), first_row


def _shift_axis(board: Board, amount: int, axis: int) -> Board:
    """Move whole words (`axis=0`) or rows (`axis=1`) by `amount`, filling with zeros."""
    padding = [(0, 0, 0)] * board.ndim
    padding[axis] = (amount, -amount, 0)
    return jax.lax.pad(board, jnp.uint32(0), padding)


def shift(board: Board, dx: int, dy: int) -> Board:
    """Move the set by `dx` columns (to larger x) and `dy` rows (to larger y).

    Cells moved off the map vanish; cells moved past column `w - 1` may lie in the padding until the result is
    intersected with a set of in-bounds cells.
    """
    words, bits = divmod(dx, WORD_BITS)
    moved = _shift_axis(board, words, 0)
    if bits:
        carried = _shift_axis(board, words + 1, 0)
        moved = (moved << jnp.uint32(bits)) | (carried >> jnp.uint32(WORD_BITS - bits))
    return _shift_axis(moved, dy, 1)


def neighbors(board: Board) -> Board:
    """Cells with a 4-neighbor in the set."""
    return cells_that_see(board, ((1, 0), (-1, 0), (0, 1), (0, -1)))


def flood(seed: Board, free: Board) -> Board:
    """Cells of `free` that are 4-connected to `seed` through `free`, including `seed & free`.

    The flood is faster if the seed already holds part of the result, such as the flood of the previous step.
    """
    most = seed.shape[0] * seed.shape[1] * WORD_BITS + 1

    def grown(steps: int, cells: Board, free: Board) -> Board:
        return repeated(steps, lambda _, cells: cells | (neighbors(cells) & free), cells)

    def together(seed: Board, free: Board) -> Board:
        def grow(carry: tuple[Board, Array]) -> tuple[Board, Array]:
            # A complete board does not change while other boards of the batch still grow.
            cells = grown(_STEPS_PER_CHECK, carry[0], free)
            return cells, jnp.any(cells != carry[0])

        return until(lambda carry: ~carry[1], grow, (seed, jnp.bool_(True)), most=most)[0]

    def each(seed: Board, free: Board) -> Board:
        def grow(steps: int, carry: tuple[Board, Array], free: Board) -> tuple[Board, Array]:
            cells = grown(steps, carry[0], free)
            return cells, jnp.any(cells != carry[0], axis=(0, 1))

        first = seed, jnp.ones(seed.shape[2:], bool)
        return for_each_until(lambda carry: carry[1], grow, lambda carry, _: carry[0], first, free, most=most)

    return jax.lax.platform_dependent(seed & free, free, cpu=together, default=each)


@functools.partial(_traced_once, static_argnames="offsets")
def cells_that_see(targets: Board, offsets: Offsets) -> Board:
    """Cells `p` for which `p + offset` is in `targets` for at least one of the constant `offsets` `(dx, dy)`.

    The targets are padded with zeros once. Every offset is then a plain view of the padded board, and all offsets form
    one loop without a branch. This is faster than sharing work between neighboring offsets. Offsets with the same `dx`
    share their bit shift.
    """
    by_column: dict[int, list[int]] = collections.defaultdict(list)
    for dx, dy in offsets:
        by_column[dx].append(dy)
    n_words, height, *batch = targets.shape
    rows = max((abs(dy) for dys in by_column.values() for dy in dys), default=0)
    words = max((word_count(abs(dx)) for dx in by_column), default=0)
    padding = [(words, words), (rows, rows)] + [(0, 0) for _ in batch]
    framed = apart(functools.partial(jnp.pad, pad_width=padding), targets)

    def rows_together(dys: list[int], first_word: int) -> Board:
        columns = framed[words + first_word : words + first_word + n_words]
        return functools.reduce(jnp.bitwise_or, (columns[:, rows + dy : rows + dy + height] for dy in dys))

    seeing = jnp.zeros_like(targets)
    for dx, dys in sorted(by_column.items()):
        word, bit = divmod(dx, WORD_BITS)
        view = rows_together(dys, word)
        if bit:
            view = (view >> jnp.uint32(bit)) | (rows_together(dys, word + 1) << jnp.uint32(WORD_BITS - bit))
        seeing |= view
    return seeing
