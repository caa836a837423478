"""Shifting of grids by whole cells."""

import jax.numpy as jnp
from jaxtyping import Array


def shifted(values: Array, dx: int, dy: int, fill: float) -> Array:
    """Values `[h w *batch]` shifted by `dx` columns and `dy` rows; `fill` in cells without a source."""
    height, width = values.shape[:2]
    margins = [(abs(dy), abs(dy)), (abs(dx), abs(dx))] + [(0, 0)] * (values.ndim - 2)
    padded = jnp.pad(values, margins, constant_values=fill)
    return padded[abs(dy) - dy : abs(dy) - dy + height, abs(dx) - dx : abs(dx) - dx + width]
