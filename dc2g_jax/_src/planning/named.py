"""Planners by name. The parameters of those with a network were chosen on validation houses."""

import dataclasses
import functools
import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import Estimator, ExactCostToGo, answers_in_cells, trait
from dc2g_jax._src.grid.streets import in_town
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.frontiers import facing_most
from dc2g_jax._src.planning.planners import DC2G, Frontier, Oracle, Planner, PlannerLike
from dc2g_jax._src.planning.rules import Rules, Settings, named_settings, nearest_goal
from dc2g_jax._src.planning.selection import ENDLESS, ExpectedCost, Patience, QuantileCost, Selection
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.own_parts import own_part
from dc2g_jax._src.runtime.plugins import plugins

#: Patience of planners with a network in the gridworld, where every decision is a step.
STEP_PATIENCE = Patience(radius=8, decisions=30, price=0.25)


def _unbounded(selection: Selection, estimator: Estimator, rules: Rules, patience: Patience) -> DC2G:
    """DC2G with the parameters chosen on validation houses and towns (see docs/notebook).

    It alternates between the map and its mirror image as the network's input. It heads for the nearest reachable goal
    under all rules. Without a scale, no distance can be added to the costs; the paper's rule needs none.
    """
    if not answers_in_cells(estimator):
        return DC2G(estimator, rules)
    return DC2G(
        estimator,
        dataclasses.replace(rules, goal_poses=nearest_goal),
        selection=selection,
        rim_width=1,
        views=((), (1,)),
        gain_weight=3.0,
        headings=facing_most,
        patience=patience,
        replan_fraction=1 / 3,
        town_side=trait(estimator, "side"),
    )


def _on_network(
    selection: Selection, estimator: Estimator, rules: Rules, patience: Patience = STEP_PATIENCE
) -> DC2G | Bounded:
    """The same, bounded in towns, which are unlike the maps of the training (see docs/notebook/towns.md).

    Once a robot has taken its map for a town, it takes at most 2.5 times the actions of frontier exploration and 50
    more. There is no bound where a decision is not an action, and none without a scale.
    """
    planner = _unbounded(selection, estimator, rules, patience)
    if not patience.price or not answers_in_cells(estimator):
        return planner
    side = trait(estimator, "side") or Architecture.side
    return Bounded(
        planner, planner.rules, factor=2.5, slack=0.0, actions=50.0, renewed=0.3, where=in_town, free_side=side
    )


def _bounded(estimator: Estimator, rules: Rules, patience: Patience = STEP_PATIENCE) -> Bounded:
    """`dc2g` with a bound on its actions (see docs/notebook/bounded.md)."""
    planner = _unbounded(ExpectedCost(distance_weight=0.5), estimator, rules, patience)
    return Bounded(planner, planner.rules, factor=2.0, slack=3.0)


#: Planners of plug-ins, called with the rules; and those with a network, called with the rules and `estimator`.
RIVALS, NETWORK_RIVALS = plugins("planners"), plugins("network_planners")


def _rival_on_network(name: str, estimator: Estimator, rules: Rules, patience: Patience = ENDLESS) -> Any:
    """A planner of a plug-in with a network, whose costs are in cells. It has no patience."""
    del patience
    if not answers_in_cells(estimator):
        raise InputError(f"the planner {name!r} needs costs in cells; give another network")
    return NETWORK_RIVALS[name].load()(rules, estimator=estimator)


#: Planners of the package without a network, called with the rules.
_PLANNERS_BY_RULES: Mapping[str, Callable[[Rules], Planner]] = {
    "oracle": lambda rules: Oracle(),
    "frontier": Frontier,
    "true_cost_to_go": lambda rules: DC2G(ExactCostToGo(), rules),
}

