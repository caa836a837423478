"""The network on a grid of which the map fills only a part, so that one compiled program serves maps of many sizes.

The map lies in the grid's upper left corner; all other cells are `OUTSIDE`, which the network reads as no class. The
answer is the network's to the map alone: its convolutions see nothing beyond the map's edge, wherever the grid ends.
"""

import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
from flax import nnx, struct
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.estimation.estimators import NetworkCostToGo
from dc2g_jax.estimation.networks import compact_unet
from dc2g_jax.grid.terrain import OUTSIDE
from dc2g_jax.grid.world import World


def _convolved(
    map_shape: tuple[Int[Array, ""], Int[Array, ""]],
    grid_shape: tuple[int, ...],
    features: Float[Array, "1 h w c"],
    kernel: Float[Array, "3 3 c d"],
    strides: tuple[int, int],
    padding: str,
    **options: Any,
) -> Float[Array, "1 h2 w2 d"]:
    """`jax.lax.conv_general_dilated` with padding `SAME`, of the map's part of the features.

    How many halvings made the features of the grid is seen from their shape; the map was halved as often.
    """
    del padding
    stride, shape = strides[0], features.shape[1:3]
    halvings = next(number for number in itertools.count() if tuple(-(-size >> number) for size in grid_shape) == shape)
    inside, first, sizes = jnp.ones(shape, bool), [], []
    for axis, size in enumerate(shape):
        map_size = -(-map_shape[axis] >> halvings)
        inside &= jax.lax.broadcasted_iota(jnp.int32, shape, axis) < map_size
        # A frame of one cell before the first, but for an even number of cells under stride 2: then of none.
        first.append(((map_size - 1) % stride != 0).astype(jnp.int32))
        sizes.append(stride * (-(-size // stride) - 1) + 3)
    features = jnp.where(inside[None, :, :, None], features, 0)
    framed = jnp.pad(features, ((0, 0), (1, stride), (1, stride), (0, 0)))
    framed = jax.lax.dynamic_slice(framed, (0, *first, 0), (1, *sizes, features.shape[3]))
    return jax.lax.conv_general_dilated(framed, kernel, strides, "VALID", **options)


@struct.dataclass
class PaddedNetwork:
    """A trained network that is asked about maps in a larger grid, one at a time.

    Attributes:
      network: the network.
    """

    network: NetworkCostToGo

    def init(self, world: World) -> tuple[()]:
        """Nothing is kept between steps."""
        return self.network.init(world)

    def estimate(self, terrain: UInt8[Array, "h w"], state: tuple[()]) -> Float[Array, "outcomes h w"]:
        """The network's answer to the map in a grid, in cells; without meaning where the grid is `OUTSIDE`."""
        del state
        inside = terrain != OUTSIDE
        rows, columns = (jnp.sum(jnp.any(inside, axis=axis), dtype=jnp.int32) for axis in (1, 0))
        network = compact_unet.build(self.network.architecture, self.network.weights)
        for _, module in nnx.iter_modules(network):
            if isinstance(module, nnx.Conv):
                module.conv_general_dilated = functools.partial(_convolved, (rows, columns), terrain.shape)
        return jnp.moveaxis(network(terrain[None])[0], -1, 0)
