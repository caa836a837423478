"""Packed cell sets against boolean arrays."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

from dc2g_jax._src.grid import bitboard
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps

EXAMPLES = 25
SHIFTS = (0, 1, -1, 2, -3, 31, -31, 32, -32, 33, -33, 63, -64, 65, -70)
#: Single offsets, rows with gaps, rows across the robot, long rows, rows that reach beyond a word.
OFFSET_SETS = (
    ((0, 0),),
    ((3, -2),),
    tuple((dx, 0) for dx in range(-4, 6)),
    tuple((dx, 1) for dx in range(2, 9)) + tuple((dx, -1) for dx in (-7, -6, -3, -2, -1, 4, 6)),
    tuple((dx, dy) for dy in (-2, 0, 2) for dx in range(-dy - 1, dy + 6)),
    tuple((dx, 0) for dx in range(-40, -29)) + tuple((dx, 0) for dx in range(30, 39)),
)

each_shape = pytest.mark.parametrize("shape", maps.SHAPES, ids="{0[0]}x{0[1]}".format)
examples = settings(max_examples=EXAMPLES)


def shifted(cells: np.ndarray, dx: int, dy: int) -> np.ndarray:
    """Cell by cell."""
    moved = np.zeros_like(cells)
    for y, x in np.argwhere(cells):
        if 0 <= x + dx < cells.shape[1] and 0 <= y + dy < cells.shape[0]:
            moved[y + dy, x + dx] = True
    return moved


@functools.cache
def everything(shape: tuple[int, int]):
    """All operations on one pair of sets, compiled once a shape."""
    height, width = shape
    full = jnp.asarray(bitboard.full(height, width))

    def bits(board):
        return bitboard.unpack(board & full, width)

    def run(cells, others):
        a, b = bitboard.pack(cells), bitboard.pack(others)
        columns, rows = jnp.meshgrid(jnp.arange(width), jnp.arange(height))
        contains = jax.vmap(jax.vmap(functools.partial(bitboard.contains, a)))
        x, y = bitboard.first(a)
        return {
            "boards": (a, b),
            "unpacked": bitboard.unpack(a, width),
            "count": bitboard.count(a),
            "is_empty": bitboard.is_empty(a),
            "intersects": bitboard.intersects(a, b),
            "first": (x, y),
            "complement": bitboard.unpack(bitboard.complement(a, width), width),
            "contains": contains(columns, rows),
            "neighbors": bits(bitboard.neighbors(a)),
            "flood": bits(bitboard.flood(a, b)),
            "shifted": [bits(bitboard.shift(a, dx, dy)) for dx in SHIFTS for dy in (0, 2, -1)],
            "rows_down": [bits(bitboard.shift(a, 0, dy)) for dy in (height - 1, -height, height + 3)],
            "seeing": [bits(bitboard.cells_that_see(a, offsets)) for offsets in OFFSET_SETS],
        }

    return jax.jit(run)


@each_shape
@given(seed=maps.seeds, density=maps.densities, free_density=maps.densities)
@examples
def test_every_operation_equals_its_cell_by_cell_meaning(shape, seed, density, free_density):
    cells, others = maps.random_cells(seed, shape, density), maps.random_cells(seed + 1, shape, free_density)
    result = jax.tree.map(np.asarray, everything(shape)(cells, others))

    np.testing.assert_array_equal(result["unpacked"], cells)
    for board in result["boards"]:
        assert not (board & ~bitboard.full(*shape)).any(), "padding must stay zero"
    assert result["count"] == cells.sum()
    assert result["is_empty"] == (not cells.any())
    assert result["intersects"] == (cells & others).any()
    np.testing.assert_array_equal(result["contains"], cells)
    np.testing.assert_array_equal(result["complement"], ~cells)
    np.testing.assert_array_equal(result["neighbors"], oracle._neighbor_of(cells))

    row, column = np.unravel_index(np.argmax(cells), shape)
    assert result["first"] == (column, row)

    flooded = np.zeros_like(cells)
    for y, x in np.argwhere(cells & others):
        if not flooded[y, x]:
            flooded |= oracle.reachable(others, int(x), int(y))
    np.testing.assert_array_equal(result["flood"], flooded)

    wanted = [shifted(cells, dx, dy) for dx in SHIFTS for dy in (0, 2, -1)]
    for one, other in zip(result["shifted"], wanted, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, dy in zip(result["rows_down"], (shape[0] - 1, -shape[0], shape[0] + 3), strict=True):
        np.testing.assert_array_equal(one, shifted(cells, 0, dy))
    for one, offsets in zip(result["seeing"], OFFSET_SETS, strict=True):
        np.testing.assert_array_equal(one, oracle._sources(cells, list(offsets)), err_msg=str(offsets))


@each_shape
def test_bits_are_columns_counted_from_the_lowest(shape):
    height, width = shape
    board = np.asarray(bitboard.pack(jnp.ones(shape, bool)))
    assert board.dtype == np.uint32
    assert board.shape == (bitboard.word_count(width), height)
    np.testing.assert_array_equal(board, bitboard.full(height, width))
    for x in {0, width // 2, width - 1}:
        single = np.asarray(bitboard.single(jnp.int32(x), jnp.int32(height - 1), *board.shape))
        assert single[x // 32, height - 1] == 1 << (x % 32)
        assert np.count_nonzero(single) == 1


@pytest.mark.parametrize(
    ("width", "words"), [(1, 1), (31, 1), (32, 1), (33, 2), (63, 2), (64, 2), (65, 3), (96, 3), (97, 4)]
)
def test_word_count(width, words):
    assert bitboard.word_count(width) == words


def test_further_axes_are_a_batch():
    cells = np.stack([[maps.random_cells(10 * i + j, (7, 33), 0.5) for i in range(3)] for j in range(2)])
    cells = np.moveaxis(cells, (2, 3), (0, 1))
    boards = bitboard.pack(jnp.asarray(cells))
    assert boards.shape == (2, 7, 2, 3)
    np.testing.assert_array_equal(bitboard.unpack(boards, 33), cells)
    x, y = jnp.asarray([[3, 32, 0], [31, 7, 5]]), jnp.asarray([[0, 6, 2], [1, 1, 4]])
    free = bitboard.pack(jnp.asarray(np.roll(cells, 1, axis=-1) | cells))
    for operation in (
        lambda board, free, x, y: (bitboard.count(board), bitboard.is_empty(board), bitboard.first(board)),
        lambda board, free, x, y: bitboard.neighbors(board),
        lambda board, free, x, y: bitboard.shift(board, 5, -1),
        lambda board, free, x, y: bitboard.cells_that_see(board, OFFSET_SETS[3]),
        lambda board, free, x, y: bitboard.complement(board, 33),
        lambda board, free, x, y: bitboard.intersects(board, ~free),
        lambda board, free, x, y: (bitboard.contains(board, x, y), bitboard.single(x, y, 2, 7)),
        lambda board, free, x, y: bitboard.flood(bitboard.single(x, y, 2, 7), free),
    ):
        together = operation(boards, free, x, y)
        for j, i in np.ndindex(2, 3):
            alone = operation(boards[..., j, i], free[..., j, i], x[j, i], y[j, i])
            jax.tree.map(
                lambda many, one, j=j, i=i: np.testing.assert_array_equal(many[..., j, i], one), together, alone
            )


def test_a_flood_that_goes_on_from_an_earlier_answer_gives_the_same():
    free = bitboard.pack(jnp.asarray(maps.random_cells(4, (20, 65), 0.7)))
    everything_free = bitboard.unpack(free, 65)
    y, x = np.argwhere(np.asarray(everything_free))[0]
    seed = bitboard.single(jnp.int32(x), jnp.int32(y), 3, 20)
    whole = bitboard.flood(seed, free)
    part = seed | (bitboard.neighbors(seed) & free)
    np.testing.assert_array_equal(bitboard.flood(part, free), whole)