#: Planners with a network, called with the network, the rules and, optionally, their patience.
NETWORK_PLANNERS: Mapping[str, Callable[..., Any]] = {
    # Algorithm 2 and nothing else: the lowest mean cost-to-go wins, whatever the distance. Its patience never ends.
    "dc2g_paper": lambda estimator, rules, patience=ENDLESS: DC2G(estimator, rules),
    "dc2g": functools.partial(_on_network, ExpectedCost(distance_weight=0.5)),
    "dc2g_uncertain": functools.partial(_on_network, QuantileCost(level=0.7, distance_weight=0.5)),
    "dc2g_bounded": _bounded,
    **{name: functools.partial(_rival_on_network, name) for name in NETWORK_RIVALS},
}

#: Planners of the figures and tables unless others are chosen, in their order.
FIGURE_PLANNERS: tuple[str, ...] = ("oracle", "frontier", "dc2g", "dc2g_uncertain", "true_cost_to_go")

#: All planner names.
PLANNERS: tuple[str, ...] = (*FIGURE_PLANNERS, "dc2g_paper", "dc2g_bounded", *RIVALS, *NETWORK_RIVALS)


def make_planner(
    name: str,
    *,
    network: Estimator | str | os.PathLike[str] | None = None,
    settings: str | Settings = "paper",
    sensing_range: int | None = None,
) -> PlannerLike:
    """Make a planner by name.

    ```
    planner = dc2g_jax.make_planner("dc2g", sensing_range=8)
    ```

    Args:
      name: one of `PLANNERS`, or `package.module:Name` for a class of your own, which is called with the rules.
      network: network of a planner in `NETWORK_PLANNERS`: an estimator, or the place of a trained network, see
        `estimation.hub.load_network`; `None` for the shipped network.
      settings: the rules, one of `planning.rules.SETTINGS` or its name.
      sensing_range: range of the field of view in cells; `None` for the default of the settings.

    Raises:
      InputError: the planner or the settings are unknown, the sensing range is out of bounds, or the network cannot be
        read.
    """
    rules = named_settings(settings).rules(sensing_range)
    return planner_with(name, rules, open_estimator(network) if name in NETWORK_PLANNERS else None)


def planner_with(
    name: str, rules: Rules, estimator: Estimator | None = None, *, patience: Patience = STEP_PATIENCE
) -> PlannerLike:
    """Make a planner by name from rules and an estimator.

    Args:
      name: one of `PLANNERS`, or `package.module:Name` for a class of your own, which is called with the rules.
      rules: field of view and definition of frontiers.
      estimator: network of a planner in `NETWORK_PLANNERS`.
      patience: patience of a planner in `NETWORK_PLANNERS`.

    Raises:
      InputError: the name is unknown, the class takes no rules, or the estimator is missing.
    """
    if name in _PLANNERS_BY_RULES:
        return _PLANNERS_BY_RULES[name](rules)
    if name in RIVALS:
        return RIVALS[name].load()(rules)
    if name in NETWORK_PLANNERS and estimator is not None:
        return NETWORK_PLANNERS[name](estimator, rules, patience)
    if name in NETWORK_PLANNERS:
        raise InputError(f"the planner {name!r} needs an estimator, such as a trained network")
    own = own_part("planner", name, PLANNERS)
    try:
        inspect.signature(own).bind(rules)
    except TypeError as error:
        raise InputError(f"planner {name!r}: cannot be called with the rules ({error}); give it one argument") from None
    return own(rules)


def check_names(names: Iterable[str]) -> None:
    """Check that every name is one of `PLANNERS` or an importable class.

    Raises:
      InputError: a name is neither.
    """
    for name in names:
        if name not in PLANNERS:
            own_part("planner", name, PLANNERS)


def open_estimator(network: Estimator | str | os.PathLike[str] | None) -> Estimator:
    """Load the network in a place, or the shipped one for `None`. Estimators are returned as they are.

    Raises:
      InputError: the network cannot be read.
    """
    if network is not None and not isinstance(network, str | os.PathLike):
        return network
    # Orbax takes a second to import and is only needed for files.
    from dc2g_jax._src.estimation.hub import load_network

    return load_network(network)
