"""Episodes by name: planners, order of results, extra steps and summaries."""

import jax
import numpy as np
import pytest

from dc2g_jax.datasets.houses import House, HouseDataset
from dc2g_jax.datasets.starts import Start
from dc2g_jax.estimation.estimators import ExactCostToGo, NetworkCostToGo, TranslatorCostToGo
from dc2g_jax.estimation.extents import CroppedEstimator, WindowedEstimator
from dc2g_jax.estimation.networks import Architecture, init_weights
from dc2g_jax.estimation.translator import TranslatorArchitecture
from dc2g_jax.evaluation import (
    NETWORK_PLANNERS,
    Runner,
    episodes_from,
    extra_steps,
    make_planner,
    summarize,
)
from dc2g_jax.grid.terrain import FRONT_DOOR
from dc2g_jax.planning.planners import DC2G, Frontier, Oracle
from dc2g_jax.planning.rules import SETTINGS, complete_rules
from tests.oracles import gridworld_oracle as oracle
from tests.refusals import refusal, refusal_of

RULES = complete_rules(4)


@pytest.fixture(scope="module")
def dataset(street) -> HouseDataset:
    mirrored = np.ascontiguousarray(street[:, ::-1])
    return HouseDataset("toys", "folder", (House("left", "test", street), House("right", "val", mirrored)))


STARTS = (
    Start("right", 0, 4, 0, 4, 3),
    Start("left", 9, 5, 1),
    Start("right", 9, 5, 2),
    Start("left", 0, 6, 3, 4, 3),
    Start("left", 0, 6, 3),
    Start("right", 4, 4, 1, 4, 3),
)


def test_results_come_in_the_order_of_planners_and_starts_whatever_their_ranges(dataset):
    results = Runner(dataset, SETTINGS["reference"]).run(STARTS, ["frontier", "oracle", "frontier"])
    assert [result.planner for result in results] == ["frontier"] * len(STARTS) + ["oracle"] * len(STARTS)
    for result, start in zip(results, STARTS * 2, strict=True):
        assert (result.house, result.x, result.y, result.heading) == start[:4]
        sensing = start.sensing_range or 8
        expanding = start.expanding_range or sensing
        assert (result.range, result.expanding_range) == (sensing, expanding)
        episode = {
            name: oracle.run_episode(
                dataset.house(start.house).terrain,
                (start.x, start.y, start.heading),
                name,
                rules="reference",
                sensing_radius=sensing,
                expanding_radius=expanding,
                max_steps=500,
            )
            for name in ("oracle", "frontier")
        }
        success, actions, mode = episode[result.planner]
        assert (result.success, result.actions, result.mode) == (success, actions, mode)
        assert (result.steps, result.oracle_steps) == (len(actions), len(episode["oracle"][1]))
        assert result.extra == pytest.approx(100 * (len(actions) / len(episode["oracle"][1]) - 1))


def test_dc2g_runs_on_the_network_it_is_given(dataset):
    architecture = Architecture(widths=(4,) * len(Architecture().widths))
    network = NetworkCostToGo(weights=init_weights(architecture, jax.random.key(0)), architecture=architecture)
    runner = Runner(dataset, SETTINGS["paper"], step_limit=40)
    results = runner.run(STARTS[1:3], ["dc2g", "oracle"], network)
    assert [result.planner for result in results] == ["dc2g", "dc2g", "oracle", "oracle"]
    assert all(result.success and result.extra >= 0 and result.expanding_range is None for result in results)


def test_progress_names_the_planner(dataset):
    reports: list[tuple[str, int, int]] = []
    runner = Runner(dataset, SETTINGS["paper"], step_limit=40, progress=lambda *report: reports.append(report))
    runner.run(STARTS[1:3], ["oracle"])
    assert reports[-1] == ("oracle", 2, 2)


def test_planners_of_ones_own_are_run_beside_the_others(dataset):
    runner = Runner(dataset, SETTINGS["reference"])
    results = runner.run(STARTS, ["mine", "frontier"], own={"mine": Frontier})
    assert [result._replace(planner="frontier") for result in results[: len(STARTS)]] == results[len(STARTS) :]
    assert {result.planner for result in results[: len(STARTS)]} == {"mine"}
    with pytest.raises(ValueError, match=r"no planner is called 'mine'; known: oracle, .*Runner\.run"):
        runner.run(STARTS, ["mine"])
    with pytest.raises(ValueError, match="own: holds an oracle"):
        runner.run(STARTS, ["oracle"], own={"oracle": Frontier})


def test_no_starts_no_results(dataset):
    assert Runner(dataset, SETTINGS["paper"]).run([], ["frontier"]) == []
    assert len(episodes_from([], {})) == 0


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


@pytest.mark.parametrize(("x", "y", "heading"), [(-1, 0, 0), (0, -1, 0), (50, 0, 0), (0, 50, 0), (0, 0, 4), (0, 0, -1)])
def test_a_start_that_is_no_pose_on_the_map_is_refused(x, y, heading, dataset):
    start = STARTS[0]._replace(x=x, y=y, heading=heading)
    refusal_of(ValueError, lambda: Runner(dataset, SETTINGS["paper"]).run([start], ["oracle"]), start.house, "no pose")


def test_a_step_limit_that_not_even_the_oracle_keeps_is_refused(dataset):
    runner = Runner(dataset, SETTINGS["paper"], step_limit=2)
    refusal(lambda: runner.run(STARTS[1:3], ["frontier"]), STARTS[1].house, "within 2 actions", "larger step limit")


@pytest.mark.parametrize(
    ("name", "words"), [("", "true_cost_to_go"), ("Oracle", "known: oracle"), ("dc2g", "needs an estimator")]
)
def test_planners_that_cannot_be_made(name, words):
    with pytest.raises(ValueError, match=words) as caught:
        make_planner(name, RULES)
    assert repr(name) in str(caught.value)


@pytest.mark.parametrize(("steps", "shortest", "wanted"), [(10, 10, 0), (25, 10, 150), (11, 8, 37.5)])
def test_extra_steps(steps, shortest, wanted):
    assert extra_steps(steps, shortest) == wanted


def test_extra_steps_need_an_oracle_that_moved():
    with pytest.raises(ValueError, match="0 steps"):
        extra_steps(5, 0)


def test_summary():
    summary = summarize([0.0, 10.0, 20.0, 170.0], [True, True, True, False])
    assert summary.mean_extra == 50
    assert summary.median_extra == 15
    assert (summary.quartile_25, summary.quartile_75) == (7.5, 57.5)
    assert (summary.success, summary.episodes) == (0.75, 4)
    assert all(type(value) is float for value in summary[:5])


def test_a_summary_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no episode"):
        summarize([], [])


def test_the_step_limit_grows_with_the_map(dataset):
    assert Runner(dataset, SETTINGS["paper"]).step_limit == 500
    campus = House("campus", "test", np.full((60, 100), FRONT_DOOR, np.uint8))
    assert Runner(HouseDataset("own", "folder", (campus,)), SETTINGS["paper"]).step_limit == 60 * 100 // 5
    refusal(lambda: Runner(dataset, SETTINGS["paper"], step_limit=0), "step limit 0", "at least 1")
