"""The planners by name, those that run on a network with the numbers that were chosen on validation houses."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Literal, get_args

from dc2g_jax.estimation.estimators import Estimator, ExactCostToGo, answers_in_cells
from dc2g_jax.planning.planners import DC2G, Frontier, MapRevisingPlanner, Oracle
from dc2g_jax.planning.rules import Rules, nearest_goal
from dc2g_jax.planning.selection import ExpectedCost, Patience, QuantileCost, Selection

PlannerName = Literal["oracle", "frontier", "dc2g", "dc2g_uncertain", "true_cost_to_go"]

#: Planner names, in the order of the tables.
PLANNERS: tuple[PlannerName, ...] = get_args(PlannerName)


def _on_network(selection: Selection, estimator: Estimator, rules: Rules) -> DC2G:
    """A planner that runs on a network, as it was chosen on validation houses (see docs/notebook).

    It asks about the map and its mirror image in turn, and heads for the nearest goal in reach, whatever the rules.
    """
    return DC2G(
        estimator,
        dataclasses.replace(rules, goal_poses=nearest_goal),
        selection=selection,
        rim_width=1,
        views=((), (1,)),
        gain_weight=3.0,
        patience=Patience(radius=8, decisions=30, price=0.25),
    )


#: The planners that run on a network, given it and the rules.
NETWORK_PLANNERS: Mapping[str, Callable[[Estimator, Rules], DC2G]] = {
    "dc2g": functools.partial(_on_network, ExpectedCost(distance_weight=0.5)),
    "dc2g_uncertain": functools.partial(_on_network, QuantileCost(level=0.7, distance_weight=0.5)),
}


def make_planner(name: str, rules: Rules, estimator: Estimator | None = None) -> MapRevisingPlanner:
    """A planner by name.

    Args:
      name: one of `PLANNERS`.
      rules: what is seen and what counts as frontier.
      estimator: the network of `dc2g` and `dc2g_uncertain`.

    Raises:
      ValueError: for an unknown name, or a planner that needs an estimator without one.
    """
    if name == "oracle":
        return Oracle()
    if name == "frontier":
        return Frontier(rules=rules)
    if name == "true_cost_to_go":
        return DC2G(estimator=ExactCostToGo(), rules=rules)
    if name in NETWORK_PLANNERS and estimator is not None:
        # Where costs have no scale, no distance can be added to them: the paper's rule.
        return NETWORK_PLANNERS[name](estimator, rules) if answers_in_cells(estimator) else DC2G(estimator, rules)
    if name in NETWORK_PLANNERS:
        raise ValueError(f"the planner {name!r} needs an estimator, such as a trained network")
    raise ValueError(
        f"no planner is called {name!r}; known: {', '.join(PLANNERS)} (one of your own: give it to Runner.run as own)"
    )
