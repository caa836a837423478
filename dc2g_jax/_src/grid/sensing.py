"""Which cells a robot sees from a pose: kernels of constant offsets, one set per heading.

The paper's field of view is 90 degrees wide and has no occlusion: it is four constant sets of offsets, moved to the
robot's cell. Other widths have other sets. With occlusion (`line_of_sight`), the offsets form a tree: a cell is seen
through an adjacent cell nearer to the robot, which is its parent. Batch axes come last, see `grid.bitboard`.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Shaped, UInt, UInt32
from scipy import ndimage

from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.bitboard import WORD_BITS, Board
from dc2g_jax._src.grid.poses import FORWARD, HEADINGS, Pose, PoseSet
from dc2g_jax._src.grid.squares import running_sums
from dc2g_jax._src.runtime.errors import check_number
from dc2g_jax._src.runtime.programs import apart

#: Largest sensing range that options accept, in cells: the size of a kernel grows with its square.
MAX_SENSING_RANGE = 64

#: Width of the paper's field of view, and of one that covers all directions, in degrees.
PAPER_DEGREES, ALL_AROUND = 90.0, 360.0


def check_sensing_range(name: str, value: Any) -> None:
    """Check a range of a field of view, in cells.

    Raises:
      InputError: it is not a whole number from 1 to `MAX_SENSING_RANGE`.
    """
    check_number(name, value, whole=True, least=1, most=MAX_SENSING_RANGE, hint="cells")


def check_degrees(name: str, value: Any) -> None:
    """Check the width of a field of view, in degrees.

    Raises:
      InputError: it is not a number from 1 to 360.
    """
    check_number(name, value, least=1, most=ALL_AROUND, hint="degrees")


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A set of offsets from the robot's cell for each heading. Hashable, so it can be a static argument of `jit`.

    Attributes:
      radius: bound on the absolute offsets along x and y, in cells.
      offsets: the offsets `(dx, dy)` of each of the four headings.
      degrees: width of the field of view that the offsets make up, for messages; `None` if they make up another shape.
    """

    radius: int
    offsets: tuple[tuple[tuple[int, int], ...], ...] = dataclasses.field(repr=False)
    degrees: float | None = dataclasses.field(default=None, repr=False, compare=False)

    def as_array(self) -> Bool[np.ndarray, "heading dy dx"]:
        """The kernel as a boolean array with the robot's cell at index `(radius, radius)`."""
        size = 2 * self.radius + 1
        array = np.zeros((HEADINGS, size, size), dtype=bool)
        for heading, offsets in enumerate(self.offsets):
            for dx, dy in offsets:
                array[heading, dy + self.radius, dx + self.radius] = True
        return array

    def visible(self, pose: Pose, opaque: Board, width: int | Int[Array, ""]) -> Board:
        """The in-bounds cells that are seen from a pose.

        Args:
          pose: pose of the robot.
          opaque: cells that hide what is behind them. This kernel ignores them.
          width: columns of the grid.
        """
        return covered(pose, self.radius, kernel_runs(self), opaque.shape[0], opaque.shape[1], width)

    def poses_that_see(self, targets: Board, opaque: Board) -> PoseSet:
        """Poses from which at least one target cell is seen, see `visible`."""
        del opaque
        return self._stacked(lambda offsets, board: bitboard.cells_that_see(board, offsets), targets)

    @property
    def _all_around(self) -> bool:
        """Whether the robot sees the same cells in all headings."""
        return len({frozenset(offsets) for offsets in self.offsets}) == 1

    def _stacked(self, of: Callable[[tuple[tuple[int, int], ...], Array], Array], cells: Array) -> Array:
        """`of(offsets, cells)` for each heading, computed once if all headings have the same offsets."""
        if self._all_around:
            every = apart(functools.partial(of, self.offsets[0]), cells)
            return jnp.broadcast_to(every, (HEADINGS, *every.shape))
        return jnp.stack([of(offsets, cells) for offsets in self.offsets])

    def count_seen(self, targets: Board, opaque: Board, width: int) -> UInt[Array, "heading h w *batch"]:
        """Number of target cells that are seen from every pose, see `visible`.

        Args:
          targets: cells to count.
          opaque: see `visible`.
          width: columns of the grid.
        """
        del opaque
        (height, *batch), radius = targets.shape[1:], self.radius
        frame = [(radius + 1, radius), (radius, radius), *((0, 0) for _ in batch)]
        framed = jnp.pad(bitboard.unpack(targets, width).astype(self._count), frame)
        # A run of offsets down a column is the difference of two sums, exact although small integers overflow. Without
        # the barrier, a GPU would compute the sums again for each offset.
        cumsum = functools.partial(jnp.cumsum, axis=0, dtype=framed.dtype)
        sums = jax.lax.optimization_barrier(jax.lax.platform_dependent(framed, cpu=running_sums, default=cumsum))

        def counted(runs: list[tuple[int, int, int]], sums: Array) -> Array:
            def until(dx: int, dy: int) -> Array:
                return sums[radius + 1 + dy :, radius + dx :][:height, :width]

            return functools.reduce(jnp.add, [until(dx, last) - until(dx, first - 1) for dx, first, last in runs])

        return self._stacked(lambda offsets, sums: apart(functools.partial(counted, _runs(offsets)), sums), sums)

    @property
    def _count(self) -> type:
        """The integer type that can count the cells in view."""
        return jnp.uint8 if max(map(len, self.offsets)) < 256 else jnp.uint16


