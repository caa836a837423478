"""Collision checks of a circular footprint, with exact distances to whole cells instead of their centers."""

import itertools
import math

import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int


@struct.dataclass
class Ground:
    """The ground on which a footprint is allowed. Space beyond the map's edges is not allowed.

    Attributes:
      cells: whether the footprint is allowed on a cell. Unknown cells are not allowed.
      cell_size: side of a cell, meters.
    """

    cells: Bool[Array, "h w"]
    cell_size: float = struct.field(pytree_node=False)


@struct.dataclass
class BlockedCells:
    """The blocked cells around a place.

    Attributes:
      blocked: whether a cell is blocked, by column and row around the place.
      x: centers of these columns, meters.
      y: centers of these rows, meters.
      half: half the side of a cell, meters.
    """

    blocked: Bool[Array, "n n"]
    x: Float[Array, "n"]
    y: Float[Array, "n"]
    half: float = struct.field(pytree_node=False)


def cell_at(position: Float[Array, "*n 2"], cell_size: float) -> Int[Array, "*n 2"]:
    """Column and row of the cells that contain positions (x and y, meters)."""
    return jnp.floor(position * jnp.array([1, -1], jnp.float32) / cell_size).astype(jnp.int32)


def cell_centers(cells: Int[Array, "*n 2"], cell_size: float) -> Float[Array, "*n 2"]:
    """Centers of cells, given by column and row, in the world, meters."""
    return (cells.astype(jnp.float32) + 0.5) * jnp.array([cell_size, -cell_size], jnp.float32)


def contains(ground: Ground, cells: Int[Array, "*n 2"]) -> Bool[Array, "*n"]:
    """Whether the footprint is allowed on these cells (column and row)."""
    there = ground.cells.at[cells[..., 1], cells[..., 0]]
    return there.get(mode="fill", fill_value=False, wrap_negative_indices=False)


def blocked_around(ground: Ground, position: Float[Array, "2"], reach: float) -> BlockedCells:
    """The blocked cells within at least `reach` meters of a place."""
    rings = math.ceil(reach / ground.cell_size)
    offsets = jnp.arange(-rings, rings + 1)
    middle = cell_at(position, ground.cell_size)
    cells = jnp.stack(jnp.meshgrid(middle[0] + offsets, middle[1] + offsets, indexing="ij"), axis=-1)
    centers = cell_centers(cells, ground.cell_size)
    return BlockedCells(
        blocked=~contains(ground, cells), x=centers[:, 0, 0], y=centers[0, :, 1], half=ground.cell_size / 2
    )


def clearance(points: Float[Array, "*n 2"], around: BlockedCells) -> Float[Array, "*n"]:
    """Distance of each point to the nearest blocked cell, meters: 0 inside one, infinite where there is none."""
    off_x = [jnp.maximum(jnp.abs(points[..., 0] - x) - around.half, 0) ** 2 for x in around.x]
    off_y = [jnp.maximum(jnp.abs(points[..., 1] - y) - around.half, 0) ** 2 for y in around.y]
    # Cell by cell: compilers fuse this loop into one pass over all points, unlike a reduction over the cells.
    nearest = jnp.full(points.shape[:-1], jnp.inf, jnp.float32)
    for column, row in itertools.product(range(len(off_x)), range(len(off_y))):
        there = jnp.where(around.blocked[column, row], off_x[column] + off_y[row], jnp.inf)
        nearest = jnp.minimum(nearest, there)
    return jnp.sqrt(nearest)
