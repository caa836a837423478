"""Asking a network about maps whose size nobody knows: crop and rescale, or a window around the robot.

The paper's planner asks about the whole map, unobserved cells included, so it has to know the map's size (section IV).
An estimator as it is does that. The two wrappers here need no size. They are for estimators that read nothing but the
map they are asked about, whatever its size.
"""

import dataclasses
from typing import Any

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt8

from dc2g_jax.estimation.estimators import Estimates, Estimator, Extent, answers_in_cells
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.sampling import nearest_pixel
from dc2g_jax.grid.terrain import UNKNOWN
from dc2g_jax.grid.world import World

#: Side of the maps that the shipped network was trained on, in cells.
_TRAINED_SIDE = 50


def _count(number: int, like: Int[Array, "*batch"]) -> Int[Array, "number ..."]:
    """0, 1, 2 ... along a new first axis."""
    return jnp.arange(number, dtype=jnp.int32).reshape(number, *(1 for _ in like.shape))


def _read(
    grid: Shaped[Array, "kept h w *batch"],
    rows: Int[Array, "r *batch"],
    columns: Int[Array, "c *batch"],
    beyond: Shaped[Array, "..."],
) -> Shaped[Array, "kept r c *batch"]:
    """The grid's values in so many rows and columns, and those of `beyond` where it has none."""
    height, width = grid.shape[1:3]
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
    values = jnp.take_along_axis(grid, jnp.clip(rows, 0, height - 1)[None, :, None], axis=1)
    values = jnp.take_along_axis(values, jnp.clip(columns, 0, width - 1)[None, None], axis=2)
    return jnp.where(inside, values, beyond)


def _span(lines: Bool[Array, "n *batch"]) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"]]:
    """The first of the lines that are marked, and how many there are up to the last of them."""
    first, after_last = jnp.argmax(lines, axis=0), len(lines) - jnp.argmax(lines[::-1], axis=0)
    return first.astype(jnp.int32), (after_last - first).astype(jnp.int32)


@struct.dataclass
class CroppedEstimator:
    """Asks about the square that holds everything observed, rescaled to one size (the authors' later code).

    Rescaled costs are multiplied by the scale, so they stay in cells. Cells beyond the square, none of which has been
    observed, cost what the nearest cell within does. In the authors' code they cost the most there is, and the square
    extends from the observed cells to the lower right.

    Attributes:
      estimator: what is asked.
      side: of the square that the estimator is given, in its own cells.
      margin: unobserved cells around the observed ones on each side, at least.
    """

    estimator: Estimator
    side: int = struct.field(pytree_node=False, default=_TRAINED_SIDE)
    margin: int = struct.field(pytree_node=False, default=2)

    @property
    def in_cells(self) -> bool:
        """Are the estimator's own costs?"""
        return answers_in_cells(self.estimator)

    def init(self, world: World) -> Any:
        """The estimator's own state."""
        return self.estimator.init(world)

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """The estimator's answer to the square, resampled by nearest neighbor there and back."""
        height, width = terrain.shape[:2]
        top, left, size = self.square(terrain)
        sample, row, column = (_count(number, size) for number in (self.side, height, width))
        read = nearest_pixel(sample, size, self.side)
        square = _read(terrain[None], top + read, left + read, jnp.uint8(UNKNOWN))[0]
        answer = self.estimator.estimate(square, state)
        rows, columns = (
            nearest_pixel(jnp.clip(cell, 0, size - 1), self.side, size) for cell in (row - top, column - left)
        )
        return (size / self.side) * _read(answer, rows, columns, jnp.float32(0))

    def square(
        self, terrain: UInt8[Array, "h w *batch"]
    ) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"], Int[Array, "*batch"]]:
        """First row, first column and side of the square, in cells. It may reach beyond the map.

        The observed cells lie in its middle, half a cell to the upper left where they cannot. Without any, the square
        is what is given to the estimator, in the map's upper left corner.
        """
        observed = terrain != UNKNOWN
        anything = jnp.any(observed, axis=(0, 1))
        (top, rows), (left, columns) = (_span(jnp.any(observed, axis=1 - axis)) for axis in (0, 1))
        size = jnp.where(anything, jnp.maximum(rows, columns) + 2 * self.margin, self.side)
        top, left = top - (size - rows) // 2, left - (size - columns) // 2
        return jnp.where(anything, top, 0), jnp.where(anything, left, 0), size


@dataclasses.dataclass(frozen=True)
class Window(Extent):
    """A square with the robot in its middle. Beyond it, the estimates made when cells last were inside are kept.

    Whatever a robot can head for it has seen, and what it sees lies inside while the field of view reaches no further
    than half the side. So a cell that has never been inside has a pose to choose on it only where the robot sees
    further than that.

    Attributes:
      side: in cells. Of an even number, the robot is in the first row and column of the second half.
      prior: cost of a cell that has never been inside.
    """

    side: int = _TRAINED_SIDE
    prior: float = float(_TRAINED_SIDE)

    def _first(self, pose: Pose) -> tuple[Int[Array, "*batch"], Int[Array, "*batch"]]:
        """First row and column of the window."""
        return pose.y - self.side // 2, pose.x - self.side // 2

    def part(self, terrain: UInt8[Array, "h w *batch"], pose: Pose) -> UInt8[Array, "side side *batch"]:
        """The window. Beyond the map nothing is observed."""
        (top, left), inside = self._first(pose), _count(self.side, pose.x)
        return _read(terrain[None], top + inside, left + inside, jnp.uint8(UNKNOWN))[0]

    def merged(self, answer: Float[Array, "kept side side *batch"], pose: Pose, before: Estimates) -> Estimates:
        """The answer to the window, and the old estimates around it."""
        (top, left), (height, width) = self._first(pose), before.shape[1:3]
        return _read(answer, _count(height, pose.x) - top, _count(width, pose.x) - left, before)


@struct.dataclass
class WindowedEstimator:
    """Asks about a window around the robot, by a planner that knows where the robot is.

    Attributes:
      estimator: what is asked. Costs in one window have to mean the same as in the next: those of a network that
        answers in cells do, brightness relative to the brightest cell does not.
      extent: the window.
    """

    estimator: Estimator
    extent: Window = struct.field(pytree_node=False, default=Window())

    @property
    def in_cells(self) -> bool:
        """Are the estimator's own costs?"""
        return answers_in_cells(self.estimator)

    def init(self, world: World) -> Any:
        """The estimator's own state."""
        return self.estimator.init(world)

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: Any) -> Float[Array, "outcomes h w *batch"]:
        """The estimator's answer to a map, all of which is taken to be the window."""
        return self.estimator.estimate(terrain, state)