def _runs(offsets: tuple[tuple[int, int], ...]) -> list[tuple[int, int, int]]:
    """Runs of offsets down the columns: dx, and the first and last dy."""
    runs: list[tuple[int, int, int]] = []
    for dx, dy in sorted(offsets):
        first = runs.pop()[1] if runs and runs[-1][::2] == (dx, dy - 1) else dy
        runs.append((dx, first, dy))
    return runs


@dataclasses.dataclass(frozen=True)
class OccludedKernel(Kernel):
    """A set of offsets that are seen only where nothing opaque is in between.

    An offset is seen through its parent: the offset one cell nearer, along x or y, that lies next to the straight line
    to the robot. A cell is hidden if its parent is hidden or opaque; the robot's own cell hides nothing. Hidden cells
    are therefore revealed one after the other: a robot that drives to a pose from which, as far as it knows, it would
    see something unobserved does observe something new there.
    """

    def visible(self, pose: Pose, opaque: Board, width: int | Int[Array, ""]) -> Board:
        """The in-bounds cells that are seen from a pose, see `Kernel.visible`."""
        height = opaque.shape[1]
        dx, dy, parents = self._tree()
        there = (jnp.moveaxis(jnp.asarray(table)[pose.heading], -1, 0) for table in (dx, dy))
        x, y = (offsets + here for offsets, here in zip(there, (pose.x, pose.y), strict=True))
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        is_opaque = jax.vmap(functools.partial(bitboard.contains, opaque))
        hides = is_opaque(jnp.clip(x, 0, width - 1), jnp.clip(y, 0, height - 1)) & inside
        # The robot's own cell comes first and hides nothing.
        seen = jnp.concatenate([jnp.ones_like(hides[:1]), ~hides[1:]])[parents]
        # Each round looks twice as many steps toward the robot. There are never more steps than `radius`.
        for _ in range((self.radius - 1).bit_length()):
            seen &= seen[parents]
            parents = parents[parents]
        cells = bitboard.single(x, jnp.where(seen & inside, y, -1), *opaque.shape[:2])
        return jnp.bitwise_or.reduce(cells, axis=2)

    def poses_that_see(self, targets: Board, opaque: Board) -> PoseSet:
        """Poses from which at least one target cell is seen, see `visible`."""
        return self._over_offsets(jnp.bitwise_or, targets, targets, opaque)

    def count_seen(self, targets: Board, opaque: Board, width: int) -> UInt[Array, "heading h w *batch"]:
        """Number of target cells that are seen from every pose, see `Kernel.count_seen`."""

        def add(count: Array, more: Board) -> Array:
            return count + bitboard.unpack(more, width)

        return self._over_offsets(add, bitboard.unpack(targets, width).astype(self._count), targets, opaque)

    def _over_offsets(
        self, add: Callable[[Array, Board], Array], own: Array, targets: Board, opaque: Board
    ) -> Shaped[Array, "heading ..."]:
        """Fold `add(result so far, cells from which a target is seen at the offset)` over the offsets of each heading.

        The fold begins with `own`, the result for the robot's own cell.
        """
        height = opaque.shape[1]
        dx, dy, _ = self._tree()
        headings = slice(1 if self._all_around else HEADINGS)
        # The offsets are in depth-first order, so one slot for each depth is enough.
        depth = np.maximum(np.abs(dx), np.abs(dy))
        reach = range(-self.radius, self.radius + 1)
        framed = [(0, 0), (self.radius, self.radius)] + [(0, 0)] * (opaque.ndim - 2)
        columns = jnp.stack(
            [jnp.stack([jnp.pad(bitboard.shift(board, -dx, 0), framed) for board in (targets, opaque)]) for dx in reach]
        )

        def look(carry: tuple[Array, Array], offset: tuple[Array, ...]) -> tuple[tuple[Array, Array], None]:
            result, through = carry
            dx, dy, depth = offset
            there = jax.lax.dynamic_slice_in_dim(columns[dx + self.radius], dy + self.radius, height, axis=2)
            result = add(result, through[depth - 1] & there[0])
            return (result, through.at[depth].set(through[depth - 1] & ~there[1])), None

        def all_offsets(tree: tuple[Array, ...]) -> Array:
            # Cells from which each offset is seen and seen through; the robot's own cell hides nothing.
            through = jnp.broadcast_to(~jnp.zeros_like(opaque), (self.radius + 1, *opaque.shape))
            return jax.lax.scan(look, (own, through), jax.tree.map(lambda table: table[1:], tree))[0][0]

        seeing = jax.lax.map(all_offsets, jax.tree.map(lambda table: jnp.asarray(table[headings]), (dx, dy, depth)))
        return jnp.broadcast_to(seeing, (HEADINGS, *seeing.shape[1:]))

    def _tree(
        self,
    ) -> tuple[Int[np.ndarray, "heading offsets"], Int[np.ndarray, "heading offsets"], Int[np.ndarray, "offsets"]]:
        """Columns and rows of the offsets in all headings, and their parents' indices.

        They are in depth-first order: the robot's own cell comes first, and each other cell comes after its parent and
        after everything that is seen through the parent's earlier children.
        """
        # Heading 0 looks along x: its offsets are cells ahead and aside. The other headings have them turned.
        in_view = frozenset(self.offsets[0])

        @functools.cache
        def path(offset: tuple[int, int]) -> tuple[tuple[int, int], ...]:
            """The offsets from the robot's own cell to this one."""
            if offset == (0, 0):
                return (offset,)
            return *path(next(filter(in_view.__contains__, _toward_the_robot(*offset)))), offset

        paths = sorted(map(path, in_view))
        number = {path[-1]: index for index, path in enumerate(paths)}
        parents = np.array([number[path[-2:][0]] for path in paths])
        ahead, lateral = np.array([path[-1] for path in paths], np.int32).T
        ex, ey = np.array(FORWARD, np.int32).T[..., None]
        return ahead * ex - lateral * ey, ahead * ey + lateral * ex, parents


