"""Guides: strategies that direct a robot toward an object (`search.agent`).

`GoalReacher` wraps any other guide and takes over once the robot has seen an object of the wanted class.
"""

import functools
from typing import Generic, Protocol, TypeVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Float, Int, Key, UInt32

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.grid.fast_marching import geodesic_distance, travel_cost
from dc2g_jax._src.grid.search import FOUR_CONNECTED
from dc2g_jax._src.grid.shifting import shifted
from dc2g_jax._src.programs import jit
from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld
from dc2g_jax._src.search_indoors.learning.midlevel import ImageEncoder
from dc2g_jax._src.search_indoors.learning.networks import fused_cost
from dc2g_jax._src.search_indoors.maps.classes import GOALS, NO_OBJECT
from dc2g_jax._src.search_indoors.maps.cost_maps import distance_to_object, inflated, without_specks
from dc2g_jax._src.search_indoors.maps.mapping import (
    EXPLORED_CHANNEL,
    OBSTACLE_CHANNEL,
    has,
    has_any_class,
    network_input,
    square,
    window,
)
from dc2g_jax._src.search_indoors.search.agent import Agent, Guidance, Guide, Observation

#: A path counts if it begins within this many cells of the robot in rows and columns: a robot that has collided stands
#: on a cell in which it does not fit.
_NEAR = 2


class _CostEstimator(Protocol):
    """Predicts costs from a partial map. Implementations are pytrees."""

    def estimate(
        self, maps: Float[Array, "36 n n"], target: Int[Array, ""], features: Float[Array, " f"],
        heading: Float[Array, ""],
    ) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:  # fmt: skip
        """See `learning.networks.CostMapEstimator.estimate`."""
        ...


_Estimator = TypeVar("_Estimator", bound=_CostEstimator)


@struct.dataclass
class PredictedCosts(Generic[_Estimator]):
    """Navigation costs predicted from the map and the camera image of a robot.

    Attributes:
      estimator: predicts costs.
      encoder: computes mid-level features of the camera image.
      meters: distance that corresponds to a cost of 1. A network trained on shares of the longest path
        (`--recipe paper`) has no such scale and is used as if it had.
      threshold: cells with a higher probability of being occupied are blocked (the paper's theta_occ).
    """

    estimator: _Estimator
    encoder: ImageEncoder
    meters: float = 10.0
    threshold: float = 0.5

    def of(self, seen: Observation, agent: Agent) -> Float[Array, "n n"]:
        """Cost of each cell of the local map relative to the best cell, meters.

        Infinite where a cell is predicted to be occupied.

        Raises:
          InputError: the camera's picture is missing.
        """
        if seen.image is None:
            raise InputError("predicted costs need the camera's picture, but there is none; give one with each frame")
        maps = network_input(seen.map, seen.vehicle.position, agent.mapping)
        features = self.encoder.encode(seen.image[None])[0]
        occupied, cost = self.estimator.estimate(maps, seen.target, features, seen.vehicle.yaw)
        fused = fused_cost(occupied, cost, self.threshold)
        return jnp.where(jnp.isinf(fused), fused, self.meters * (fused - jnp.min(fused)))


@struct.dataclass
class TrueCost(Guide):
    """Guide with the exact distance to the nearest object, which also knows when the robot has arrived.

    The paper's agent with exact costs ends an episode when the goal is visible.

    Attributes:
      distance: distance that the robot's center has to drive until an object of each of `GOALS` is at arm's length,
        meters; infinite where the robot does not fit or no path leads there. `None` before it is told the house.
    """

    distance: Float[Array, "goal h w"] | None = None

    def of_house(self, world: IndoorWorld, radius: float) -> "TrueCost":
        """See `Guide`."""
        return TrueCost(_object_distances(world.free, world.classes, radius, float(world.cell_size)))

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key
        if self.distance is None:
            raise InputError("TrueCost knows the house ahead of time, but none is given; use another guide on a robot")
        side = agent.mapping.local
        first = seen.middle - side // 2
        return Guidance(square(self.distance[seen.target], first, side, jnp.inf), jnp.bool_(True))


@struct.dataclass
class NullGuide(Guide):
    """Guide without information, for steering that does not use a guide."""

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key, seen
        side = agent.mapping.local
        return Guidance(jnp.full((side, side), jnp.inf, jnp.float32), jnp.bool_(False))


@struct.dataclass
class NearestFrontier(Guide):
    """Guide to the nearest unseen floor on the local map, or on the whole map if none is left on the local one.

    Small specks of unseen floor count only if nothing else is left.
    """

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key
        side, cells = agent.mapping.local, seen.map.cells.shape[0]
        ground, beyond = _ground(window(seen.map, seen.middle, side), agent)
        near = geodesic_distance(ground, without_specks(beyond), agent.mapping.cell_size)

        def far() -> Float[Array, "n n"]:
            margin = cells // 2 - side // 2
            whole = _ground(window(seen.map, seen.middle, cells), agent)
            distance = geodesic_distance(*whole, agent.mapping.cell_size)
            return jax.lax.slice(distance, (margin, margin), (margin + side, margin + side))

        return Guidance(jax.lax.cond(_begins_here(near), lambda: near, far), jnp.bool_(False))


