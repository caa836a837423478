"""The package does what the authors' code did, episode by episode, and recomputes their headline figures."""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.estimators import ExactCostToGo
from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.gridworld import belief_of
from dc2g_jax._src.grid.poses import ACTION_LETTERS, make_pose
from dc2g_jax._src.grid.search import EIGHT_CONNECTED
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import DC2G, Frontier
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start, published_episodes
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.statistics import extra_steps
from tests import golden_sample
from tests.support.golden import SAMPLE, read_arrays, read_table
from tests.support.places import SHARED

pytestmark = pytest.mark.usefixtures("optimized")


@pytest.fixture(scope="module")
def golden_runner(golden_grids) -> Runner:
    houses = tuple(House(name, "test", terrain) for name, terrain in golden_grids.items())
    return Runner(HouseDataset("golden", "folder", houses), SETTINGS["reference"], step_limit=1500)


def test_every_recorded_episode_action_for_action(golden_runner, golden_episodes):
    columns = ("x", "y", "heading", "range", "expanding_range")
    rows = {
        (row["planner"], Start(row["house"], *(int(row[column]) for column in columns))): row for row in golden_episodes
    }
    starts = [start for planner, start in rows if planner == "frontier"]
    checked = 0
    for result in golden_runner.run(starts, ["oracle", "frontier"]):
        start = Start(result.house, result.x, result.y, result.heading, result.range, result.expanding_range)
        row = rows.get((result.planner, start))
        if row is None:  # the oracle's episodes were not recorded again for another expanding kernel
            assert result.planner == "oracle"
            continue
        checked += 1
        assert result.actions == row["actions"], row
        assert (result.success, result.steps) == (row["success"] == "1", int(row["steps"]))
        assert result.mode == "to_goal"
    assert checked == len(rows) == len(golden_episodes)


@pytest.mark.parametrize("sensing_range", [5, pytest.param(8, marks=pytest.mark.slow)])
def test_every_recorded_moment_inside_an_episode(golden_states, golden_grids, sensing_range):
    rules = SETTINGS["reference"].rules(sensing_range)
    planner = Frontier(rules)

    def look(terrain, seen, x, y, heading):
        world = World.from_terrain(terrain)
        belief = belief_of(world, make_pose(x, y, heading), jnp.int32(0), bitboard.pack(seen))
        plan, reachable = planner.plan(belief, planner.init(world))
        expanding = rules.frontier_expanding(belief, reachable)
        return plan.action, bitboard.unpack(reachable, 50), poses.unpack(expanding, 50)

    chosen = golden_states["range"] == sensing_range
    states = {name: values[chosen] for name, values in golden_states.items()}
    terrain = np.stack([golden_grids[house] for house in states["house"].tolist()])
    x, y, heading = states["x"], states["y"], states["heading"]
    actions, reachable, expanding = jax.jit(jax.vmap(look))(terrain, states["seen"], x, y, heading)

    np.testing.assert_array_equal(reachable, states["reachable"])
    wanted = np.moveaxis(states["frontier_expanding"], -1, 1).copy()
    wanted[np.arange(len(x)), heading, y, x] = False  # recorded before the current pose is taken out
    np.testing.assert_array_equal(expanding, wanted)
    assert [ACTION_LETTERS[action] for action in actions] == states["action"].tolist()


@pytest.mark.parametrize(("folder", "houses", "moments"), [(SHARED / "golden", 75, (31, 49)), (SAMPLE, 4, (6, 6))])
def test_what_is_recorded(folder, houses, moments):
    if not folder.is_dir():
        pytest.skip("../shared is absent")
    episodes, states = read_table(folder / "episodes.csv"), read_arrays(folder / "states.npz")
    assert len({row["house"] for row in episodes}) == houses
    kinds = Counter((row["planner"], row["range"], row["expanding_range"]) for row in episodes)
    a_house = {
        ("oracle", "8", "8"): 6,
        ("frontier", "8", "8"): 6,
        ("oracle", "5", "5"): 3,
        ("frontier", "5", "5"): 3,
        ("frontier", "5", "4"): 3,
    }
    assert kinds == {kind: houses * number for kind, number in a_house.items()}
    assert tuple(np.sum(states["range"] == sensing_range) for sensing_range in (5, 8)) == moments