def _toward_the_robot(ahead: int, lateral: int) -> list[tuple[int, int]]:
    """Two choices for the parent of an offset other than (0, 0), both one cell nearer along the longer axis.

    Returns:
      The cell nearest to the straight line to the robot; of two, the one nearer to the longer axis. Then, in case that
      one is out of view, the nearest cell on the heading's side of the line.
    """
    is_aside = abs(lateral) > abs(ahead)
    far, short = (lateral, ahead) if is_aside else (ahead, lateral)
    nearer, side, across = abs(far) - 1, 1 if short > 0 else -1, abs(short) * (abs(far) - 1)
    nearest, less, more = (2 * across + nearer) // (2 * abs(far)), across // abs(far), -(-across // abs(far))
    toward = more if (short > 0 if is_aside else far < 0) else less
    steps = [(nearer if far > 0 else -nearer, side * beside) for beside in (nearest, toward)]
    return [(beside, step) if is_aside else (step, beside) for step, beside in steps]


def _window(
    radius: int, degrees: float = PAPER_DEGREES
) -> tuple[Bool[np.ndarray, "lateral ahead"], Int[np.ndarray, "lateral ahead"]]:
    """Which cells around the robot are less than half the angle off the heading, and their squared distances."""
    steps = np.arange(-radius, radius + 1)
    ahead, lateral = steps, steps[:, None]
    off = np.degrees(np.arctan2(np.abs(lateral), ahead))
    return (off < degrees / 2 - 1e-9) | (degrees == ALL_AROUND), ahead**2 + lateral**2


def _turned(cells: Bool[np.ndarray, "lateral ahead"], degrees: float | None = None) -> Kernel:
    """The kernel of these cells around the robot, turned to each of the four headings."""
    radius = len(cells) // 2
    headings = (np.argwhere(np.rot90(cells, -heading))[:, ::-1] - radius for heading in range(HEADINGS))
    return Kernel(radius, tuple(tuple((dx, dy) for dx, dy in offsets.tolist()) for offsets in headings), degrees)


