"""Training pairs: masked maps and their exact cost-to-go (Algorithm 1)."""

import math

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from dc2g_jax._src.grid import bitboard

#: Number of rotations and reflections of a square map.
SYMMETRY_COUNT = 8


@struct.dataclass
class TrainingSet:
    """Labels and observation masks. Pairs are made from them on the device, batch by batch.

    Attributes:
      terrain: class indices of every world.
      cost_to_go: exact cost-to-go of every world in cells, infinity where there is none.
      masks: boards of observed cells.
      mask_world: index of the world that each mask belongs to.
      n_own: number of masks of the dataset's own houses; these come first, those of procedural houses follow.
    """

    terrain: UInt8[Array, "worlds h w"]
    cost_to_go: Float[Array, "worlds h w"]
    masks: UInt32[Array, "masks n_words h"]
    mask_world: Int[Array, "masks"]
    n_own: Int[Array, ""]


@struct.dataclass
class Pair:
    """One training pair.

    Attributes:
      terrain: observed class indices, 0 where not observed.
      target: exact cost-to-go in cells; infinite where its weight is 0.
      weight: weight of each cell in the loss.
    """

    terrain: UInt8[Array, "*batch h w"]
    target: Float[Array, "*batch h w"]
    weight: Float[Array, "*batch h w"]


def turned(grid: Array, symmetry: Int[Array, ""]) -> Array:
    """The grid under one of the symmetries of the square (of the rectangle if the grid is not square).

    Args:
      grid: values of cells.
      symmetry: 0 to 7: columns are reversed if bit 0 is set, rows if bit 1 is, and then the grid is transposed if bit 2
        is.
    """
    height, width = grid.shape
    rows, columns = jnp.arange(height), jnp.arange(width)
    rows = jnp.where(symmetry & 2, height - 1 - rows, rows)
    columns = jnp.where(symmetry & 1, width - 1 - columns, columns)
    if height != width:
        return grid[rows[:, None], columns]
    # One lookup is faster on a CPU than three selections between whole grids.
    return grid[jnp.where(symmetry & 4, rows, rows[:, None]), jnp.where(symmetry & 4, columns[:, None], columns)]


def _near(cells: Bool[Array, "h w"], distance: int) -> Bool[Array, "h w"]:
    """Cells within `distance` columns and rows of one of the given cells."""
    for window in ((2 * distance + 1, 1), (1, 2 * distance + 1)):
        cells = jax.lax.reduce_window(cells, False, jax.lax.bitwise_or, window, (1, 1), "SAME")
    return cells


def make_pair(
    data: TrainingSet,
    index: Int[Array, ""],
    symmetry: Int[Array, ""],
    whole: Bool[Array, ""] | bool = False,
    *,
    edge_weight: float,
    edge_width: int = 2,
    half_weight_cost: float = math.inf,
) -> Pair:
    """The training pair of one mask under a symmetry (Algorithm 1, lines 7 and 8).

    Only observed cells with a cost-to-go have weight. Cells within `edge_width` cells of unobserved ground, among which
    a planner chooses, have `edge_weight` times the weight. Weights decrease with distance from the goal, so that the
    loss is closer to a relative error than to an absolute one.

    Args:
      data: labels and masks.
      index: index of the mask.
      symmetry: 0 to `SYMMETRY_COUNT` - 1.
      whole: whether to lift the mask, so that the whole map is observed.
      edge_weight: weight of cells near unobserved ground; other cells have weight 1.
      edge_width: largest distance to unobserved ground that counts as near, in cells.
      half_weight_cost: cost-to-go in cells at which the weight is half of that at a goal; infinite for equal weights.
    """
    world = data.mask_world[index]
    width = data.terrain.shape[-1]
    seen = bitboard.unpack(data.masks[index], width) | whole
    target = data.cost_to_go[world]
    counts = seen & jnp.isfinite(target)
    of_cost = 1 / (1 + jnp.where(counts, target, 0.0) / half_weight_cost)
    weight = jnp.where(_near(~seen, edge_width), edge_weight, 1.0) * of_cost * counts
    pair = Pair(terrain=jnp.where(seen, data.terrain[world], jnp.uint8(0)), target=target, weight=weight)
    return jax.tree.map(lambda grid: turned(grid, symmetry), pair)


#: Largest shift of a map in cells, per unit of jitter.
_SHIFT_PER_JITTER = 40.0


def jittered(key: Array, pair: Pair, jitter: float) -> Pair:
    """A randomly scaled and shifted pair; with probability 1/2 the pair does not change.

    Each axis is scaled by its own factor, and cells are resampled by nearest neighbor. Costs scale with the map. Cells
    from beyond the map's edge are unobserved.

    Args:
      key: PRNG key.
      pair: one training pair.
      jitter: logarithm of the largest factor; maps are shifted by up to 40 cells times `jitter`.
    """
    height, width = pair.terrain.shape
    stretch, shift, chance = jax.random.split(key, 3)
    change = jax.random.bernoulli(chance)
    factors = jnp.exp(jax.random.uniform(stretch, (2,), minval=-jitter, maxval=jitter))
    offsets = _SHIFT_PER_JITTER * jax.random.uniform(shift, (2,), minval=-jitter, maxval=jitter)
    factors, offsets = jnp.where(change, factors, 1.0), jnp.where(change, offsets, 0.0)

    def sampled(size: int, axis: int) -> tuple[Array, Array]:
        """Index of the source of each cell, and whether the source lies on the map."""
        middle = (size - 1) / 2
        source = jnp.round((jnp.arange(size) - middle) / factors[axis] + middle + offsets[axis]).astype(jnp.int32)
        return jnp.clip(source, 0, size - 1), (source >= 0) & (source < size)

    (rows, row_there), (columns, column_there) = sampled(height, 0), sampled(width, 1)
    there, source = row_there[:, None] & column_there, (rows[:, None], columns)
    return Pair(
        terrain=jnp.where(there, pair.terrain[source], jnp.uint8(0)),
        target=pair.target[source] * jnp.sqrt(factors[0] * factors[1]),
        weight=jnp.where(there, pair.weight[source], 0.0),
    )
