"""Episodes by name: planners, order of results, extra steps and summaries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.compact_unet import Architecture, init_weights
from dc2g_jax._src.estimation.estimators import ExactCostToGo, NetworkCostToGo
from dc2g_jax._src.grid.terrain import FRONT_DOOR, HOUSE, ROAD
from dc2g_jax._src.planning.named import make_planner
from dc2g_jax._src.planning.planners import DC2G, Frontier
from dc2g_jax._src.planning.rules import SETTINGS, complete_rules
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start
from dc2g_jax._src.rollouts import evaluation
from dc2g_jax._src.rollouts.evaluation import Runner, episodes_from, evaluate, open_networks
from dc2g_jax._src.rollouts.results import Results
from tests.oracles import numpy_gridworld as oracle
from tests.support.refusals import refusal

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


@struct.dataclass
class NoNumber(ExactCostToGo):
    """Answers with no number once so many cells are known, as a network that has diverged does."""

    known: int = struct.field(pytree_node=False, default=0)

    def estimate(self, terrain, state):
        diverged = jnp.sum(terrain > 0, axis=(0, 1)) >= self.known
        return jnp.where(diverged, jnp.nan, super().estimate(terrain, state))


@pytest.mark.parametrize(("known", "actions"), [(0, " 0 actions"), (15, "actions")])
def test_estimates_that_are_no_numbers_are_refused(dataset, known, actions):
    runner = Runner(dataset, SETTINGS["paper"])
    rules = complete_rules(3)
    starts = [start._replace(sensing_range=3, expanding_range=None) for start in STARTS[1:3]]
    runner.trajectories(DC2G(ExactCostToGo(), rules), rules, starts)
    refusal(
        lambda: runner.trajectories(DC2G(NoNumber(known=known), rules), rules, starts, "mine"),
        "planner mine: NoNumber estimates NaN in house ", actions, "give an estimator of numbers",
    )  # fmt: skip


def test_maps_of_several_sizes_are_run_as_each_alone(dataset, street):
    larger = House("larger", "test", np.pad(street, ((0, 3), (2, 0)), constant_values=HOUSE))
    both = HouseDataset("both", "folder", (*dataset.houses, larger))
    starts = [Start("larger", 11, 5, 1), Start("left", 9, 5, 1), Start("larger", 2, 6, 3)]
    together = Runner(both, SETTINGS["paper"]).run(starts, ["frontier"])
    apart = [
        *Runner(HouseDataset("one", "folder", (larger,)), SETTINGS["paper"]).run(starts[::2], ["frontier"]),
        *Runner(dataset, SETTINGS["paper"]).run(starts[1:2], ["frontier"]),
    ]
    assert together == [apart[0], apart[2], apart[1]]
    refusal(lambda: Runner(both, SETTINGS["paper"]).trajectories(Frontier(RULES), RULES, starts), "2 sizes")


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
    results = runner.run(STARTS, {"mine": Frontier, "frontier": "frontier"})
    assert [result._replace(planner="frontier") for result in results[: len(STARTS)]] == results[len(STARTS) :]
    assert {result.planner for result in results[: len(STARTS)]} == {"mine"}
    with pytest.raises(ValueError, match=r"no planner is called 'mine'; give one of oracle, .*package\.module:Name"):
        runner.run(STARTS, ["mine"])
    with pytest.raises(ValueError, match="planner oracle: "):
        runner.run(STARTS, {"oracle": Frontier})


def test_no_starts_no_results(dataset):
    assert Runner(dataset, SETTINGS["paper"]).run([], ["frontier"]) == []
    assert len(episodes_from([], {})[0]) == 0
    refusal(lambda: episodes_from(STARTS, {"left": 0}), "'right'", "left")


@pytest.mark.parametrize(("x", "y", "heading"), [(-1, 0, 0), (0, -1, 0), (50, 0, 0), (0, 50, 0), (0, 0, 4), (0, 0, -1)])
def test_a_start_that_is_no_pose_on_the_map_is_refused(x, y, heading, dataset):
    start = STARTS[0]._replace(x=x, y=y, heading=heading)
    mention = "off the map of 10 x 8" if heading == 0 else f"no heading {heading}"
    refusal(lambda: Runner(dataset, SETTINGS["paper"]).run([start], ["oracle"]), "start 0 in right: ", mention)
    refusal(lambda: Runner(dataset, SETTINGS["paper"]).trajectories(Frontier(RULES), RULES, [start]), mention)
    refusal(lambda: evaluate("frontier", dataset, starts=[start]), mention)


def test_a_step_limit_that_not_even_the_oracle_keeps_is_refused(dataset):
    runner = Runner(dataset, SETTINGS["paper"], step_limit=2)
    refusal(lambda: runner.run(STARTS[1:3], ["frontier"]), STARTS[1].house, "within 2 actions", "larger step limit")


def test_a_start_that_leads_nowhere_is_refused(dataset):
    runner, terrain = Runner(dataset, SETTINGS["paper"]), dataset.house(STARTS[0].house).terrain
    y, x = np.argwhere(terrain == HOUSE)[0].tolist()
    refusal(
        lambda: runner.run([STARTS[0]._replace(x=x, y=y, expanding_range=None)], ["frontier"]),
        "is 'house', which",
        "nearest cell",
    )


def test_without_a_goal_in_reach_there_is_nothing_to_compare_with(dataset, street):
    doorless = House("doorless", "test", np.where(street == FRONT_DOOR, HOUSE, street).astype(np.uint8))
    both = HouseDataset("both", "folder", (*dataset.houses, doorless))
    starts = [Start("doorless", 9, 5, 1), Start("left", 9, 5, 1)]
    results = Runner(both, SETTINGS["paper"]).run(starts, ["frontier", "oracle"])
    for result in results[::2]:
        success, actions, mode = oracle.run_episode(
            doorless.terrain,
            (9, 5, 1),
            result.planner,
            rules="complete",
            sensing_radius=8,
            expanding_radius=8,
            max_steps=500,
        )
        assert (result.success, result.actions, result.mode) == (success, actions, mode)
        assert result[7:12] == (False, len(actions), None, None, "gave_up")
    assert results[1::2] == Runner(dataset, SETTINGS["paper"]).run(starts[1:], ["frontier", "oracle"])
    assert Results(results).summary() == Results(results[1::2]).summary()
    refusal(lambda: evaluate("frontier", both, starts=starts), "start 0 in doorless: ", "it has no front door")


def test_the_step_limit_grows_with_the_map(dataset):
    assert Runner(dataset, SETTINGS["paper"]).step_limit == 500
    campus = House("campus", "test", np.full((60, 100), FRONT_DOOR, np.uint8))
    assert Runner(HouseDataset("own", "folder", (campus,)), SETTINGS["paper"]).step_limit == 60 * 100 // 5
    # Of ground, the largest part counts, also if cut off from the door; a long way to it counts on a map of any size.
    campus.terrain[:, 6:] = HOUSE
    assert Runner(HouseDataset("own", "folder", (campus,)), SETTINGS["paper"]).step_limit == 500
    campus.terrain[:, 8:20] = ROAD
    assert Runner(HouseDataset("own", "folder", (campus,)), SETTINGS["paper"]).step_limit == 60 * 12
    corridors = np.full((50, 50), ROAD, np.uint8)
    corridors[1::4, 1:] = corridors[3::4, :-1] = HOUSE
    corridors[0, 49] = FRONT_DOOR
    maze = House("maze", "test", corridors)
    every_cell = 25 * 50 + 25 - 1
    assert Runner(HouseDataset("own", "folder", (maze,)), SETTINGS["paper"]).step_limit == 4 * every_cell
    refusal(lambda: Runner(dataset, SETTINGS["paper"], step_limit=0), "step limit 0", "at least 1")


def test_evaluate_is_what_the_runner_gives_for_names_classes_and_planners(dataset):
    starts = [start._replace(expanding_range=None) for start in STARTS]
    own = {
        "class": Frontier,
        "ready": make_planner("frontier", sensing_range=4),
        "named": f"{Frontier.__module__}:Frontier",
    }
    results = evaluate({**own, "frontier": "frontier"}, dataset, starts=starts, sensing_range=4)
    four = [start._replace(sensing_range=4) for start in starts]
    expected = Runner(dataset, SETTINGS["paper"]).run(four, ["frontier"])
    for name in (*own, "frontier"):
        assert [one._replace(planner="frontier") for one in results.of(name)] == expected
    assert evaluate("frontier", dataset, starts=starts, sensing_range=4) == Results(expected)


def test_evaluate_samples_starts_in_the_houses_of_a_split(dataset):
    results = evaluate(["oracle"], dataset, split="val", starts_per_house=3, seed=1)
    assert {result.house for result in results} == {"right"}
    others = [evaluate(["oracle"], dataset, split="val", starts_per_house=3, **seed) for seed in ({}, {"seed": 0})]
    assert results != others[0] == others[1]
    refusal(lambda: evaluate(["oracle"], dataset, split="train"), "toys", "train")
    refusal(lambda: evaluate(["oracle"], dataset, seed=-1), "seed -1")


def test_several_networks_are_run_side_by_side(dataset, compact_network, tmp_path):
    starts = STARTS[1:3]
    networks = {"exact": ExactCostToGo(), "compact": compact_network}
    results = evaluate(["oracle", "dc2g"], dataset, starts=starts, network=networks, step_limit=40)
    assert list(results.summary()) == ["oracle", "dc2g (exact)", "dc2g (compact)"]
    for name, network in networks.items():
        alone = evaluate({f"dc2g ({name})": "dc2g"}, dataset, starts=starts, network=network, step_limit=40)
        assert results.of(f"dc2g ({name})") == alone
    assert evaluate("dc2g", dataset, starts=starts, network=[compact_network], step_limit=40).array("steps").keys() == {
        "dc2g"
    }
    refusal(lambda: evaluate("dc2g", dataset, starts=starts, network=[compact_network] * 2), "give each once")
    refusal(lambda: evaluate("dc2g", dataset, starts=starts, network={}), "give one at least")


def test_networks_are_called_by_the_end_of_their_place(monkeypatch):
    monkeypatch.setattr(evaluation, "load_network", lambda place: place)
    assert list(open_networks(["runs/a", "hf://me/b", "my:C"])) == ["a", "b", "my:C"]
    assert list(open_networks(["one/network", "two/network"])) == ["one/network", "two/network"]
    assert list(open_networks(["r/a/network,r/b/network", "r/b/network"])) == ["network,network", "network"]
    assert list(open_networks(["r/a/n,r/b/n", "r/a/n,r/c/n"])) == ["a/n,b/n", "a/n,c/n"]
    assert open_networks(["runs/a"]) == open_networks("runs/a") == "runs/a"


def test_a_planner_made_for_another_field_of_view_is_refused(dataset):
    mine = {"mine": make_planner("frontier", sensing_range=5)}
    refusal(lambda: evaluate(mine, dataset, starts=STARTS[1:3]), "'mine'", "5 cells", "one of 8", "sensing_range")
    occluded = {"mine": make_planner("frontier", settings="occluded")}
    refusal(lambda: evaluate(occluded, dataset, starts=STARTS[1:3]), "'mine'", "one of 8 of another kind")
    wide = {"mine": make_planner("frontier", field_of_view=120)}
    refusal(
        lambda: evaluate(wide, dataset, starts=STARTS[1:3], field_of_view=360),
        "'mine'", "8 cells and 120 degrees", "one of 8 and 360", "field_of_view",
    )  # fmt: skip


def test_robots_may_see_all_around(dataset):
    results = evaluate("frontier", dataset, starts=STARTS[1:3], sensing_range=3, field_of_view=360)
    mine = {"frontier": Frontier(complete_rules(3, degrees=360))}
    assert list(results) == list(evaluate(mine, dataset, starts=STARTS[1:3], sensing_range=3, field_of_view=360))
    narrow = evaluate("frontier", dataset, starts=STARTS[1:3], sensing_range=3)
    assert [one.actions for one in results] != [one.actions for one in narrow]


def test_evaluate_refuses_before_anything_runs(dataset):
    refusal(lambda: evaluate(["fronteir"], dataset), "fronteir", "give one of oracle")
    refusal(lambda: evaluate(["frontier"], dataset, settings="papers"), "papers", "published")
    refusal(lambda: evaluate(["frontier"], dataset, sensing_range=0), "sensing range 0")
    refusal(lambda: evaluate(["frontier"], dataset, field_of_view=0), "field of view 0", "from 1 to 360 degrees")
    refusal(
        lambda: evaluate("frontier", dataset, settings="published", field_of_view=180), "'published'", "90 degrees only"
    )
    for unnamed in (Frontier, [Frontier], make_planner("frontier")):
        refusal(lambda unnamed=unnamed: evaluate(unnamed, dataset), "is no name", "mapping, such as")
    refusal(lambda: evaluate({"mine": lambda rules: rules}, dataset), "'mine'", "has no init", "check_planner")
    refusal(lambda: evaluate("builtins:repr", dataset), "'builtins:repr'", "has no init", "check_planner")