@functools.cache
def field_of_view(radius: int, degrees: float = PAPER_DEGREES) -> Kernel:
    """The field of view with a range of `radius` cells. In the paper it is 90 degrees wide (section IV-B).

    A cell is seen iff its center is within `radius` of the robot's and strictly less than half of `degrees` off the
    heading (for 90: |lateral| < ahead); the robot's own cell always is. With 360 degrees, all cells in range are seen.

    Raises:
      InputError: `radius` is less than 1, or `degrees` is not from 1 to 360.
    """
    check_number("sensing range", radius, whole=True, least=1)
    check_degrees("field of view", degrees)
    wedge, squared = _window(radius, degrees)
    return _turned((wedge & (squared <= radius**2)) | (squared == 0), degrees)


@functools.cache
def line_of_sight(radius: int, degrees: float = PAPER_DEGREES) -> OccludedKernel:
    """The field of view with occlusion: houses, trees and other opaque cells hide what is behind them."""
    return OccludedKernel(radius, field_of_view(radius, degrees).offsets, degrees)


@functools.cache
def expanding_kernel(radius: int) -> Kernel:
    """Offsets from a robot to the frontier cells that the authors' published code assumes it sees past.

    The open wedge of range `radius` eroded by a 3x3 square inside its window, plus the cells 0, 1 and 2 ahead.

    Raises:
      InputError: `radius` is less than 2.
    """
    check_number("expanding range", radius, whole=True, least=2)
    wedge, squared = _window(radius)
    # The border counts as inside the wedge: the authors' erosion ignores cells beyond the window.
    cells = ndimage.binary_erosion(wedge & (squared < radius**2), np.ones((3, 3)), border_value=1)
    cells[radius, radius : radius + 3] = True
    return _turned(cells)


def kernel_runs(kernel: Kernel) -> list[Int[np.ndarray, "bound heading dy"]]:
    """The kernel as horizontal runs: arrays of first and last `dx` for each heading and row, `dy = -radius - 1` first.

    There are as many arrays as the row with the most runs has. Rows with fewer runs, and the rows beyond the kernel,
    have empty runs.
    """
    padded = np.pad(kernel.as_array(), ((0, 0), (1, 1), (1, 1)))
    change = np.diff(padded.astype(np.int8), axis=-1)
    runs: list[np.ndarray] = []
    for heading, row in np.ndindex(padded.shape[:2]):
        starts, ends = (np.flatnonzero(change[heading, row] == sign) for sign in (1, -1))
        for number, bounds in enumerate(zip(starts, ends - 1, strict=True)):
            if number == len(runs):
                empty = np.broadcast_to(np.array([0, -1], np.int32)[:, None, None], (2, *padded.shape[:2]))
                runs.append(empty.copy())
            runs[number][:, heading, row] = np.array(bounds) - kernel.radius
    return runs


def covered(
    pose: Pose,
    radius: int,
    runs: Iterable[Int[Array | np.ndarray, "bound heading dy"]],
    n_words: int,
    height: int,
    width: int | Int[Array, ""],
) -> Board:
    """The in-bounds cells at the offsets of a kernel from a pose.

    Args:
      pose: pose of the robot.
      radius: that of the kernel.
      runs: see `kernel_runs`.
      n_words: words in a row of the board.
      height: rows of the grid.
      width: columns of the grid.
    """
    n_rows = 2 * radius + 3
    row = jax.lax.broadcasted_iota(jnp.int32, (height, *pose.x.shape), 0)
    kernel_row = jnp.clip(row - pose.y + radius + 1, 0, n_rows - 1) + pose.heading * n_rows
    word_start = WORD_BITS * jax.lax.broadcasted_iota(jnp.int32, (n_words, height, *pose.x.shape), 0)
    board = jnp.zeros(word_start.shape, jnp.uint32)
    for bounds in runs:
        first, last = (jnp.asarray(bound.reshape(-1)).at[kernel_row].get(mode="promise_in_bounds") for bound in bounds)
        end = jnp.minimum(pose.x + last + 1, width)
        board |= _bits_below(end - word_start) & ~_bits_below(pose.x + first - word_start)
    return board


def _bits_below(end: Int[Array, "..."]) -> UInt32[Array, "..."]:
    """A word with its lowest `end` bits set: none for negative `end`, all for 32 and more."""
    all_bits = jnp.uint32(0xFFFFFFFF)
    some = ~(all_bits << jnp.clip(end, 0, WORD_BITS - 1).astype(jnp.uint32))
    return jnp.where(end >= WORD_BITS, all_bits, some)
