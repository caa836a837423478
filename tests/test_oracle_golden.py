"""The plain NumPy oracle reproduces what was recorded from the authors' own code."""

from collections.abc import Callable

import numpy as np
import pytest

from dc2g_jax._src.readers.starts import published_episodes
from tests.oracles import numpy_gridworld as oracle
from tests.support.golden import GOLDEN, SAMPLE, read_arrays

PUBLISHED = {"rules": "reference", "sensing_radius": 5, "expanding_radius": 4, "max_steps": 500}


@pytest.fixture(params=["some", pytest.param("all", marks=pytest.mark.release)])
def choose(request: pytest.FixtureRequest) -> Callable:
    """Recorded episodes, spread evenly and at most so many of them, or all."""
    return lambda rows, number: rows[:: -(-len(rows) // number) if request.param == "some" else 1]


@pytest.fixture(scope="module")
def published(golden_grids) -> list:
    """The published episodes in the recorded houses."""
    return [episode for episode in published_episodes() if episode[0].house in golden_grids]


def _pose(row: dict[str, str]) -> oracle.Pose:
    return int(row["x"]), int(row["y"]), int(row["heading"])


def test_classes_are_those_of_the_data(golden_grids) -> None:
    names = read_arrays(GOLDEN / "grids.npz")["class_names"].tolist()
    assert all(np.all(terrain != 0) for terrain in golden_grids.values())  # a seen cell of class 0 would look unseen
    assert names[oracle.FRONT_DOOR] == "front_door"
    traversable = {names[index] for index in oracle.TRAVERSABLE_CLASSES}
    assert traversable == {"front_door", "road", "driveway", "path", "sidewalk", "traversable"}


@pytest.mark.parametrize("name", ["sensing_5", "sensing_8", "expanding_4", "expanding_5", "expanding_8"])
def test_kernels(shared, name: str) -> None:
    kind, radius = name.split("_")[0], int(name.split("_")[1])
    offsets = oracle.sensing_offsets if kind == "sensing" else oracle.expanding_offsets
    sign = 1 if kind == "sensing" else -1  # the recorded expanding kernel goes from frontier cell to robot
    recorded = read_arrays(shared / "golden" / "kernels.npz")[name]
    for heading in range(4):
        kernel = np.zeros_like(recorded[heading])
        for dx, dy in offsets(radius, heading):
            kernel[radius + sign * dy, radius + sign * dx] = True
        np.testing.assert_array_equal(kernel, recorded[heading])


def test_states(golden_grids, golden_states) -> None:
    states = golden_states
    for index, house in enumerate(states["house"].tolist()):
        terrain, seen = golden_grids[house], states["seen"][index]
        x, y, heading = pose = tuple(int(states[name][index]) for name in ("x", "y", "heading"))
        free = seen & np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        reached = oracle.reachable(free, x, y)
        np.testing.assert_array_equal(reached, states["reachable"][index])
        np.testing.assert_array_equal(oracle.frontier_reference(seen), seen & (states["unseen_neighbour"][index] > 0))
        recorded = np.moveaxis(states["frontier_expanding"][index], -1, 0).copy()
        recorded[heading, y, x] = False  # recorded before the current pose is taken out
        poses = oracle.frontier_expanding_reference(seen, reached, pose, int(states["range"][index]))
        np.testing.assert_array_equal(poses, recorded)
        goals = reached & (terrain == oracle.FRONT_DOOR)
        if goals.any():
            actions = oracle.plan_to_goal(free, pose, goals, "reference")
        else:
            actions = oracle.shortest_actions(free, pose, poses)
        assert oracle.ACTION_LETTERS[actions[0]] == states["action"][index]


def test_episodes(golden_grids, golden_episodes, choose) -> None:
    for row in choose(golden_episodes, 43):
        success, actions, mode = oracle.run_episode(
            golden_grids[row["house"]],
            _pose(row),
            row["planner"],
            rules="reference",
            sensing_radius=int(row["range"]),
            expanding_radius=int(row["expanding_range"]),
            max_steps=1500,
        )
        assert (success, actions, mode) == (row["success"] == "1", row["actions"], "to_goal"), row


def test_published_step_counts(golden_grids, published, choose) -> None:
    episodes = choose(published, 11)
    agree = {"oracle": 0, "frontier": 0}
    for start, _, steps in episodes:
        for planner in agree:
            terrain, pose = golden_grids[start.house], start[1:4]
            _, actions, _ = oracle.run_episode(terrain, pose, planner, **PUBLISHED)
            agree[planner] += len(actions) == steps[planner]
    # On the recorded grids 388 and 377 of all 400 agree; most of the rest hangs on how the authors' library
    # rounded when it sampled the images (oracle: 392 on grids sampled with ties rounded down).
    if len(episodes) == 400:
        assert agree == {"oracle": 377, "frontier": 388}
    assert min(agree.values()) >= 0.9 * len(episodes)


def test_exact_cost_to_go_leads_to_the_door(golden_grids, published, choose) -> None:
    extra = []
    for start, *_ in choose(published, 11):
        terrain, pose = golden_grids[start.house], start[1:4]
        traversable = np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        costs = oracle.cost_to_go(traversable, terrain == oracle.FRONT_DOOR)
        _, shortest, _ = oracle.run_episode(terrain, pose, "oracle", **PUBLISHED)
        success, actions, _ = oracle.run_episode(terrain, pose, "dc2g", **PUBLISHED, cost_to_go=costs)
        assert success
        extra.append(100 * (len(actions) / len(shortest) - 1))
    assert min(extra) >= 0
    # The cost is 8-connected and ignores turns, the robot is not: 7.4 over all 400, 10.1 over the sample's 31.
    assert np.mean(extra) < (15 if GOLDEN == SAMPLE else 10)


def test_cost_to_go_equals_scipy(golden_grids) -> None:
    sparse = pytest.importorskip("scipy.sparse")
    csgraph = pytest.importorskip("scipy.sparse.csgraph")
    for terrain in list(golden_grids.values())[::10]:
        traversable, goals = np.isin(terrain, oracle.TRAVERSABLE_CLASSES), terrain == oracle.FRONT_DOOR
        index = np.arange(terrain.size).reshape(terrain.shape)
        links: dict[tuple[int, int], float] = {}
        for y, x in np.argwhere(traversable):
            for dx, dy in ((1, 0), (0, 1), (1, 1), (-1, 1)):
                column, row = x + dx, y + dy
                inside = 0 <= column < terrain.shape[1] and 0 <= row < terrain.shape[0]
                if inside and traversable[row, column]:
                    links[int(index[y, x]), int(index[row, column])] = np.hypot(dx, dy)
        ends = np.array(list(links)).T
        graph = sparse.csr_matrix((list(links.values()), ends), shape=(terrain.size, terrain.size))
        expected = csgraph.dijkstra(graph, directed=False, indices=index[goals], min_only=True)
        costs = oracle.cost_to_go(traversable, goals)
        np.testing.assert_allclose(costs.ravel(), np.where(traversable.ravel(), expected, np.inf), rtol=1e-12)


def test_distances_are_lengths_of_shortest_plans(golden_grids, golden_episodes) -> None:
    row = golden_episodes[0]
    free = np.isin(golden_grids[row["house"]], oracle.TRAVERSABLE_CLASSES)
    distances = oracle.distances_from(free, _pose(row))
    np.testing.assert_array_equal((distances >= 0).all(axis=0), oracle.reachable(free, *_pose(row)[:2]))
    for heading, y, x in np.argwhere(distances >= 0)[::211]:
        target = np.zeros_like(distances, bool)
        target[heading, y, x] = True
        assert len(oracle.shortest_actions(free, _pose(row), target)) == distances[heading, y, x]


def test_complete_rules_find_the_door_or_see_everything(golden_grids, published, choose) -> None:
    for start, *_ in choose(published[::4], 3):
        terrain, pose = golden_grids[start.house], start[1:4]
        settings = {"rules": "complete", "sensing_radius": 8, "expanding_radius": 8, "max_steps": 5000}
        success, _, mode = oracle.run_episode(terrain, pose, "frontier", **settings)
        assert (success, mode) == (True, "to_goal")

        nowhere = np.zeros_like(terrain, bool)
        success, actions, mode = oracle.run_episode(terrain, pose, "frontier", **settings, goals=nowhere)
        assert (success, mode) == (False, "gave_up")
        seen = oracle.visible(pose, 8, terrain.shape)
        for letter in actions:
            pose = oracle.moved(pose, oracle.ACTION_LETTERS.index(letter), terrain.shape)
            seen |= oracle.visible(pose, 8, terrain.shape)
        traversable = np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        component = oracle.reachable(traversable, *pose[:2])
        assert (component <= seen).all()
        assert not oracle.frontier_complete(seen, component).any()
