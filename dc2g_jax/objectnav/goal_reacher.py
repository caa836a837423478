"""The last part of the way: to an object that the robot has seen (section II-D, equation 7)."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid.fast_marching import geodesic_distance
from dc2g_jax.objectnav.cost_maps import inflated

#: How far the robot can be from an object and have reached it, metres between the middles of cells: the success
#: distance of 1 m, less what is left of the way when it stops.
ARM = 0.8

#: The robot stops where so many metres are left of its way, or less: the paper's threshold of the cost, whose unit it
#: does not give.
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


def within_arm(
    goals: Bool[Array, "h w"], walls: Bool[Array, "h w"], cell_size: float, arm: float = ARM
) -> Bool[Array, "h w"]:
    """Cells from which an object is at arm's length: over furniture, not through walls.

    Args:
      goals: cells of the object.
      walls: cells that nothing reaches through.
      cell_size: metres.
      arm: its length, metres between the middles of cells, as the crow flies.
    """
    reached, steps = goals, round(arm / cell_size)
    for number in range(steps):
        # By turns to four neighbours and to eight, an octagon that holds the circle.
        across = reached | _shifted(reached, 1, 0) | _shifted(reached, -1, 0)
        last = across if number % 2 else reached
        reached = (across | _shifted(last, 1, 1) | _shifted(last, -1, 1)) & ~walls
    offsets = np.arange(-steps, steps + 1)
    spans = np.sqrt(np.maximum((arm / cell_size + 1e-3) ** 2 - offsets**2, 0)).astype(int)
    rows = {int(span): _spread(goals, int(span)) for span in spans}
    circle = (_shifted(rows[int(span)], int(offset), 0) for offset, span in zip(offsets, spans, strict=True))
    return reached & functools.reduce(jnp.logical_or, circle)


def _spread(cells: Bool[Array, "h w"], span: int) -> Bool[Array, "h w"]:
    """Cells with one of the set in their row within so many columns."""
    return jax.lax.reduce_window(cells, False, jax.lax.bitwise_or, (1, 2 * span + 1), (1, 1), "SAME")


def _shifted(cells: Bool[Array, "h w"], by: int, axis: int) -> Bool[Array, "h w"]:
    """The cells so many rows (axis 0) or columns further on."""
    padded = jnp.pad(cells, [(abs(by), abs(by)) if number == axis else (0, 0) for number in range(2)])
    first = abs(by) - by
    return jax.lax.slice_in_dim(padded, first, first + cells.shape[axis], axis=axis)


def distance_to_object(
    obstacles: Bool[Array, "h w"],
    walls: Bool[Array, "h w"],
    goals: Bool[Array, "h w"],
    *,
    radius: float,
    cell_size: float,
) -> Float[Array, "h w"]:
    """Distance that the middle of a round robot has to drive until an object is at arm's length (equation 7).

    A plant in the middle of a table is reached beside the table.

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
    return geodesic_distance(passable, passable & within_arm(goals, walls, cell_size), cell_size)
