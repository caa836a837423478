"""The last part of the way: to an object that the robot has seen (section II-D, equation 7)."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid.fast_marching import travel_cost
from dc2g_jax.grid.shifting import shifted
from dc2g_jax.objectnav.cost_maps import inflated

#: The way to an object ends this far from it, metres between the middles of cells.
ARM = 0.8

#: The robot stops where the cost is no more than this, metres: the paper's threshold, whose unit it does not give. As a
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


def straight_distance(
    goals: Bool[Array, "h w"], walls: Bool[Array, "h w"], cell_size: float, most: float
) -> Float[Array, "h w"]:
    """Distance of cells to an object near them, as the crow flies, over furniture but not through walls.

    Just around the end of a wall counts: what can be reached on the grid within `most` without crossing a wall.

    Args:
      goals: cells of the object.
      walls: cells that nothing reaches through.
      cell_size: metres.
      most: the longest distance that counts, metres.

    Returns:
      float32 metres between the middles of cells; infinity farther away and behind walls.
    """
    steps = round(most / cell_size)
    reached = goals
    for number in range(steps):
        # By turns to four neighbours and to eight, an octagon that holds the circle.
        across = reached | shifted(reached, 0, 1, False) | shifted(reached, 0, -1, False)
        last = across if number % 2 else reached
        reached = (across | shifted(last, 1, 0, False) | shifted(last, -1, 0, False)) & ~walls
    offsets = range(-steps, steps + 1)
    along = [jnp.where(shifted(goals, offset, 0, False), jnp.float32(offset**2), jnp.inf) for offset in offsets]
    in_row = functools.reduce(jnp.minimum, along)
    square = functools.reduce(jnp.minimum, (shifted(in_row, 0, offset, jnp.inf) + offset**2 for offset in offsets))
    distance = jnp.sqrt(square) * cell_size
    return jnp.where(reached & (distance <= most + 1e-4), distance, jnp.inf)


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
      radius: of the robot, metres.
      cell_size: metres.

    Returns:
      float32 metres; infinity where the robot does not fit and where no way leads to the object.
    """
    passable = ~inflated(obstacles, radius, cell_size)
    lacking = jnp.maximum(straight_distance(goals, walls, cell_size, ARM + STOP) - ARM, 0)
    cost_of_cell = jnp.where(passable, jnp.float32(cell_size), jnp.inf)
    return travel_cost(cost_of_cell, jnp.where(passable, lacking, jnp.inf))
