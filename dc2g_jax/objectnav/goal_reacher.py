"""The last part of the path: distances to an object that the robot has seen (section II-D, equation 7)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid.fast_marching import travel_cost
from dc2g_jax.objectnav.cost_maps import inflated, straight_distance

#: The path to an object ends at this distance from it, meters between the centers of cells.
ARM = 0.8

#: The robot stops at this cost or less, meters: the paper's threshold, whose unit the paper does not give. The robot is
#: then usually within the success distance of 1 m, but may be just outside it if the rest of its path bends.
STOP = 0.2

#: A cell of the target's class counts if this many such cells lie in the 5 x 5 cells around it.
LEAST_CELLS = 3


def without_specks(cells: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The cells of a class with enough such cells around them. Isolated cells are usually false positives."""
    around = jax.lax.reduce_window(cells.astype(jnp.int32), 0, jax.lax.add, (5, 5), (1, 1), "SAME")
    return cells & (around >= LEAST_CELLS)


def distance_to_object(
    obstacles: Bool[Array, "h w"],
    walls: Bool[Array, "h w"],
    goals: Bool[Array, "h w"],
    *,
    radius: float,
    cell_size: float,
) -> Float[Array, "h w"]:
    """Distance that the center of a round robot has to drive until an object is at arm's length (equation 7).

    If the robot can come only within `STOP` of arm's length, as beside a large table with a plant in the middle, the
    remaining distance is added in full.

    Args:
      obstacles: cells that the robot must not touch.
      walls: those obstacles through which the arm cannot reach.
      goals: cells of the object.
      radius: radius of the robot, meters.
      cell_size: edge of a cell, meters.

    Returns:
      float32 meters; infinity where the robot does not fit and where no path leads to the object.
    """
    passable = ~inflated(obstacles, radius, cell_size)
    lacking = jnp.maximum(straight_distance(goals, walls, cell_size, ARM + STOP) - ARM, 0)
    cost_of_cell = jnp.where(passable, jnp.float32(cell_size), jnp.inf)
    return travel_cost(cost_of_cell, jnp.where(passable, lacking, jnp.inf))
