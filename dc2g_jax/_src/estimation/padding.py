"""The network on a grid larger than the map, so that one compiled program serves maps of many sizes.

The map may be anywhere in the grid. All other cells are `OUTSIDE`. The result is the same as for the map alone:
convolutions see nothing beyond the map's edge, and larger maps than those of the training are resampled.
"""

from collections.abc import Callable
from typing import ClassVar, cast

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax._src.estimation.compact_unet import CompactUNet
from dc2g_jax._src.estimation.estimators import Ensemble, Estimator, NetworkCostToGo, trait, zero_without_classes
from dc2g_jax._src.estimation.weights import with_weights
from dc2g_jax._src.grid.sampling import nearest_pixel
from dc2g_jax._src.grid.terrain import OUTSIDE


@struct.dataclass
class PaddedNetwork(Estimator):
    """A trained network for maps of one size in a larger grid.

    Attributes:
      network: the network.
    """

    network: NetworkCostToGo
    knows_outside: ClassVar[bool] = True
    needs_classes: ClassVar[bool] = True

    def summarized(self, summary: Callable[[Array], Array]) -> "PaddedNetwork":
        """See `NetworkCostToGo.summarized`."""
        return PaddedNetwork(self.network.summarized(summary))

    def estimate(self, terrain: UInt8[Array, "h w *batch"], state: tuple[()]) -> Float[Array, "outcomes h w *batch"]:
        """The network's estimate for the maps in a grid, in cells; undefined for `OUTSIDE` cells."""
        del state
        grids, architecture = jnp.moveaxis(terrain.reshape(*terrain.shape[:2], -1), -1, 0), self.network.architecture
        shrunk, map_shape, (rows, columns), cell_side = _shrunk(grids, architecture.side)
        network = with_weights(CompactUNet, architecture, self.network.weights)
        answer = cell_side * network(shrunk, map_shape)[:, rows, columns]
        return zero_without_classes(terrain, jnp.moveaxis(answer, (-1, 0), (0, -1)).reshape(-1, *terrain.shape))


def padded(estimator: Estimator) -> Estimator:
    """The estimator for maps in a larger grid, if it is a network or a mean of networks that has one; else itself."""
    if isinstance(estimator, Ensemble):
        return Ensemble(tuple(map(padded, estimator.members)))
    return PaddedNetwork(cast(NetworkCostToGo, estimator)) if trait(estimator, "is_compact") else estimator


def _shrunk(
    grids: UInt8[Array, "b h w"], side: int
) -> tuple[
    UInt8[Array, "b h2 w2"], tuple[Int[Array, ""], Int[Array, ""]], tuple[Int[Array, "h 1"], Int[Array, "w"]], Array
]:
    """Maps of one place and size in a grid, resampled if their longer side has more than `side` cells.

    Returns:
      The new grids, with the maps in their upper left corners; the maps' new size; row and column there of each cell of
      the old grid; and the side length of a new cell, in old cells.
    """
    rows_and_columns = [jnp.any(grids[0] != OUTSIDE, axis=axis) for axis in (1, 0)]
    sizes = [jnp.sum(inside, dtype=jnp.int32) for inside in rows_and_columns]
    longest = jnp.maximum(jnp.maximum(*sizes), side)
    new_sizes = (-(-sizes[0] * side // longest), -(-sizes[1] * side // longest))
    read, there, back = [], [], []
    for inside, size, new_size in zip(rows_and_columns, sizes, new_sizes, strict=True):
        new, first = jnp.arange(min(len(inside), side)), jnp.argmax(inside)
        read.append(first + nearest_pixel(new, size, new_size))
        there.append(new < new_size)
        back.append(jnp.clip(nearest_pixel(jnp.arange(len(inside)) - first, new_size, size), 0, new_size - 1))
    shrunk = jnp.where(there[0][:, None] & there[1], grids[:, read[0][:, None], read[1]], jnp.uint8(OUTSIDE))
    return shrunk, new_sizes, (back[0][:, None], back[1]), longest / side
