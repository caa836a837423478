"""Estimators for maps of unknown size: crop and rescale, or a window around the robot.

The paper's planner gives the network the whole map, including unobserved cells, so it has to know the map's size
(section IV). The two wrappers here do not need the size. They are for estimators that only read the map they are given,
of any size.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import Estimates, Estimator, Extent, answers_in_cells
from dc2g_jax._src.estimation.extents import counted, read_cells
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sampling import nearest_pixel
from dc2g_jax._src.grid.terrain import UNKNOWN
from dc2g_jax._src.grid.world import World

#: Side length of the training maps of the shipped network, in cells.
_TRAINED_SIDE = Architecture.side


def _span(lines: Bool[Array, "n *batch"]) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"]]:
    """The first marked line, and the number of lines up to the last marked one."""
    first, after_last = jnp.argmax(lines, axis=0), len(lines) - jnp.argmax(lines[::-1], axis=0)
    return first.astype(jnp.int32), (after_last - first).astype(jnp.int32)


class _Wrapping(Estimator):
    """What estimators that wrap another one have of it."""

    estimator: Estimator

    @property
    def in_cells(self) -> bool:  # type: ignore[override]
        """Whether the estimator's costs are in cells."""
        return answers_in_cells(self.estimator)

    def init(self, world: World) -> Any:
        """The state of the wrapped estimator."""
        return self.estimator.init(world)


@struct.dataclass
class CroppedEstimator(_Wrapping):
    """Estimate on the square around all observed cells, rescaled to a fixed size (the authors' later code).

    Costs are multiplied by the scale, so they stay in cells. Cells beyond the square, all unobserved, get the cost of
    the nearest cell in it. In the authors' code, they get the highest cost, and the square extends from the observed
    cells to the lower right.

    Attributes:
      estimator: the wrapped estimator.
      side: side length of the rescaled square, in its own cells.
      margin: minimum number of unobserved cells on each side of the observed ones.
    """

    estimator: Estimator
    side: int = struct.field(pytree_node=False, default=_TRAINED_SIDE)
    margin: int = struct.field(pytree_node=False, default=2)

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """The estimate for the square, with nearest-neighbor resampling in both directions."""
        height, width = terrain.shape[:2]
        top, left, size = self.square(terrain)
        sample, row, column = (counted(number, size) for number in (self.side, height, width))
        read = nearest_pixel(sample, size, self.side)
        square = read_cells(terrain[None], top + read, left + read, jnp.uint8(UNKNOWN))[0]
        answer = self.estimator.estimate(square, state)
        rows, columns = (
            nearest_pixel(jnp.clip(cell, 0, size - 1), self.side, size) for cell in (row - top, column - left)
        )
        return (size / self.side) * read_cells(answer, rows, columns, jnp.float32(0))

    def square(
        self, terrain: UInt8[Array, "h w *batch"]
    ) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"], Int[Array, "*batch"]]:
        """First row, first column and side length of the square, in cells. It may extend beyond the map.

        The observed cells are in its middle, or half a cell to the upper left. Without observed cells, the square has
        side length `side` and is in the map's upper left corner.
        """
        observed = terrain != UNKNOWN
        anything = jnp.any(observed, axis=(0, 1))
        (top, rows), (left, columns) = (_span(jnp.any(observed, axis=1 - axis)) for axis in (0, 1))
        size = jnp.where(anything, jnp.maximum(rows, columns) + 2 * self.margin, self.side)
        top, left = top - (size - rows) // 2, left - (size - columns) // 2
        return jnp.where(anything, top, 0), jnp.where(anything, left, 0), size


@dataclasses.dataclass(frozen=True)
class Window(Extent):
    """A square with the robot in its middle. Cells outside keep the estimates from when they were last inside.

    A robot can only head for cells that it has seen. These were inside if its sensing range is at most half the side
    length. So only with a longer sensing range can a subgoal be on a cell that has never been inside.

    Attributes:
      side: side length in cells. If it is even, the robot is in the first row and column of the second half.
      prior: cost of cells that have never been inside.
    """

    side: int = _TRAINED_SIDE
    prior: float = float(_TRAINED_SIDE)

    def _first(self, pose: Pose) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"]]:
        """First row and column of the window."""
        return pose.y - self.side // 2, pose.x - self.side // 2

    def part(self, terrain: UInt8[Array, "h w *batch"], pose: Pose) -> UInt8[Array, "side side *batch"]:
        """The window. Cells beyond the map are unobserved."""
        (top, left), inside = self._first(pose), counted(self.side, pose.x)
        return read_cells(terrain[None], top + inside, left + inside, jnp.uint8(UNKNOWN))[0]

    def merged(self, answer: Float[Array, "kept side side *batch"], pose: Pose, before: Estimates) -> Estimates:
        """The new estimates in the window and the old ones around it."""
        (top, left), (height, width) = self._first(pose), before.shape[1:3]
        return read_cells(answer, counted(height, pose.x) - top, counted(width, pose.x) - left, before)


@struct.dataclass
class WindowedEstimator(_Wrapping):
    """Estimate on a window around the robot. The planner provides the robot's pose.

    Attributes:
      estimator: the wrapped estimator. Its costs must be comparable between windows, such as costs in cells; brightness
        relative to the brightest cell is not.
      extent: the window.
    """

    estimator: Estimator
    extent: Window = struct.field(pytree_node=False, default=Window())

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """The estimate for a map that is the window itself."""
        return self.estimator.estimate(terrain, state)
