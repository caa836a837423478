"""Planners by name."""

import pytest

from dc2g_jax.estimation.estimators import ExactCostToGo, NetworkCostToGo, TranslatorCostToGo
from dc2g_jax.estimation.extents import CroppedEstimator, WindowedEstimator
from dc2g_jax.estimation.networks.compact_unet import Architecture
from dc2g_jax.estimation.networks.pix2pix import TranslatorArchitecture
from dc2g_jax.planning.named import NETWORK_PLANNERS, make_planner
from dc2g_jax.planning.planners import DC2G, Frontier, Oracle
from dc2g_jax.planning.rules import SETTINGS, complete_rules

RULES = complete_rules(4)


def test_make_planner():
    estimator = ExactCostToGo()
    assert make_planner("oracle", RULES) == Oracle()
    assert make_planner("frontier", RULES) == Frontier(RULES)
    assert make_planner("true_cost_to_go", RULES) == DC2G(ExactCostToGo(), RULES)
    for name, make in NETWORK_PLANNERS.items():
        assert make_planner(name, RULES, estimator) == make(estimator, RULES)
    # Pictures have no scale that a distance could be added to.
    translator = TranslatorCostToGo(weights=(), architecture=TranslatorArchitecture(size=32, base_filters=2))
    assert make_planner("dc2g", RULES, translator) == DC2G(translator, RULES)


def test_planners_on_a_network_head_for_the_nearest_door_whatever_the_rules():
    reference = SETTINGS["reference"].rules()
    for make in NETWORK_PLANNERS.values():
        planner = make(ExactCostToGo(), reference)
        assert planner.rules.frontier_expanding is reference.frontier_expanding
        assert planner.rules.goal_poses is RULES.goal_poses is not reference.goal_poses


def test_no_distance_is_added_to_pictures_however_they_are_asked_for():
    translator = TranslatorCostToGo(weights=(), architecture=TranslatorArchitecture(size=32, base_filters=2))
    network = NetworkCostToGo(weights=(), architecture=Architecture())
    for wrapped in (CroppedEstimator, WindowedEstimator):
        assert make_planner("dc2g", RULES, wrapped(translator)) == DC2G(wrapped(translator), RULES)
        assert make_planner("dc2g", RULES, wrapped(network)) == NETWORK_PLANNERS["dc2g"](wrapped(network), RULES)


@pytest.mark.parametrize(
    ("name", "words"), [("", "true_cost_to_go"), ("Oracle", "known: oracle"), ("dc2g", "needs an estimator")]
)
def test_planners_that_cannot_be_made(name, words):
    with pytest.raises(ValueError, match=words) as caught:
        make_planner(name, RULES)
    assert repr(name) in str(caught.value)
