"""The network on a grid larger than the map, so that one compiled program serves maps of many sizes.

The map is in the grid's upper left corner. All other cells are `OUTSIDE`. The result is the same as for the map alone:
convolutions see nothing beyond the map's edge, and larger maps than those of the training are resampled.
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import nnx, struct
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt8

from dc2g_jax.estimation.compact_unet import CompactUNet
from dc2g_jax.estimation.estimators import Estimator, NetworkCostToGo, zero_without_classes
from dc2g_jax.estimation.weights import with_weights
from dc2g_jax.grid.sampling import nearest_pixel
from dc2g_jax.grid.terrain import OUTSIDE


def _convolved(
    map_shape: tuple[Int[Array, ""], ...],
    grid_shape: tuple[int, ...],
    features: Float[Array, "1 h w c"],
    kernel: Float[Array, "3 3 c d"],
    strides: tuple[int, int],
    padding: str,
    **options: Any,
) -> Float[Array, "1 h2 w2 d"]:
    """`jax.lax.conv_general_dilated` with padding `SAME`, applied to the map's part of the features.

    Both shapes are in patches. The features' shape tells how often the grid was halved; the map was halved as often.
    """
    del padding
    stride, shape = strides[0], features.shape[1:3]
    halvings = next(number for number in itertools.count() if tuple(-(-size >> number) for size in grid_shape) == shape)
    inside, first, sizes = jnp.ones(shape, bool), [], []
    for axis, size in enumerate(shape):
        map_size = -(-map_shape[axis] >> halvings)
        inside &= jax.lax.broadcasted_iota(jnp.int32, shape, axis) < map_size
        # Padding of one cell before the first; none for an even number of cells with stride 2.
        first.append(((map_size - 1) % stride != 0).astype(jnp.int32))
        sizes.append(stride * (-(-size // stride) - 1) + 3)
    features = jnp.where(inside[None, :, :, None], features, 0)
    framed = jnp.pad(features, ((0, 0), (1, stride), (1, stride), (0, 0)))
    framed = jax.lax.dynamic_slice(framed, (0, *first, 0), (1, *sizes, features.shape[3]))
    return jax.lax.conv_general_dilated(framed, kernel, strides, "VALID", **options)


@struct.dataclass
class PaddedNetwork(Estimator):
    """A trained network for maps in a larger grid, one at a time.

    Attributes:
      network: the network.
    """

    network: NetworkCostToGo
    knows_outside: ClassVar[bool] = True

    def summarized(self, summary: Callable[[Array], Array]) -> "PaddedNetwork":
        """See `NetworkCostToGo.summarized`."""
        return PaddedNetwork(self.network.summarized(summary))

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "outcomes h w *batch"]:
        """The network's estimate for the map in a grid, in cells; undefined for `OUTSIDE` cells.

        A batch holds one map.
        """
        del state
        (grid,) = jnp.moveaxis(terrain.reshape(*terrain.shape[:2], -1), -1, 0)
        architecture = self.network.architecture
        shrunk, map_shape, cells, cell_side = _shrunk(grid, architecture.side)
        network = with_weights(CompactUNet, architecture, self.network.weights)
        map_patches = tuple(-(-size // architecture.patch) for size in map_shape)
        grid_patches = tuple(-(-size // architecture.patch) for size in shrunk.shape)
        for _, module in nnx.iter_modules(network):
            if isinstance(module, nnx.Conv):
                module.conv_general_dilated = functools.partial(_convolved, map_patches, grid_patches)
        answer = cell_side * network(shrunk[None])[0][cells]
        return zero_without_classes(terrain, jnp.moveaxis(answer, -1, 0).reshape(-1, *terrain.shape))


def _shrunk(
    grid: UInt8[Array, "h w"], side: int
) -> tuple[
    UInt8[Array, "h2 w2"], tuple[Int[Array, ""], Int[Array, ""]], tuple[Int[Array, "h 1"], Int[Array, "w"]], Array
]:
    """The map in a grid, resampled if its longer side has more than `side` cells.

    Returns:
      The new grid, with the map in its upper left corner; the map's new size; row and column there of each cell of the
      old grid; and the side length of a new cell, in old cells.
    """
    inside = grid != OUTSIDE
    sizes = [jnp.sum(jnp.any(inside, axis=axis), dtype=jnp.int32) for axis in (1, 0)]
    longest = jnp.maximum(jnp.maximum(*sizes), side)
    new_sizes = (-(-sizes[0] * side // longest), -(-sizes[1] * side // longest))
    read, there, back = [], [], []
    for size, new_size, grid_size in zip(sizes, new_sizes, grid.shape, strict=True):
        new = jnp.arange(min(grid_size, side))
        read.append(nearest_pixel(new, size, new_size))
        there.append(new < new_size)
        back.append(jnp.clip(nearest_pixel(jnp.arange(grid_size), new_size, size), 0, new_size - 1))
    shrunk = jnp.where(there[0][:, None] & there[1], grid[read[0][:, None], read[1]], jnp.uint8(OUTSIDE))
    return shrunk, new_sizes, (back[0][:, None], back[1]), longest / side


def mirrored(
    cells: Shaped[Array, "..."], axes: tuple[int, ...], inside: Bool[Array, "h w *batch"], first: int
) -> Shaped[Array, "..."]:
    """Mirror the map in a grid along axes, without moving it out of its corner.

    Args:
      cells: cells of the grid; rows are axis `first`.
      axes: axes of the grid, 0 for rows and 1 for columns.
      inside: cells of the map.
      first: number of axes before the rows.
    """
    for axis in axes:
        size = jnp.sum(jnp.any(inside, axis=[other for other in range(inside.ndim) if other != axis]), dtype=jnp.int32)
        cells = jnp.roll(jnp.flip(cells, first + axis), size - inside.shape[axis], first + axis)
    return cells
