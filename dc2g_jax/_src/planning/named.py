"""Planners by name."""

import dataclasses
import functools
import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from jaxtyping import Array

from dc2g_jax._src.estimation.estimators import Estimator, ExactCostToGo, answers_in_cells, trait
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.learned_score import LearnedScore, weights_of
from dc2g_jax._src.planning.planners import DC2G, Frontier, Oracle, Planner, PlannerLike, with_summary
from dc2g_jax._src.planning.rules import Rules, Settings, named_settings, nearest_goal
from dc2g_jax._src.planning.selection import QuantileCost, mean_outcome
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.own_parts import own_part
from dc2g_jax._src.runtime.plugins import plugins


@functools.cache
def _shipped_score() -> Mapping[str, Mapping[str, Any]]:
    """The weights of the score that were learned with the shipped network."""
    return load_network(None).score  # type: ignore[return-value]


def _on_network(summary: Callable[[Array], Array], estimator: Estimator, rules: Rules) -> LearnedScore | DC2G:
    """`LearnedScore` with the network's weights, or the shipped ones. It heads for the nearest goal under all rules.

    A cost-to-go without a scale cannot be part of such a score; the paper's rule needs none.
    """
    if not answers_in_cells(estimator):
        return DC2G(estimator, rules)
    rules = dataclasses.replace(rules, goal_poses=nearest_goal)
    weights = weights_of(trait(estimator, "score") or _shipped_score(), rules.sensing.degrees)
    # Summarized in the estimator, so that planners that differ in the summary share one program.
    return LearnedScore(rules, weights, *with_summary(estimator, summary))


def _bounded(estimator: Estimator, rules: Rules) -> Bounded:
    """`dc2g` with a bound on its actions (see docs/notebook/bounded.md)."""
    planner = _on_network(mean_outcome, estimator, rules)
    return Bounded(planner, planner.rules, factor=2.0, slack=3.0)


#: Planners of plug-ins, called with the rules; and those with a network, called with the rules and `estimator`.
RIVALS, NETWORK_RIVALS = plugins("planners"), plugins("network_planners")


def _rival_on_network(name: str, estimator: Estimator, rules: Rules) -> Any:
    """A planner of a plug-in with a network, whose costs are in cells."""
    if not answers_in_cells(estimator):
        raise InputError(f"the planner {name!r} needs costs in cells; give another network")
    return NETWORK_RIVALS[name].load()(rules, estimator=estimator)


#: Planners of the package without a network, called with the rules.
_PLANNERS_BY_RULES: Mapping[str, Callable[[Rules], Planner]] = {
    "oracle": lambda rules: Oracle(),
    "frontier": Frontier,
    "true_cost_to_go": lambda rules: DC2G(ExactCostToGo(), rules),
}

#: Planners with a network, called with the network and the rules.
NETWORK_PLANNERS: Mapping[str, Callable[[Estimator, Rules], Any]] = {
    # Algorithm 2: the lowest mean cost-to-go wins, whatever the distance.
    "dc2g_paper": DC2G,
    "dc2g": functools.partial(_on_network, mean_outcome),
    "dc2g_uncertain": functools.partial(_on_network, QuantileCost(level=0.7, distance_weight=0.0).summary),
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
    field_of_view: float | None = None,
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
      field_of_view: width of the field of view in degrees, 1 to 360; `None` for that of the settings, 90.

    Raises:
      InputError: the planner or the settings are unknown, the sensing range or the field of view is out of bounds, or
        the network cannot be read.
    """
    rules = named_settings(settings, field_of_view).rules(sensing_range)
    return planner_with(name, rules, load_network(network) if name in NETWORK_PLANNERS else None)


def planner_with(name: str, rules: Rules, estimator: Estimator | None = None) -> PlannerLike:
    """Make a planner by name from rules and an estimator.

    Args:
      name: one of `PLANNERS`, or `package.module:Name` for a class of your own, which is called with the rules.
      rules: field of view and definition of frontiers.
      estimator: network of a planner in `NETWORK_PLANNERS`.

    Raises:
      InputError: the name is unknown, the class takes no rules, or the estimator is missing.
    """
    if name in _PLANNERS_BY_RULES:
        return _PLANNERS_BY_RULES[name](rules)
    if name in RIVALS:
        return RIVALS[name].load()(rules)
    if name in NETWORK_PLANNERS and estimator is not None:
        return NETWORK_PLANNERS[name](estimator, rules)
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
