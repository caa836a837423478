"""Agents that search for objects, by name."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.estimation.hub import local_folder
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.search_indoors.learning.networks import CostMapEstimator, load_costs
from dc2g_jax._src.search_indoors.maps.camera import indoor_camera
from dc2g_jax._src.search_indoors.search.agent import (
    CONTROLLER,
    MPC,
    Agent,
    Guide,
    LookAround,
    RandomUntilSeen,
    Steering,
)
from dc2g_jax._src.search_indoors.search.guides import (
    GoalReacher,
    NearestFrontier,
    NullGuide,
    Predicted,
    PredictedCosts,
    PromisingFrontier,
    TrueCost,
)

#: The shipped network and its encoder.
_SHIPPED_INDOOR_NETWORK = "weights/cost_maps_indoors"

#: Names of the agents.
AgentName = Literal["true_cost", "random", "frontier", "predicted", "promising"]

#: Agents that use a network.
ON_NETWORK = ("promising", "predicted")


def open_costs(place: str | Path | None) -> PredictedCosts[CostMapEstimator]:
    """The network in a place, or the shipped one."""
    return PredictedCosts(*load_costs(resource(_SHIPPED_INDOOR_NETWORK) if place is None else local_folder(place)))


def costs_for(agents: Iterable[str], place: str | Path | None) -> PredictedCosts[CostMapEstimator] | None:
    """`open_costs` if one of these agents uses a network, else `None`."""
    return open_costs(place) if set(ON_NETWORK) & set(agents) else None


def agent_with(name: str, costs: PredictedCosts | None, samples: int = CONTROLLER.samples) -> Agent:
    """The agent of this name. Agents with an exploration rule look around first.

    Args:
      name: one of `AgentName`.
      costs: the network, for agents that use one.
      samples: plans that the controller samples at each step.

    Raises:
      InputError: the agent needs a network.
    """
    steering: Steering = LookAround(MPC())
    guide: Guide
    if name == "true_cost":
        guide, steering = TrueCost(), MPC()
    elif name == "random":
        guide, steering = GoalReacher(NullGuide()), RandomUntilSeen()
    elif name == "frontier":
        guide = GoalReacher(NearestFrontier())
    elif costs is None:
        raise InputError(f"the agent {name} needs a network; give one")
    else:
        guide = GoalReacher(Predicted(costs) if name == "predicted" else PromisingFrontier(costs))
    return Agent(
        guide=guide,
        steering=steering,
        camera=indoor_camera(),
        controller=dataclasses.replace(CONTROLLER, samples=samples),
    )
