"""Values at single cells, sums and counts of cells in rectangles, and shifted grids."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


def at_cells(values: Array, x: Int[Array, "point *batch"], y: Int[Array, "point *batch"]) -> Array:
    """Values `[... h w *batch]` at cells: `[... point *batch]`."""
    lead = values.ndim - x.ndim - 1
    width = values.shape[lead + 1]
    flat = values.reshape(*values.shape[:lead], -1, *values.shape[lead + 2 :])
    return jnp.take_along_axis(flat, (y * width + x).reshape(*(1,) * lead, *x.shape), axis=lead)


def running_sums(rows: Array) -> Array:
    """The sum of each row and all rows above. On a CPU, this is faster than `jnp.cumsum`."""
    return jax.lax.scan(lambda above, row: (above + row,) * 2, jnp.zeros_like(rows[0]), rows)[1]


def corner_sums(cells: Bool[Array, "..."], lead: int = 0) -> Int[Array, "..."]:
    """Summed-area table: number of cells of a set above and left of each grid corner, for `in_rectangle`.

    Args:
      cells: the set `[h w *batch]`, or several along axes before.
      lead: number of axes before the rows.
    """

    def along(axis: int, counts: Array) -> Array:
        return jnp.moveaxis(running_sums(jnp.moveaxis(counts, axis, 0)), 0, axis)

    sums = along(lead + 1, along(lead, cells.astype(jnp.int32)))
    return jnp.pad(sums, [(int(axis in (lead, lead + 1)), 0) for axis in range(cells.ndim)])


def in_rectangle(
    sums: Int[Array, "..."],
    left: Int[Array, "point *batch"],
    top: Int[Array, "point *batch"],
    right: Int[Array, "point *batch"],
    bottom: Int[Array, "point *batch"],
) -> Int[Array, "..."]:
    """Number of cells of a set in columns `left` to `right - 1` and rows `top` to `bottom - 1`, clipped to the map.

    Args:
      sums: the set's `corner_sums`.
      left: first column.
      top: first row.
      right: column after the last.
      bottom: row after the last.
    """
    lead = sums.ndim - left.ndim - 1
    height, width = (size - 1 for size in sums.shape[lead : lead + 2])
    left, right = jnp.clip(left, 0, width), jnp.clip(right, 0, width)
    top, bottom = jnp.clip(top, 0, height), jnp.clip(bottom, 0, height)
    below, above = (at_cells(sums, right, row) - at_cells(sums, left, row) for row in (bottom, top))
    return below - above


def shifted(values: Array, dx: int, dy: int, fill: float) -> Array:
    """Values `[h w *batch]` shifted by `dx` columns and `dy` rows; `fill` in cells without a source."""
    height, width = values.shape[:2]
    margins = [(abs(dy), abs(dy)), (abs(dx), abs(dx))] + [(0, 0)] * (values.ndim - 2)
    padded = jnp.pad(values, margins, constant_values=fill)
    return padded[abs(dy) - dy : abs(dy) - dy + height, abs(dx) - dx : abs(dx) - dx + width]
