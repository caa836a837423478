"""Planners by name."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.estimators import ExactCostToGo, NetworkCostToGo
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.bounded import Bounded
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore, weights_of
from dc2g_jax._src.planning.named import (
    NETWORK_PLANNERS,
    NETWORK_RIVALS,
    PLANNERS,
    check_names,
    make_planner,
    planner_with,
)
from dc2g_jax._src.planning.planners import DC2G, Frontier, Oracle
from dc2g_jax._src.planning.rules import SETTINGS, complete_rules
from dc2g_jax._src.planning.selection import ExpectedCost
from experiments.benchmarks.extents import CroppedEstimator, WindowedEstimator
from experiments.translator.network import TranslatorArchitecture, TranslatorCostToGo
from tests.support import maps
from tests.support.refusals import refusal

RULES = complete_rules(4)


class NoRules:
    """A planner whose class takes no rules."""

    def __init__(self):
        pass


def test_make_planner():
    estimator = ExactCostToGo()
    assert planner_with("oracle", RULES) == Oracle()
    assert planner_with("frontier", RULES) == Frontier(RULES)
    assert planner_with("true_cost_to_go", RULES) == DC2G(ExactCostToGo(), RULES)
    for name, on_network in NETWORK_PLANNERS.items():
        assert repr(planner_with(name, RULES, estimator)) == repr(on_network(estimator, RULES))
    # Pictures have no scale that a distance could be added to.
    translator = TranslatorCostToGo(weights=(), architecture=TranslatorArchitecture(size=32, base_filters=2))
    assert planner_with("dc2g", RULES, translator) == DC2G(translator, RULES)


@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_shows_itself_without_private_modules(name):
    shown = repr(planner_with(name, RULES, ExactCostToGo()))
    assert "Kernel(radius=4)" in shown or name == "oracle"
    assert "_src" not in shown, shown


def test_planners_on_a_network_go_by_the_score_that_was_learned_with_it():
    learned = {"90": {term: np.float32(number) for number, term in enumerate(TERMS)}}
    network = dataclasses.replace(load_network(None), score=learned)
    terrain = jnp.asarray(maps.random_terrain(0, (50, 50), 0.7, doors=1))
    for estimator, score in ((network, learned), (ExactCostToGo(), load_network(None).score)):
        dc2g, uncertain, bounded = (
            NETWORK_PLANNERS[name](estimator, RULES) for name in ("dc2g", "dc2g_uncertain", "dc2g_bounded")
        )
        state = estimator.init(World.from_terrain(terrain))
        outcomes = np.asarray(estimator.estimate(terrain, state))
        for planner, wanted in ((dc2g, outcomes.mean(axis=0)), (uncertain, outcomes[int(0.7 * len(outcomes))])):
            assert isinstance(planner, LearnedScore)
            np.testing.assert_array_equal(planner.weights, weights_of(score))
            (summary,) = planner.summary(planner.estimator.estimate(terrain, state))
            np.testing.assert_allclose(summary, wanted, rtol=1e-4)
        assert repr(bounded) == repr(Bounded(dc2g, dc2g.rules, factor=2.0, slack=3.0))


def test_planners_that_differ_in_the_summary_of_a_network_share_a_program():
    dc2g, uncertain = (planner_with(name, RULES, load_network(None)) for name in ("dc2g", "dc2g_uncertain"))
    assert jax.tree.structure(dc2g) == jax.tree.structure(uncertain)


def test_the_papers_planner_is_that_of_the_paper():
    """The values of Algorithm 2, written out."""
    reference = SETTINGS["reference"].rules()
    planner = planner_with("dc2g_paper", reference, ExactCostToGo())
    assert planner == DC2G(ExactCostToGo(), reference, selection=ExpectedCost(distance_weight=0.0))


def test_planners_on_a_network_head_for_the_nearest_door_whatever_the_rules():
    reference = SETTINGS["reference"].rules()
    for name in NETWORK_PLANNERS.keys() - set(NETWORK_RIVALS):
        planner = planner_with(name, reference, ExactCostToGo())
        assert planner.rules.frontier_expanding is reference.frontier_expanding
        assert RULES.goal_poses is not reference.goal_poses
        assert planner.rules.goal_poses is (reference if name == "dc2g_paper" else RULES).goal_poses


def test_no_distance_is_added_to_pictures_however_they_are_asked_for():
    translator = TranslatorCostToGo(weights=(), architecture=TranslatorArchitecture(size=32, base_filters=2))
    network = load_network(None)
    for wrapped in (CroppedEstimator, WindowedEstimator):
        assert planner_with("dc2g", RULES, wrapped(translator)) == DC2G(wrapped(translator), RULES)
        assert isinstance(planner_with("dc2g", RULES, wrapped(network)), LearnedScore)


@pytest.mark.parametrize(
    ("name", "words"), [("", "true_cost_to_go"), ("Oracle", "give one of oracle"), ("dc2g", "needs an estimator")]
)
def test_planners_that_cannot_be_made(name, words):
    with pytest.raises(ValueError, match=words) as caught:
        planner_with(name, RULES)
    assert repr(name) in str(caught.value)


def test_make_takes_settings_and_the_network_from_where_it_is_told():
    assert make_planner("frontier") == Frontier(complete_rules(8))
    assert make_planner("frontier", settings="published") == Frontier(SETTINGS["published"].rules())
    assert make_planner("true_cost_to_go", settings=SETTINGS["paper"], sensing_range=4) == DC2G(ExactCostToGo(), RULES)
    assert make_planner("dc2g", network=ExactCostToGo()).estimator == ExactCostToGo()
    assert isinstance(make_planner("dc2g").estimator, NetworkCostToGo)
    assert make_planner("frontier", field_of_view=180) == Frontier(complete_rules(8, degrees=180))
    refusal(lambda: make_planner("frontier", sensing_range=65), "sensing range 65", "1 to 64")
    refusal(lambda: make_planner("frontier", field_of_view=0), "field of view 0", "1 to 360")
    refusal(lambda: make_planner("dc2g", network="no_such_folder"), "no_such_folder", "no such file")


class Plain(ExactCostToGo):
    """A class that JAX does not know."""


def narrow_estimator():
    return ExactCostToGo(log_error=1.0)


def test_an_estimator_of_the_users_own_goes_by_its_name():
    module = ExactCostToGo.__module__
    assert make_planner("dc2g", network=f"{module}:ExactCostToGo").estimator == ExactCostToGo()
    assert make_planner("dc2g", network=f"{__name__}:narrow_estimator").estimator == narrow_estimator()
    refusal(lambda: make_planner("dc2g", network=f"{__name__}:refusal"), ":refusal'", "called without arguments")
    for wrong in ("Plain", "RULES"):
        refusal(
            lambda wrong=wrong: make_planner("dc2g", network=f"{__name__}:{wrong}"),
            f":{wrong}'",
            "flax.struct.dataclass",
        )
    refusal(lambda: make_planner("dc2g", network="no_such_module:Estimator"), "'no_such_module:Estimator'", ":Name")


def test_a_class_is_named_by_its_module():
    name = f"{Frontier.__module__}:{Frontier.__name__}"
    check_names([name, "oracle"])
    assert make_planner(name, sensing_range=4) == Frontier(RULES)
    refusal(lambda: make_planner("tests.planning.test_named:NoRules"), "NoRules", "one argument")
    for wrong in ("no_such_module:Planner", f"{Frontier.__module__}:NoSuchPlanner", ":Frontier", "math:"):
        refusal(lambda wrong=wrong: check_names([wrong]), repr(wrong), "package.module:Name")
