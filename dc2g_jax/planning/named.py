"""The planners by name, those that run on a network with the numbers that were chosen on validation houses."""

import dataclasses
import functools
import importlib
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import Estimator, ExactCostToGo, answers_in_cells
from dc2g_jax.planning.frontiers import facing_most
from dc2g_jax.planning.planners import DC2G, Frontier, MapRevisingPlanner, Oracle
from dc2g_jax.planning.rules import Rules, Settings, named_settings, nearest_goal
from dc2g_jax.planning.selection import ExpectedCost, Patience, QuantileCost, Selection

#: Of planners on a network in the gridworld, where every decision is a step.
STEP_PATIENCE = Patience(radius=8, decisions=30, price=0.25)


def _on_network(selection: Selection, estimator: Estimator, rules: Rules, patience: Patience = STEP_PATIENCE) -> DC2G:
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
        headings=facing_most,
        patience=patience,
    )


#: The planners that need no network, given the rules.
_PLANNERS_BY_RULES: Mapping[str, Callable[[Rules], MapRevisingPlanner]] = {
    "oracle": lambda rules: Oracle(),
    "frontier": Frontier,
    "true_cost_to_go": lambda rules: DC2G(ExactCostToGo(), rules),
}

#: The planners that run on a network, given it, the rules and, where it is another one, their patience.
NETWORK_PLANNERS: Mapping[str, Callable[..., DC2G]] = {
    "dc2g": functools.partial(_on_network, ExpectedCost(distance_weight=0.5)),
    "dc2g_uncertain": functools.partial(_on_network, QuantileCost(level=0.7, distance_weight=0.5)),
}

#: Planner names, in the order of the tables.
PLANNERS: tuple[str, ...] = ("oracle", "frontier", *NETWORK_PLANNERS, "true_cost_to_go")


def make(
    name: str,
    *,
    network: Estimator | str | os.PathLike[str] | None = None,
    settings: str | Settings = "paper",
    sensing_range: int | None = None,
) -> MapRevisingPlanner:
    """Make a planner by name.

    ```
    planner = dc2g_jax.make("dc2g", sensing_range=8)
    ```

    Args:
      name: one of `PLANNERS`, or `package.module:Class` for a class of your own, which is called with the rules.
      network: what `dc2g` and `dc2g_uncertain` run on: an estimator or the folder of a trained network; the shipped
        network where `None`.
      settings: the rules, one of `dc2g_jax.planning.rules.SETTINGS` or its name.
      sensing_range: reach of the field of view in cells; the settings' own where `None`.

    Raises:
      InputError: for an unknown planner or unknown settings, a sensing range out of bounds, or a network that cannot
        be read.
    """
    rules = named_settings(settings).rules(sensing_range)
    return make_planner(name, rules, open_estimator(network) if name in NETWORK_PLANNERS else None)


def make_planner(
    name: str, rules: Rules, estimator: Estimator | None = None, *, patience: Patience = STEP_PATIENCE
) -> MapRevisingPlanner:
    """A planner by name, from rules and an estimator at hand.

    Args:
      name: one of `PLANNERS`, or `package.module:Class` for a class of your own, which is called with the rules.
      rules: what is seen and what counts as frontier.
      estimator: the network of `dc2g` and `dc2g_uncertain`.
      patience: that of `dc2g` and `dc2g_uncertain`.

    Raises:
      InputError: for an unknown name, or a planner that needs an estimator without one.
    """
    if name in _PLANNERS_BY_RULES:
        return _PLANNERS_BY_RULES[name](rules)
    if name in NETWORK_PLANNERS and estimator is not None:
        # Where costs have no scale, no distance can be added to them: the paper's rule.
        if answers_in_cells(estimator):
            return NETWORK_PLANNERS[name](estimator, rules, patience)
        return DC2G(estimator, rules)
    if name in NETWORK_PLANNERS:
        raise InputError(f"the planner {name!r} needs an estimator, such as a trained network")
    return _imported(name)(rules)


def check_names(names: Iterable[str]) -> None:
    """Check that every name is one of `PLANNERS` or a class that can be imported.

    Raises:
      InputError: one is neither.
    """
    for name in names:
        if name not in PLANNERS:
            _imported(name)


def open_estimator(network: Estimator | str | os.PathLike[str] | None) -> Estimator:
    """An estimator as it is, or the network in a folder; the shipped network for `None`.

    Raises:
      InputError: the folder holds no network that can be read.
    """
    if network is not None and not isinstance(network, str | os.PathLike):
        return network
    # Orbax takes a second to import, and only files need it.
    from dc2g_jax.estimation.checkpoints import load_network

    return load_network(network)


def _imported(name: str) -> Any:
    """A planner's class by `package.module:Class`."""
    module, colon, attribute = name.partition(":")
    if not colon:
        known = ", ".join(PLANNERS)
        raise InputError(f"no planner is called {name!r}; known: {known} (one of your own: package.module:Class)")
    try:
        return getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(
            f"planner {name!r}: cannot be imported ({error}); give package.module:Class, of a module that Python finds "
            "in this folder or among the installed ones"
        ) from None
