"""The last part of the way: to an object that the robot has seen (section II-D, equation 7)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid.fast_marching import travel_cost
from dc2g_jax.objectnav.cost_maps import inflated, straight_distance

#: The way to an object ends this far from it, meters between the middles of cells.
ARM = 0.8

#: The robot stops where the cost is no more than this, meters: the paper's threshold, whose unit it does not give. As a
#: rule it is then within the success distance of 1 m; not quite where the rest of its way bends.
STOP = 0.2

#: Of so many cells with the target's class, within two cells to every side, one at least must be part.
LEAST_CELLS = 3


def without_specks(cells: Bool[Array, "h w"], least: int = LEAST_CELLS) -> Bool[Array, "h w"]:
    """The cells that have enough of their kind around them: single ones are false positives as a rule.

    Args:
      cells: where a class has been seen.
      least: cells in the 5 x 5 cells around one, itself included, for it to stay.
    """
    around = jax.lax.reduce_window(cells.astype(jnp.int32), 0, jax.lax.add, (5, 5), (1, 1), "SAME")
    return cells & (around >= least)


def distance_to_object(
    obstacles: Bool[Array, "h w"],
    walls: Bool[Array, "h w"],
    goals: Bool[Array, "h w"],
    *,
    radius: float,
    cell_size: float,
) -> Float[Array, "h w"]:
    """Distance that the middle of a round robot has to drive until an object is at arm's length (equation 7).

    Where it cannot come so near but within `STOP` of it, as beside a large table with a plant in the middle, what lacks
    counts in full.

    Args:
      obstacles: cells that the robot may not touch.
      walls: those of them that no arm reaches through.
      goals: cells of the object.
      radius: of the robot, meters.
      cell_size: meters.

    Returns:
      float32 meters; infinity where the robot does not fit and where no way leads to the object.
    """
    passable = ~inflated(obstacles, radius, cell_size)
    lacking = jnp.maximum(straight_distance(goals, walls, cell_size, ARM + STOP) - ARM, 0)
    cost_of_cell = jnp.where(passable, jnp.float32(cell_size), jnp.inf)
    return travel_cost(cost_of_cell, jnp.where(passable, lacking, jnp.inf))
