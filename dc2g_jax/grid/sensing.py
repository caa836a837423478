"""What a robot sees from a pose: constant kernels of offsets, one for each heading, placed on the map.

The field of view has no occlusion, so it is four constant sets of offsets moved to the robot's cell.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, UInt32

from dc2g_jax.grid import bitboard
from dc2g_jax.grid.bitboard import WORD_BITS, Board
from dc2g_jax.grid.poses import FORWARD, HEADINGS, Pose, PoseSet


@dataclasses.dataclass(frozen=True)
class Kernel:
    """A set of offsets from the robot's cell for each heading. Hashable, so a static value under `jit`.

    Attributes:
      radius: largest absolute offset along x or y that can occur, in cells.
      offsets: for each of the four headings, the offsets `(dx, dy)`.
    """

    radius: int
    offsets: tuple[tuple[tuple[int, int], ...], ...]

    def as_array(self) -> Bool[np.ndarray, "heading dy dx"]:
        """The kernel as a boolean array with the robot's cell at index `(radius, radius)`."""
        size = 2 * self.radius + 1
        array = np.zeros((HEADINGS, size, size), dtype=bool)
        for heading, offsets in enumerate(self.offsets):
            for dx, dy in offsets:
                array[heading, dy + self.radius, dx + self.radius] = True
        return array

    @classmethod
    def from_array(cls, array: Bool[np.ndarray, "heading dy dx"]) -> "Kernel":
        """The inverse of `as_array`."""
        radius = array.shape[1] // 2
        offsets = tuple(
            tuple((int(column) - radius, int(row) - radius) for row, column in np.argwhere(array[heading]))
            for heading in range(HEADINGS)
        )
        return cls(radius=radius, offsets=offsets)


def _turned(ahead_and_lateral: list[tuple[int, int]], radius: int) -> Kernel:
    """The kernel whose offsets for heading 0 are the given `(ahead, lateral)`, turned to all four headings."""
    array = np.zeros((HEADINGS, 2 * radius + 1, 2 * radius + 1), dtype=bool)
    for heading, (ex, ey) in enumerate(FORWARD):
        for ahead, lateral in ahead_and_lateral:
            dx, dy = ahead * ex - lateral * ey, ahead * ey + lateral * ex
            array[heading, dy + radius, dx + radius] = True
    return Kernel.from_array(array)


@functools.cache
def field_of_view(radius: int) -> Kernel:
    """The 90-degree field of view of range `radius` cells (paper, section IV-B).

    A cell is seen iff its centre is within `radius` of the robot's and strictly less than 45 degrees off the
    heading, that is |lateral| < ahead; the robot's own cell always is.

    Raises:
      ValueError: if `radius` is less than 1.
    """
    if radius < 1:
        raise ValueError(f"sensing range {radius} is less than one cell; give a whole number of at least 1")
    wedge = [
        (ahead, lateral)
        for ahead in range(1, radius + 1)
        for lateral in range(1 - ahead, ahead)
        if ahead**2 + lateral**2 <= radius**2
    ]
    return _turned([(0, 0), *wedge], radius)


@functools.cache
def expanding_kernel(radius: int) -> Kernel:
    """Offsets from a robot to the frontier cells it is taken to see past, in the authors' published code.

    The open wedge of range `radius` eroded by a 3x3 square inside its window, plus the cells 0, 1 and 2 ahead.

    Raises:
      ValueError: if `radius` is less than 2.
    """
    if radius < 2:
        raise ValueError(f"expanding range {radius} is less than two cells; give a whole number of at least 2")
    size = 2 * radius + 1
    wedge = np.zeros((size, size), dtype=bool)  # [lateral, ahead]
    for ahead in range(1, radius + 1):
        for lateral in range(1 - ahead, ahead):
            wedge[lateral + radius, ahead + radius] = ahead**2 + lateral**2 < radius**2
    # Outside the window counts as inside the wedge: the authors' erosion ignores cells beyond the border.
    padded = np.pad(wedge, 1, constant_values=True)
    eroded = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).all(axis=(2, 3))
    kept = [(int(ahead) - radius, int(lateral) - radius) for lateral, ahead in np.argwhere(eroded)]
    return _turned([*kept, (0, 0), (1, 0), (2, 0)], radius)


def _kernel_runs(kernel: Kernel) -> list[Int[np.ndarray, "bound heading dy"]]:
    """The kernel as horizontal runs: arrays of first and last `dx` for each heading and row, `dy = -radius - 1` first.

    As many arrays as the fullest row has runs; a row with fewer has empty ones, as have the rows beyond the kernel.
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


def _bits_below(end: Int[Array, "..."]) -> UInt32[Array, "..."]:
    """A word's lowest `end` bits: none for negative numbers, all for 32 and more."""
    all_bits = jnp.uint32(0xFFFFFFFF)
    some = ~(all_bits << jnp.clip(end, 0, WORD_BITS - 1).astype(jnp.uint32))
    return jnp.where(end >= WORD_BITS, all_bits, some)


def visible(kernel: Kernel, pose: Pose, height: int, width: int) -> Board:
    """The in-bounds cells that the kernel covers from a pose.

    Returns:
      Board of an `height x width` grid.
    """
    n_words, n_rows = bitboard.word_count(width), 2 * kernel.radius + 3
    row = jax.lax.broadcasted_iota(jnp.int32, (height, *pose.x.shape), 0)
    kernel_row = jnp.clip(row - pose.y + kernel.radius + 1, 0, n_rows - 1) + pose.heading * n_rows
    word_start = WORD_BITS * jax.lax.broadcasted_iota(jnp.int32, (n_words, height, *pose.x.shape), 0)
    covered = jnp.zeros(word_start.shape, jnp.uint32)
    for bounds in _kernel_runs(kernel):
        first, last = (jnp.asarray(bound.reshape(-1)).at[kernel_row].get(mode="promise_in_bounds") for bound in bounds)
        end = jnp.minimum(pose.x + last + 1, width)
        covered |= _bits_below(end - word_start) & ~_bits_below(pose.x + first - word_start)
    return covered


def poses_that_see(targets: Board, kernel: Kernel) -> PoseSet:
    """Poses from which the kernel covers at least one target cell."""
    return jnp.stack([bitboard.cells_that_see(targets, offsets) for offsets in kernel.offsets])