def test_the_sample_is_that_of_what_was_recorded(shared):
    episodes, *arrays = golden_sample.sample(shared / "golden")
    assert read_table(SAMPLE / "episodes.csv") == episodes
    for name, wanted in zip(("grids.npz", "states.npz"), arrays, strict=True):
        written = read_arrays(SAMPLE / name)
        assert written.keys() == wanted.keys()
        for key, values in wanted.items():
            np.testing.assert_array_equal(written[key], values, err_msg=key)


# --- the 400 published episodes ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def published_steps(published_dataset) -> dict[str, np.ndarray]:
    """Our step counts on the authors' 400 starts, planner by planner."""
    runner = Runner(published_dataset, SETTINGS["published"])
    starts = [start for start, *_ in published_episodes()]
    results = runner.run(starts, ["oracle", "frontier", "true_cost_to_go"])
    assert all(result.success for result in results if result.planner != "frontier")
    assert all((result.range, result.expanding_range) == (5, 4) for result in results)
    names = [result.planner for result in results]
    steps = np.array([result.steps for result in results])
    return {name: steps[np.array(names) == name] for name in dict.fromkeys(names)}


@pytest.mark.slow
def test_published_step_counts_of_frontier_and_oracle(published_steps):
    episodes = published_episodes()
    frontier, oracle = np.array([(of["frontier"], of["oracle"]) for _, _, of in episodes]).T
    assert len(episodes) == 400
    assert np.sum(published_steps["frontier"] == frontier) >= 388
    assert np.sum(published_steps["oracle"] == oracle) >= 392


@pytest.mark.slow
def test_exact_cost_to_go_is_close_to_the_oracle(published_steps):
    extra = 100 * (published_steps["true_cost_to_go"] / published_steps["oracle"] - 1)
    assert np.min(extra) >= 0
    assert np.mean(extra) <= 4


@pytest.mark.slow
def test_exact_cost_to_go_over_eight_neighbors(published_dataset, published_steps):
    """The paper's 8-connected cost misjudges what a robot that moves in four directions can do, but not by much."""
    settings = SETTINGS["published"]
    planner = DC2G(ExactCostToGo(moves=EIGHT_CONNECTED), settings.rules())
    starts = [start for start, *_ in published_episodes()]
    trajectories = Runner(published_dataset, settings).trajectories(planner, settings.rules(), starts)
    extra = 100 * (trajectories.steps / published_steps["oracle"] - 1)
    assert np.mean(published_steps["true_cost_to_go"]) < np.mean(trajectories.steps)
    assert np.mean(extra) < 10


def test_the_headline_figures_follow_from_the_published_step_counts():
    steps = [of for _, _, of in published_episodes()]
    dc2g, frontier = (np.array([extra_steps(of[name], of["oracle"]) for of in steps]) for name in ("dc2g", "frontier"))
    ratio = np.array([100 * (of["frontier"] / of["dc2g"] - 1) for of in steps])
    assert np.mean(dc2g) == pytest.approx(63.5, abs=0.05)
    assert np.median(dc2g) == pytest.approx(32.4, abs=0.05)
    assert np.mean(frontier) == pytest.approx(314.9, abs=0.05)
    assert np.mean(ratio) == pytest.approx(189.8, abs=0.05)

    groups = np.array([group for _, group, _ in published_episodes()])
    by_group = {group: np.mean(dc2g[groups == group]) for group in dict.fromkeys(groups.tolist())}
    wanted = {"train": 59.3, "same_neighborhood": 56.1, "new_neighborhood": 54.3, "urban": 84.5}
    assert by_group == pytest.approx(wanted, abs=0.05)
    assert all(np.sum(groups == group) == 100 for group in wanted)
