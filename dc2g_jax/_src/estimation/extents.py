"""The part of a town that an estimator is given, and reading of parts of maps."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt8

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import Estimates, Extent
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sampling import nearest_pixel
from dc2g_jax._src.grid.terrain import UNKNOWN


def counted(number: int, like: Int[Array, "*batch"]) -> Int[Array, "number ..."]:
    """0, 1, 2, ... along a new first axis."""
    return jnp.arange(number, dtype=jnp.int32).reshape(number, *(1 for _ in like.shape))


def read_cells(
    grid: Shaped[Array, "kept h w *batch"],
    rows: Int[Array, "r *batch"],
    columns: Int[Array, "c *batch"],
    beyond: Shaped[Array, "..."],
) -> Shaped[Array, "kept r c *batch"]:
    """The grid's values at these rows and columns; values of `beyond` outside the grid."""
    height, width = grid.shape[1:3]
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
    values = jnp.take_along_axis(grid, jnp.clip(rows, 0, height - 1)[None, :, None], axis=1)
    values = jnp.take_along_axis(values, jnp.clip(columns, 0, width - 1)[None, None], axis=2)
    return jnp.where(inside, values, beyond)


@dataclasses.dataclass(frozen=True)
class TownWindow(Extent):
    """In towns, a window that is moved into the map; elsewhere the whole map.

    The network knows one house with its surroundings. It resamples larger maps to the size of its training maps, which
    is right for a house in smaller cells, but in a town it would see nothing of the walks. So the window is magnified
    to the size of the map beforehand.

    Attributes:
      zooms: whether each robot is in a town.
      side: longer side of the window, which has the aspect ratio of the map, in cells; also the cost of cells that have
        never been inside.
    """

    zooms: Bool[Array, "*batch"]
    side: int = Architecture.side

    @property
    def prior(self) -> float:  # type: ignore[override]
        """See `Extent`."""
        return float(self.side)

    def _window(self, pose: Pose, shape: tuple[int, ...]) -> list[tuple[Int[Array, "*batch"], int, int]]:
        """First cell, length and length of the map along each axis."""
        sizes = [-(-size * self.side // max(shape)) for size in shape]
        return [
            (jnp.clip(at - size // 2, 0, length - size), size, length)
            for at, size, length in zip((pose.y, pose.x), sizes, shape, strict=True)
        ]

    def part(self, terrain: UInt8[Array, "h w *batch"], pose: Pose) -> UInt8[Array, "h w *batch"]:
        """The whole map, or the window in its size."""

        def read(first: Int[Array, "*batch"], size: int, length: int) -> Int[Array, "length *batch"]:
            cell = counted(length, pose.x)
            return jnp.where(self.zooms, first + nearest_pixel(cell, size, length), cell)

        rows, columns = (read(*axis) for axis in self._window(pose, terrain.shape[:2]))
        return read_cells(terrain[None], rows, columns, jnp.uint8(UNKNOWN))[0]

    def merged(self, answer: Float[Array, "kept h w *batch"], pose: Pose, before: Estimates) -> Estimates:
        """The new estimates, and the old ones around the window."""

        def read(first: Int[Array, "*batch"], size: int, length: int) -> Int[Array, "length *batch"]:
            cell = counted(length, pose.x)
            inside = (cell >= first) & (cell < first + size)
            within = jnp.where(inside, nearest_pixel(cell - first, length, size), -1)
            return jnp.where(self.zooms, within, cell)

        rows, columns = (read(*axis) for axis in self._window(pose, before.shape[1:3]))
        scale = jnp.where(self.zooms, self.side / max(before.shape[1:3]), 1.0)
        return read_cells(scale * answer, rows, columns, before)
