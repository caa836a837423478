"""Cost maps for the controller: the cost of each position of the center of a round vehicle on a grid.

They are made from exact or predicted distances and obstacles. The last part of the path, to an object that the robot
has seen, is that of `distance_to_object` (section II-D, equation 7). Coordinates are those of
`robot.driving.vehicle`: x along columns, y against rows, meters.
"""

import functools
import math
import operator
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from dc2g_jax.grid import shifted
from dc2g_jax.indoor.maps.fast_marching import travel_cost
from dc2g_jax.robot import CostOfPose

#: An array of NumPy, on the host, or of JAX.
Cells = np.ndarray | Array
_Cells = TypeVar("_Cells", np.ndarray, Array)

#: Radius of the robot, meters.
ROBOT_RADIUS = 0.2

#: An object within this distance is reached, meters: the paper's success distance (section III-C).
REACH = 1.0

#: The path to an object ends at this distance from it, meters between the centers of cells.
ARM = 0.8

#: The robot stops at this cost or less, meters: the paper's threshold, whose unit the paper does not give. The robot is
#: then usually within the success distance of 1 m, but may be just outside it if the rest of its path bends.
STOP = 0.2

#: A cell of the target's class counts if this many such cells lie in the 5 x 5 cells around it.
_LEAST_CELLS = 3


def without_specks(cells: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    """The cells of a class with enough such cells around them. Isolated cells are usually false positives."""
    around = jax.lax.reduce_window(cells.astype(jnp.int32), 0, jax.lax.add, (5, 5), (1, 1), "SAME")
    return cells & (around >= _LEAST_CELLS)


def inflated(cells: Bool[_Cells, "h w"], radius: float, cell_size: float) -> Bool[_Cells, "h w"]:
    """Obstacles inflated by a round vehicle: cells in whose center it would touch one, some point of it being nearer.

    Args:
      cells: obstacle cells, an array of NumPy or JAX, as the result will be. Space beyond the grid is free.
      radius: radius of the vehicle, meters.
      cell_size: edge of a cell, meters.
    """
    reach, (height, width) = math.ceil(radius / cell_size + 0.5), cells.shape
    gap = np.maximum(np.abs(np.arange(-reach, reach + 1)) - 0.5, 0)
    disc = np.hypot(gap[:, None], gap) * cell_size < radius
    disc[reach, reach] = True
    padded = cells.__array_namespace__().pad(cells, reach)
    around = (padded[down : down + height, right : right + width] for down, right in np.argwhere(disc).tolist())
    return functools.reduce(operator.or_, around)


def straight_distance(
    goals: Bool[Array, "h w"], walls: Bool[Array, "h w"], cell_size: float, most: float
) -> Float[Array, "h w"]:
    """Straight-line distance of cells to a nearby object, over furniture but not through walls.

    An object just around the end of a wall counts: it must be reachable on the grid within `most` without crossing a
    wall.

    Args:
      goals: cells of the object.
      walls: cells of walls.
      cell_size: edge of a cell, meters.
      most: the longest distance that counts, meters.

    Returns:
      float32 meters between the centers of cells; infinity farther away and behind walls.
    """
    steps = round(most / cell_size)
    reached = goals
    for number in range(steps):
        # Alternating between four and eight neighbors gives an octagon that contains the circle.
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
    margin: float = 0.0,
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
      margin: how much nearer than `ARM` to the object the path ends, meters.

    Returns:
      float32 meters; infinity where the robot does not fit and where no path leads to the object.
    """
    passable = ~inflated(obstacles, radius, cell_size)
    lacking = jnp.maximum(straight_distance(goals, walls, cell_size, ARM + STOP) - (ARM - margin), 0)
    cost_of_cell = jnp.where(passable, jnp.float32(cell_size), jnp.inf)
    return travel_cost(cost_of_cell, jnp.where(passable, lacking, jnp.inf))


def with_tight_cells(
    distance: Float[Array, "h w"], free: Bool[Array, "h w"], fits: Bool[Array, "h w"], cell_size: float
) -> Float[Array, "h w"]:
    """Extend distances to free cells in which a robot does not fit, by the distance to cells in which it does.

    Args:
      distance: meters; infinite where the robot does not fit, and where no path leads to the goal. The latter stay
        infinite.
      free: free floor.
      fits: cells in which the robot fits.
      cell_size: edge of a cell, meters.
    """
    known = jnp.where(free, distance, jnp.inf)
    tight = free & ~fits & ~jnp.isfinite(known)
    return travel_cost(jnp.where(tight, jnp.float32(cell_size), jnp.inf), known)


def dense_costs(
    distance: Float[Array, "h w"], cell_size: ArrayLike, *, collision: ArrayLike = 50.0, slope: ArrayLike = 10.0
) -> Float[Array, "h w"]:
    """A finite cost for every cell: the distance where finite, elsewhere a penalty that slopes back to such cells.

    Args:
      distance: distance to the goal, meters; infinity where the vehicle must not be or has no path.
      cell_size: edge of a cell, meters.
      collision: additional cost of cells with infinite distance.
      slope: increase of the cost there, per meter away from cells with finite distance.
    """
    known = jnp.isfinite(distance)
    cost_of_cell = jnp.where(known, jnp.inf, jnp.asarray(slope * cell_size, jnp.float32))
    filled = travel_cost(cost_of_cell, distance) + jnp.where(known, 0, jnp.float32(collision))
    return jnp.where(jnp.any(known), filled, jnp.float32(collision))


def cost_lookup(costs: Float[Array, "h w"], cell_size: ArrayLike, outside: ArrayLike) -> CostOfPose:
    """The cost of a pose by bilinear interpolation of a cost map. It does not depend on the yaw.

    Args:
      costs: finite costs of cells.
      cell_size: edge of a cell, meters.
      outside: cost off the map.
    """

    def cost_of_pose(position: Float[Array, "2"], yaw: Float[Array, ""]) -> Float[Array, ""]:
        column, row = position * jnp.array([1, -1], jnp.float32) / cell_size - 0.5
        return jax.scipy.ndimage.map_coordinates(costs, [row, column], order=1, mode="constant", cval=outside)

    return cost_of_pose