@struct.dataclass
class Predicted(Guide):
    """Guide by the costs that a network predicts (section II-B), outside the obstacles seen so far.

    Attributes:
      costs: the prediction.
    """

    costs: PredictedCosts
    uses_image = True

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        del key
        cells = window(seen.map, seen.middle, agent.mapping.local)
        closed = inflated(has(cells, OBSTACLE_CHANNEL), agent.controller.limits.radius, agent.mapping.cell_size)
        return Guidance(jnp.where(closed, jnp.inf, self.costs.of(seen, agent)), jnp.bool_(False))


@struct.dataclass
class PromisingFrontier(Guide):
    """Guide to the unseen floor with the least sum of distance and predicted cost.

    This is the rule of this package's `dc2g` planner. The paper's agent instead descends the predicted costs, which
    have local minima; distances over seen floor have none. If nothing unseen is near, this guide is `NearestFrontier`.

    Attributes:
      costs: the prediction.
      weight: weight of the predicted cost relative to the distance over seen floor.
    """

    costs: PredictedCosts
    weight: float = 2.0
    uses_image = True

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        ground, beyond = _ground(window(seen.map, seen.middle, agent.mapping.local), agent)
        promised = jnp.where(without_specks(beyond), self.weight * self.costs.of(seen, agent), jnp.inf)
        cost_of_cell = jnp.where(ground, jnp.float32(agent.mapping.cell_size), jnp.inf)
        distance = travel_cost(cost_of_cell, promised)
        return jax.lax.cond(
            _begins_here(distance),
            lambda: Guidance(distance, jnp.bool_(False)),
            lambda: NearestFrontier().guide(key, seen, agent),
        )


@struct.dataclass
class GoalReacher(Guide):
    """Guide to an object of the wanted class once one has been seen and while a path may lead to it (section II-D).

    Unseen cells count as free. Before, and if there is no path, the other guide is used.

    Attributes:
      explorer: the other guide.
    """

    explorer: Guide

    @property
    def uses_image(self) -> bool:
        """See `Guide`."""
        return self.explorer.uses_image

    def guide(self, key: Key[Array, ""], seen: Observation, agent: Agent) -> Guidance:
        """See `Guide`."""
        cells = window(seen.map, seen.middle, agent.mapping.local)
        goals = without_specks(has(cells, jnp.asarray(GOALS)[seen.target] - 1))
        obstacles = has(cells, OBSTACLE_CHANNEL)

        def to_goals() -> Float[Array, "n n"]:
            radius, cell_size = agent.controller.limits.radius, agent.mapping.cell_size
            walls = obstacles & ~has_any_class(cells)
            return distance_to_object(obstacles | goals, walls, goals, radius=radius, cell_size=cell_size)

        distance = jax.lax.cond(jnp.any(goals), to_goals, lambda: jnp.full(goals.shape, jnp.inf, jnp.float32))
        return jax.lax.cond(
            _begins_here(distance),
            lambda: Guidance(distance, jnp.bool_(True)),
            lambda: self.explorer.guide(key, seen, agent),
        )


@functools.partial(jit, static_argnames=("radius", "cell_size"))
def _object_distances(free: Array, classes: Array, radius: float, cell_size: float) -> Float[Array, "goal h w"]:
    """Distance of each cell to each of `GOALS`. Cells that are neither free nor an object are walls, or outside."""
    walls = ~free & (classes == NO_OBJECT)
    return jax.lax.map(
        lambda goal: distance_to_object(~free, walls, classes == goal, radius=radius, cell_size=cell_size),
        jnp.array(GOALS, jnp.uint8),
    )


def _begins_here(distance: Float[Array, "n n"]) -> Bool[Array, ""]:
    """Whether a path begins at the robot, in the middle of the local map."""
    middle = distance.shape[0] // 2
    near = slice(middle - _NEAR, middle + _NEAR + 1)
    return jnp.any(jnp.isfinite(distance[near, near]))


def _ground(cells: UInt32[Array, "n n"], agent: Agent) -> tuple[Bool[Array, "n n"], Bool[Array, "n n"]]:
    """Seen cells in which the robot fits, and unseen cells beside them."""
    known = has(cells, EXPLORED_CHANNEL)
    passable = ~inflated(has(cells, OBSTACLE_CHANNEL), agent.controller.limits.radius, agent.mapping.cell_size)
    ground = known & passable
    beside = functools.reduce(jnp.logical_or, (shifted(ground, dx, dy, False) for dx, dy in FOUR_CONNECTED))
    return ground, beside & passable & ~known
