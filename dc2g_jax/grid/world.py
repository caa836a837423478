"""One house: its terrain and the cell sets derived from it."""

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, UInt8, UInt32

from dc2g_jax.grid import bitboard, terrain


@struct.dataclass
class World:
    """A static world.

    Attributes:
      terrain: class index of every cell, see `dc2g_jax.grid.terrain`.
      traversable: board of the cells a robot may drive on.
      goals: board of the goal cells.
    """

    terrain: UInt8[Array, "*batch h w"]
    traversable: UInt32[Array, "*batch h n_words"]
    goals: UInt32[Array, "*batch h n_words"]


def world_from_terrain(classes: UInt8[Array, "*batch h w"] | UInt8[np.ndarray, "*batch h w"]) -> World:
    """The world of a grid of class indices; every front door cell is a goal.

    Args:
      classes: class index of every cell; leading axes make a batch of worlds.
    """
    classes = jnp.asarray(classes, jnp.uint8)
    return World(
        terrain=classes,
        traversable=bitboard.pack(jnp.asarray(terrain.TRAVERSABLE)[classes]),
        goals=bitboard.pack(classes == terrain.FRONT_DOOR),
    )
