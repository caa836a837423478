"""Guides: strategies that direct a robot toward an object (`search.agent`), and the agents that have them, by name.

`until_seen` wraps any other guide and takes over once the robot has seen an object of the wanted class.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32

from dc2g_jax.grid import FOUR_CONNECTED, scaled, shifted
from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.indoor.learning.networks import CostMapEstimator, load_costs
from dc2g_jax.indoor.maps.camera import indoor_camera
from dc2g_jax.indoor.maps.classes import GOALS, NO_OBJECT
from dc2g_jax.indoor.maps.cost_maps import distance_to_object, inflated, without_specks
from dc2g_jax.indoor.maps.fast_marching import geodesic_distance, travel_cost
from dc2g_jax.indoor.maps.mapping import (
    EXPLORED_CHANNEL,
    OBSTACLE_CHANNEL,
    IndoorMapSettings,
    has,
    has_any_class,
    network_maps,
    square,
    window,
)
from dc2g_jax.indoor.search.agent import (
    CONTROLLER,
    Agent,
    Guidance,
    Guide,
    Picture,
    Searcher,
    Steering,
    look_around_first,
    random_until_seen,
    with_mpc,
)
from dc2g_jax.robot import PAPER_LIKE
from dc2g_jax.runtime import InputError, check_name, jit

#: Weight of the predicted cost relative to the distance over seen floor.
_WEIGHT = 2.0

#: With noise: votes that a class needs in a cell, and how much nearer to objects robots drive, meters.
_VOTES, _MARGIN = 2, 0.25

#: A path counts if it begins within this many cells of the robot in rows and columns: a robot that has collided stands
#: on a cell in which it does not fit.
_NEAR = 2


def true_costs(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
    """The exact distance to the nearest object, of an agent that also knows when it has arrived.

    The paper's agent with exact costs ends an episode when the goal is visible.

    Raises:
      InputError: the agent has not been told the house.
    """
    del image
    if agent.true_distance is None:
        raise InputError("the guide true_costs needs the house ahead of time, but has none; use another one on a robot")
    side = agent.mapping.local
    first = robot.local_middle - side // 2
    return Guidance(square(agent.true_distance[robot.target], first, side, jnp.inf), jnp.bool_(True))


def nowhere(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
    """No information, for steering that does not use a guide."""
    del image
    return _exploring(jnp.full_like(robot.costs, jnp.inf))


def nearest_frontier(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
    """To the nearest unseen floor on the local map, or on the whole map if none is left on the local one.

    Small specks of unseen floor count only if nothing else is left.
    """
    del image
    side, cells = agent.mapping.local, agent.mapping.cells
    ground, beyond = _ground(_around(robot, agent), agent)
    near = geodesic_distance(ground, without_specks(beyond), agent.mapping.cell_size)

    def far() -> Float[Array, "n n"]:
        margin = cells // 2 - side // 2
        whole = _ground(window(robot.map, robot.local_middle, cells), agent)
        distance = geodesic_distance(*whole, agent.mapping.cell_size)
        return jax.lax.slice(distance, (margin, margin), (margin + side, margin + side))

    return _exploring(jax.lax.cond(_begins_here(near), lambda: near, far))


def predicted(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
    """By the costs that a network predicts (section II-B), outside the obstacles seen so far."""
    obstacles = has(_around(robot, agent), OBSTACLE_CHANNEL)
    closed = inflated(obstacles, agent.controller.limits.radius, agent.mapping.cell_size)
    return _exploring(jnp.where(closed, jnp.inf, predicted_costs(robot, image, agent)))


def promising_frontier(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
    """To the unseen floor with the least sum of distance and twice the predicted cost.

    This is the rule of this package's `dc2g` planner. The paper's agent instead descends the predicted costs, which
    have local minima; distances over seen floor have none. If nothing unseen is near, this is `nearest_frontier`.
    """
    ground, beyond = _ground(_around(robot, agent), agent)
    promised = jnp.where(without_specks(beyond), _WEIGHT * predicted_costs(robot, image, agent), jnp.inf)
    cost_of_cell = jnp.where(ground, jnp.float32(agent.mapping.cell_size), jnp.inf)
    distance = travel_cost(cost_of_cell, promised)
    return jax.lax.cond(
        _begins_here(distance), lambda: _exploring(distance), lambda: nearest_frontier(robot, None, agent)
    )


def until_seen(explorer: Guide) -> Guide:
    """To an object of the wanted class once one has been seen and while a path may lead to it (section II-D).

    Unseen cells count as free. Before, and if there is no path, another guide is used, the explorer.
    """

    def guide(robot: Searcher, image: Picture, agent: Agent) -> Guidance:
        cells = _around(robot, agent)
        goals = without_specks(has(cells, jnp.asarray(GOALS)[robot.target] - 1))
        obstacles = has(cells, OBSTACLE_CHANNEL)

        def to_goals() -> Float[Array, "n n"]:
            radius, cell_size = agent.controller.limits.radius, agent.mapping.cell_size
            walls = obstacles & ~has_any_class(cells)
            return distance_to_object(
                obstacles | goals, walls, goals, radius=radius, cell_size=cell_size, margin=agent.margin
            )

        distance = jax.lax.cond(jnp.any(goals), to_goals, lambda: jnp.full(goals.shape, jnp.inf, jnp.float32))
        return jax.lax.cond(
            _begins_here(distance), lambda: Guidance(distance, jnp.bool_(True)), lambda: explorer(robot, image, agent)
        )

    return guide


def predicted_costs(robot: Searcher, image: Picture, agent: Agent) -> Float[Array, "n n"]:
    """The costs that the agent's network predicts, see `learning.networks.CostMapEstimator.estimate`.

    Raises:
      InputError: the camera's picture is missing.
    """
    if image is None or agent.estimator is None:
        raise InputError("predicted costs need a network and the camera's picture; give one with each frame")
    maps = network_maps(window(robot.map, robot.local_middle, agent.mapping.cells), agent.mapping.local)
    return agent.estimator.estimate(maps, robot.target, robot.vehicle.yaw, image)


def true_distance(world: IndoorWorld, agent: Agent) -> Float[Array, "goal h w"]:
    """`Agent.true_distance` in a house. Cells that are neither free nor an object are walls, or outside."""
    return _true_distance(world.free, world.classes, agent.controller.limits.radius, float(world.cell_size))


@functools.partial(jit, static_argnames=("radius", "cell_size"))
def _true_distance(free: Array, classes: Array, radius: float, cell_size: float) -> Float[Array, "goal h w"]:
    walls = ~free & (classes == NO_OBJECT)
    return jax.lax.map(
        lambda goal: distance_to_object(~free, walls, classes == goal, radius=radius, cell_size=cell_size),
        jnp.array(GOALS, jnp.uint8),
    )


def _exploring(distance: Float[Array, "n n"]) -> Guidance:
    return Guidance(distance, jnp.bool_(False))


def _around(robot: Searcher, agent: Agent) -> UInt32[Array, "n n"]:
    return window(robot.map, robot.local_middle, agent.mapping.local)


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


#: Names of the agents.
AgentName = Literal["true_cost", "random", "frontier", "predicted", "promising"]

#: Agents that use a network.
ON_NETWORK = ("promising", "predicted")

#: Name of an agent -> its guide and steering. Agents with an exploration rule look around first.
_AGENTS: dict[str, tuple[Guide, Steering]] = {
    "true_cost": (true_costs, with_mpc),
    "random": (until_seen(nowhere), random_until_seen),
    "frontier": (until_seen(nearest_frontier), look_around_first),
    "predicted": (until_seen(predicted), look_around_first),
    "promising": (until_seen(promising_frontier), look_around_first),
}


def agent_with(
    name: str,
    network: CostMapEstimator | str | Path | None = None,
    *,
    samples: int = CONTROLLER.samples,
    noise: float = 0.0,
) -> Agent:
    """The agent of this name.

    Args:
      name: one of `AgentName`.
      network: network of agents that use one, or its place, see `learning.networks.load_costs`; `None` for the shipped
        one.
      samples: plans that the controller samples at each step.
      noise: noise level; 0 is no noise, 1 the presumed noise of the DC2G paper's maps. With noise, frames vote on the
        classes of a cell, and the path to an object ends somewhat nearer to it.

    Raises:
      InputError: the name is unknown, or the network cannot be read.
    """
    check_name("agent", name, _AGENTS)
    guide, steering = _AGENTS[name]
    if name not in ON_NETWORK:
        network = None
    elif not isinstance(network, CostMapEstimator):
        network = load_costs(network)
    return Agent(
        guide=guide,
        steering=steering,
        camera=indoor_camera(),
        estimator=network,
        controller=dataclasses.replace(CONTROLLER, samples=samples),
        mapping=IndoorMapSettings(votes=_VOTES if noise else 1),
        noise=scaled(PAPER_LIKE, np.float32(noise)),
        margin=_MARGIN if noise else 0.0,
    )
