"""Guides: what tells a robot which way an object may be (`dc2g_jax.objectnav.agent`).

The goal reacher goes around any of the others: it takes over as soon as the robot has seen what it looks for.
"""

import functools

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Key, UInt32

from dc2g_jax.grid.fast_marching import geodesic_distance, travel_cost
from dc2g_jax.grid.search import FOUR_CONNECTED
from dc2g_jax.grid.shifting import shifted
from dc2g_jax.objectnav.agent import Agent, Guidance, Guide, Robot, Site
from dc2g_jax.objectnav.classes import GOALS
from dc2g_jax.objectnav.cost_maps import inflated
from dc2g_jax.objectnav.goal_reacher import distance_to_object, without_specks
from dc2g_jax.objectnav.mapping import EXPLORED, OBSTACLE, has, has_any_class, square, window
from dc2g_jax.objectnav.predicted_costs import PredictedCosts

#: A way counts as the robot's if it begins within so many cells of the robot, to every side: one that has run into
#: something stands where it does not fit.
_NEAR = 2


@struct.dataclass
class TrueCost:
    """Knows the way to the nearest object, and when it is there.

    The paper's agent with exact costs ends an episode when the goal is visible.
    """

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key
        return Guidance(true_distance(robot, site, agent), jnp.bool_(True))


def true_distance(robot: Robot, site: Site, agent: Agent) -> Float[Array, "n n"]:
    """What is left of the way to the nearest object from each cell of the local map, meters."""
    side = agent.mapping.local
    return square(site.distances[robot.target], robot.local_middle - side // 2, side, jnp.inf)


@struct.dataclass
class NoIdea:
    """Knows nothing: for steering that does not ask."""

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key, robot, site
        side = agent.mapping.local
        return Guidance(jnp.full((side, side), jnp.inf, jnp.float32), jnp.bool_(False))


@struct.dataclass
class Frontier:
    """Goes where the nearest floor is that has not been seen: on the local map, and if nothing is left there on all.

    Specks of unseen floor count only when nothing else is left.
    """

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key, site
        side, cells = agent.mapping.local, robot.map.cells.shape[0]
        ground, beyond = _ground(window(robot.map, robot.local_middle, side), agent)
        near = geodesic_distance(ground, without_specks(beyond), agent.mapping.cell_size)

        def far() -> Float[Array, "n n"]:
            margin = cells // 2 - side // 2
            whole = _ground(window(robot.map, robot.local_middle, cells), agent)
            distance = geodesic_distance(*whole, agent.mapping.cell_size)
            return jax.lax.slice(distance, (margin, margin), (margin + side, margin + side))

        return Guidance(jax.lax.cond(_begins_here(near), lambda: near, far), jnp.bool_(False))


@struct.dataclass
class Predicted:
    """Goes by the costs that a network predicts (section II-B), but not through what it has seen to be in the way.

    Attributes:
      costs: the prediction.
    """

    costs: PredictedCosts

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key
        cells = window(robot.map, robot.local_middle, agent.mapping.local)
        closed = inflated(has(cells, OBSTACLE), agent.controller.limits.radius, agent.mapping.cell_size)
        return Guidance(jnp.where(closed, jnp.inf, self.costs.of(robot, site, agent)), jnp.bool_(False))


@struct.dataclass
class PromisingFrontier:
    """Goes where the way to unseen floor and the cost that a network predicts there are least together.

    That is the rule of this package's `dc2g` in place of the paper's, which drives down the predicted costs themselves:
    those have hollows that lead nowhere, the way over seen floor has none. Where nothing near is left to be seen, it is
    `Frontier`.

    Attributes:
      costs: predicted.
      weight: of a meter of predicted cost, in meters of way over seen floor.
    """

    costs: PredictedCosts
    weight: float = 2.0

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        ground, beyond = _ground(window(robot.map, robot.local_middle, agent.mapping.local), agent)
        promised = jnp.where(without_specks(beyond), self.weight * self.costs.of(robot, site, agent), jnp.inf)
        cost_of_cell = jnp.where(ground, jnp.float32(agent.mapping.cell_size), jnp.inf)
        distance = travel_cost(cost_of_cell, promised)
        return jax.lax.cond(
            _begins_here(distance),
            lambda: Guidance(distance, jnp.bool_(False)),
            lambda: Frontier().guide(key, robot, site, agent),
        )


@struct.dataclass
class GoalReacher:
    """Goes to an object of the wanted class once one has been seen and as long as a way may lead to it (section II-D).

    What has not been seen counts as free. Where no way is left, the other guide goes on.

    Attributes:
      explorer: guides the robot until then.
    """

    explorer: Guide

    def guide(self, key: Key[Array, ""], robot: Robot, site: Site, agent: Agent) -> Guidance:
        """See `Guide`."""
        cells = window(robot.map, robot.local_middle, agent.mapping.local)
        goals = without_specks(has(cells, jnp.asarray(GOALS)[robot.target] - 1))
        obstacles = has(cells, OBSTACLE)

        def to_goals() -> Float[Array, "n n"]:
            radius, cell_size = agent.controller.limits.radius, agent.mapping.cell_size
            walls = obstacles & ~has_any_class(cells)
            return distance_to_object(obstacles | goals, walls, goals, radius=radius, cell_size=cell_size)

        distance = jax.lax.cond(jnp.any(goals), to_goals, lambda: jnp.full(goals.shape, jnp.inf, jnp.float32))
        return jax.lax.cond(
            _begins_here(distance),
            lambda: Guidance(distance, jnp.bool_(True)),
            lambda: self.explorer.guide(key, robot, site, agent),
        )


def _begins_here(distance: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Is there a way from where the robot is, in the middle of the local map?"""
    middle = distance.shape[0] // 2
    near = slice(middle - _NEAR, middle + _NEAR + 1)
    return jnp.any(jnp.isfinite(distance[near, near]))


def _ground(cells: UInt32[Array, "n n"], agent: Agent) -> tuple[Bool[Array, "n n"], Bool[Array, "n n"]]:
    """Cells that have been seen and that the robot can be in, and such beside them that have not been seen."""
    known = has(cells, EXPLORED)
    passable = ~inflated(has(cells, OBSTACLE), agent.controller.limits.radius, agent.mapping.cell_size)
    ground = known & passable
    beside = functools.reduce(jnp.logical_or, (shifted(ground, dx, dy, False) for dx, dy in FOUR_CONNECTED))
    return ground, beside & passable & ~known
