"""A world: the terrain of one house and the cell sets derived from it. Batch axes come last, see `bitboard`."""

import functools

import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, UInt8, UInt32

from dc2g_jax._src.grid import bitboard, terrain
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.runtime.programs import jit


@struct.dataclass
class World:
    """A static world.

    Attributes:
      classes: bit planes of the class indices: plane `b` holds the cells whose index has bit `b`.
      traversable: board of the cells a robot may drive on.
      goals: board of the goal cells.
      width: columns of the map.
    """

    classes: UInt32[Array, "bit n_words h *batch"]
    traversable: UInt32[Array, "n_words h *batch"]
    goals: UInt32[Array, "n_words h *batch"]
    width: int = struct.field(pytree_node=False)

    @staticmethod
    @jit
    def from_terrain(classes: UInt8[Array, "h w *batch"] | UInt8[np.ndarray, "h w *batch"]) -> "World":
        """The world of a grid of class indices; every front door cell is a goal.

        Args:
          classes: class index of every cell; trailing axes make a batch of worlds.
        """
        classes = jnp.asarray(classes, jnp.uint8)
        return World(
            classes=jnp.stack([bitboard.pack(((classes >> bit) & 1) == 1) for bit in range(terrain.CLASS_BITS)]),
            traversable=bitboard.pack(jnp.asarray(terrain.TRAVERSABLE)[classes]),
            goals=bitboard.pack(classes == terrain.FRONT_DOOR),
            width=classes.shape[1],
        )

    @property
    def height(self) -> int:
        """Rows of the map."""
        return self.goals.shape[1]

    @property
    def terrain(self) -> UInt8[Array, "h w *batch"]:
        """Class index of every cell, see `grid.terrain`."""
        indices = jnp.uint8(0)
        for bit, plane in enumerate(self.classes):
            indices |= bitboard.unpack(plane, self.width).astype(jnp.uint8) << jnp.uint8(bit)
        return jnp.asarray(indices)

    @property
    def opaque(self) -> Board:
        """Board of the cells whose class hides what is behind them."""
        found = jnp.zeros_like(self.classes[0])
        for index in np.flatnonzero(terrain.OPAQUE).tolist():
            found = found | self.of_class(index)
        return found

    def of_class(self, index: int) -> Board:
        """Board of the cells of a class; for class 0, of the padding too."""
        planes = [plane if index >> bit & 1 else ~plane for bit, plane in enumerate(self.classes)]
        return functools.reduce(jnp.bitwise_and, planes)
