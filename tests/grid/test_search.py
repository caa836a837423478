"""Shortest plans and costs-to-go against plain searches and SciPy's."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from scipy.sparse import csgraph

from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.loops import for_each_until
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.search import EIGHT_CONNECTED, FOUR_CONNECTED
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps

each_shape = pytest.mark.parametrize("shape", maps.SHAPES, ids="{0[0]}x{0[1]}".format)


@functools.cache
def searching(shape: tuple[int, int]):
    def run(x, y, heading, free, targets):
        pose, board = make_pose(x, y, heading), bitboard.pack(free)
        first = search.first_action(pose, poses.pack(targets), board)
        return first, search.distances(pose, board, shape[1])

    return jax.jit(run)


@each_shape
@given(seed=maps.seeds, density=maps.densities, target_density=st.sampled_from([0.0, 0.005, 0.02, 0.2, 1.0]))
@settings(max_examples=40)
def test_first_action_and_distances(shape, seed, density, target_density):
    free = maps.random_cells(seed, shape, density)
    free.flat[seed % free.size] = True
    pose = maps.random_pose(seed, free)
    targets = np.random.default_rng(seed + 1).random((4, *shape)) < target_density

    first, distances = searching(shape)(*pose, free, targets)

    plan = oracle.shortest_actions(free, pose, targets & free)
    assert bool(first.found) == (plan is not None)
    assert int(first.length) == len(plan or [])
    if plan:
        assert int(first.action) == plan[0]
    np.testing.assert_array_equal(distances, oracle.distances_from(free, pose))


def test_programs_for_accelerators_give_the_same(monkeypatch):
    shape = (7, 20)
    cells = [maps.random_cells(seed, shape, 0.7) for seed in range(24)]
    x, y, heading = jnp.array([maps.random_pose(seed, free) for seed, free in enumerate(cells)], jnp.int32).T
    targets = jnp.asarray(np.random.default_rng(0).random((4, *shape, len(cells))) < 0.01)
    pose, free, goals = make_pose(x, y, heading), bitboard.pack(jnp.asarray(np.stack(cells, -1))), poses.pack(targets)
    candidates = goals & ~poses.only(pose, *free.shape[:2])

    def answers():
        return jax.jit(
            lambda: (
                bitboard.flood(bitboard.single(x, y, *free.shape[:2]), free),
                search.first_action(pose, goals, free),
                search.first_headings(pose, x[::-1], y[::-1], free),
                search.nearest_headings(pose, candidates, free, shape[1]),
            )
        )()

    on_a_cpu = answers()
    for module in (bitboard, search):
        monkeypatch.setattr(module, "for_each_until", functools.partial(for_each_until, fewest_left=1))
    monkeypatch.setattr(jax.lax, "platform_dependent", lambda *operands, cpu, default: default(*operands))
    jax.tree.map(np.testing.assert_array_equal, answers(), on_a_cpu)


def test_the_plan_followed_to_its_end_is_the_lexicographically_smallest():
    shape = (8, 32)
    for seed in range(12):
        free = maps.random_cells(seed, shape, 0.75)
        pose = maps.random_pose(seed, free)
        targets = np.random.default_rng(seed).random((4, *shape)) < 0.01
        plan = oracle.shortest_actions(free, pose, targets & free)
        taken = []
        first, _ = searching(shape)(*pose, free, targets)
        while int(first.length) > 0:
            taken.append(int(first.action))
            pose = oracle.moved(pose, taken[-1], shape)
            first, _ = searching(shape)(*pose, free, targets)
        assert taken == (plan or [])


def test_a_robot_on_its_target_has_a_plan_of_no_actions():
    free = np.ones((8, 32), bool)
    first, _ = searching((8, 32))(3, 4, 1, free, np.ones((4, 8, 32), bool))
    assert bool(first.found)
    assert int(first.length) == 0


def winding_corridor() -> np.ndarray:
    free = np.zeros((33, 33), bool)
    free[::2] = True
    free[1::4, -1] = free[3::4, 0] = True
    return free


def test_the_longest_way_in_a_winding_corridor():
    free = winding_corridor()
    targets = np.zeros((4, 33, 33), bool)
    targets[:, -1, -1] = True
    first, distances = searching((33, 33))(0, 0, 2, free, targets)
    plan = oracle.shortest_actions(free, (0, 0, 2), targets)
    assert int(first.length) == len(plan) > 500
    assert int(first.action) == plan[0]
    np.testing.assert_array_equal(distances, oracle.distances_from(free, (0, 0, 2)))


def test_a_search_ends_when_its_wavefront_grows_no_more():
    free, targets = np.zeros((8, 32), bool), np.zeros((4, 8, 32), bool)
    free[0, :4] = free[7, 31] = targets[:, 7, 31] = True
    board = bitboard.pack(jnp.asarray(free))
    found, steps = search._search(
        poses.only(make_pose(0, 0, 0), *board.shape), jnp.bool_(True), board, 1,
        poses.pack(jnp.asarray(targets)), lambda reached, targets: ~poses.is_empty(reached & targets)[None],
    )  # fmt: skip
    assert not found.any()
    assert steps <= 2 * search._STEPS_BETWEEN_LOOKS


@functools.cache
def comparing(shape: tuple[int, int]):
    """Everything about one robot, or about a batch of them."""

    def run(x, y, heading, free, targets, cell_x, cell_y):
        pose, board, target_poses = make_pose(x, y, heading), bitboard.pack(free), poses.pack(targets)
        nearest, lengths = search.nearest_headings(pose, target_poses, board, shape[1])
        return {
            "first": search.first_action(pose, target_poses, board),
            "headings": search.first_headings(pose, cell_x, cell_y, board),
            "distances": search.distances(pose, board, shape[1]),
            "nearest": poses.unpack(nearest, shape[1]),
            "lengths": lengths,
        }

    return jax.jit(run)


def a_robot(seed: int, shape: tuple[int, int], density: float, target_density: float):
    """Free cells, a pose on one of them, other poses as targets, and any cell."""
    rng = np.random.default_rng(seed)
    free = maps.random_cells(seed, shape, density)
    free.flat[seed % free.size] = True
    x, y, heading = maps.random_pose(seed, free)
    targets = rng.random((4, *shape)) < target_density
    targets[heading, y, x] = False
    return x, y, heading, free, targets, int(rng.integers(shape[1])), int(rng.integers(shape[0]))


@each_shape
@given(seed=maps.seeds, density=maps.densities, target_density=st.sampled_from([0.0, 0.02, 0.5, 1.0]))
@settings(max_examples=20)
def test_nearest_and_first_headings(shape, seed, density, target_density):
    robot = a_robot(seed, shape, density, target_density)
    *pose, free, targets, cell_x, cell_y = robot
    result = comparing(shape)(*robot)
    wanted = oracle.distances_from(free, tuple(pose))

    far = np.where(targets & (wanted >= 0), wanted, np.iinfo(int).max)
    soonest = targets & (wanted >= 0) & (far == far.min(axis=0))
    np.testing.assert_array_equal(result["nearest"], soonest)
    some = soonest.any(axis=0)
    np.testing.assert_array_equal(np.asarray(result["lengths"])[some], far.min(axis=0)[some])

    at_cell = wanted[:, cell_y, cell_x]
    np.testing.assert_array_equal(result["headings"], (at_cell >= 0) & (at_cell == at_cell.min()))


@pytest.mark.parametrize("shape", [(7, 33), (12, 12), (5, 65)], ids="{0[0]}x{0[1]}".format)
def test_each_search_of_a_batch_gives_what_it_gives_alone(shape):
    """Though they all grow until the last has arrived: long and short ones, and some with nothing to find."""
    robots = [a_robot(seed, shape, (1.0, 0.65, 0.4)[seed % 3], (0.002, 0.02, 0.0)[seed % 4 % 3]) for seed in range(24)]
    batch = [np.stack(parts, axis=-1) for parts in zip(*robots, strict=True)]
    together = comparing(shape)(*batch)
    found, lengths = together["first"].found, together["first"].length
    assert {bool(value) for value in found} == {True, False}
    assert int(jnp.max(lengths)) > 8
    for number, robot in enumerate(robots):
        alone = comparing(shape)(*robot)
        jax.tree.map(lambda many, one, n=number: np.testing.assert_array_equal(many[..., n], one), together, alone)


# --- cost-to-go ---------------------------------------------------------------------------------------


@functools.cache
def costing(moves):
    return jax.jit(functools.partial(search.cost_to_go, moves=moves))


def touching(cells: np.ndarray) -> np.ndarray:
    """The cells and their eight neighbors."""
    padded = np.pad(cells, 1)
    return np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).any(axis=(2, 3))


def grown(traversable: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """The goal, grown until it touches ground that is not itself the goal; as it was where it never does."""
    ground = traversable & ~goals
    if not goals.any() or not ground.any():
        return goals
    while not (touching(goals) & ground).any():
        goals = touching(goals)
    return goals


def dijkstra(traversable: np.ndarray, goals: np.ndarray, moves) -> np.ndarray:
    """SciPy's answer on the explicit graph of cells."""
    free = traversable | goals
    index = np.arange(free.size).reshape(free.shape)
    rows, columns, lengths = [], [], []
    for y, x in np.argwhere(free):
        for dx, dy in moves:
            column, row = x + dx, y + dy
            if 0 <= column < free.shape[1] and 0 <= row < free.shape[0] and free[row, column]:
                rows.append(index[y, x])
                columns.append(index[row, column])
                lengths.append(np.hypot(dx, dy))
    if not goals.any():
        return np.full(free.shape, np.inf)
    graph = sparse.csr_matrix((lengths, (rows, columns)), shape=(free.size, free.size))
    costs = csgraph.dijkstra(graph, indices=index[goals], min_only=True)
    return costs.reshape(free.shape)


@pytest.mark.parametrize("moves", [EIGHT_CONNECTED, FOUR_CONNECTED], ids=["eight", "four"])
@pytest.mark.parametrize("shape", [(1, 40), (33, 1), (7, 33), (12, 12)], ids="{0[0]}x{0[1]}".format)
@given(seed=maps.seeds, density=maps.densities, goals=st.integers(0, 3), goals_on_ground=st.booleans())
@settings(max_examples=50)
def test_cost_to_go_equals_dijkstra(shape, moves, seed, density, goals, goals_on_ground):
    traversable = maps.random_cells(seed, shape, density)
    goal_cells = np.zeros(shape, bool)
    goal_cells.flat[np.random.default_rng(seed + 1).integers(goal_cells.size, size=goals)] = True
    traversable.flat[-1] = True
    goal_cells.flat[-1] = False
    if goals_on_ground:
        traversable |= goal_cells
    costs = np.asarray(costing(moves)(traversable, goal_cells))
    assert costs.dtype == np.float32
    wanted = dijkstra(traversable, grown(traversable, goal_cells), moves)
    np.testing.assert_allclose(costs, wanted, rtol=1e-6)


@pytest.mark.parametrize("moves", [EIGHT_CONNECTED, FOUR_CONNECTED], ids=["eight", "four"])
def test_cost_to_go_in_a_winding_corridor(moves):
    free, goals = winding_corridor(), np.zeros((33, 33), bool)
    goals[0, 0] = True
    costs = costing(moves)(free, goals)
    assert costs[-1, -1] > 500
    np.testing.assert_allclose(costs, dijkstra(free, goals, moves), rtol=1e-6)


def test_costs_to_go_on_many_maps_at_once_are_those_on_each():
    ground, goals = (
        np.stack([maps.random_cells(seed, (7, 33), share) for seed in range(3)], -1) for share in (0.7, 0.02)
    )
    together = costing(EIGHT_CONNECTED)(ground, goals)
    for number in range(3):
        alone = costing(EIGHT_CONNECTED)(ground[..., number], goals[..., number])
        np.testing.assert_array_equal(together[..., number], alone)


def test_a_goal_that_touches_no_ground_grows_until_it_does(buried):
    traversable, goals = np.isin(buried, oracle.TRAVERSABLE_CLASSES), buried == oracle.FRONT_DOOR
    costs = np.asarray(costing(EIGHT_CONNECTED)(traversable, goals))
    # Rows 1 to 5 and columns 4 to 9: three squares further, where it meets the road's first row.
    wanted = dijkstra(traversable, grown(traversable, goals), EIGHT_CONNECTED)
    np.testing.assert_allclose(costs, wanted, rtol=1e-6)
    assert np.isfinite(costs[traversable]).all()
    assert not np.isfinite(dijkstra(traversable, goals, EIGHT_CONNECTED)[5]).any()


def test_one_goal_in_touch_is_enough_to_leave_all_as_they_are():
    traversable, goals = np.zeros((7, 33), bool), np.zeros((7, 33), bool)
    traversable[0, :20] = True
    goals[0, 0] = goals[6, 32] = True
    costs = np.asarray(costing(EIGHT_CONNECTED)(traversable, goals))
    np.testing.assert_array_equal(costs[0, :20], np.arange(20))
    assert costs[6, 32] == 0
    assert np.isinf(costs).sum() == 7 * 33 - 21


@pytest.mark.parametrize("moves", [EIGHT_CONNECTED, FOUR_CONNECTED], ids=["eight", "four"])
def test_a_goal_with_no_ground_anywhere_stays_as_it_is(moves):
    goals = np.zeros((7, 33), bool)
    goals[3, 4] = True
    for traversable in (np.zeros_like(goals), goals):
        costs = np.asarray(costing(moves)(traversable, goals))
        np.testing.assert_array_equal(costs, np.where(goals, 0, np.inf))


def test_no_goal_no_cost():
    costs = costing(EIGHT_CONNECTED)(np.ones((7, 33), bool), np.zeros((7, 33), bool))
    assert np.isinf(costs).all()


def test_equal_costs_compare_equal():
    """Straight and diagonal steps are counted, so their order leaves no rounding behind."""
    traversable, goals = np.ones((33, 33), bool), np.zeros((33, 33), bool)
    goals[16, 16] = True
    costs = np.asarray(costing(EIGHT_CONNECTED)(traversable, goals))
    for turned in (costs[::-1], costs[:, ::-1], costs.T):
        np.testing.assert_array_equal(turned, costs)


def test_cost_to_go_of_real_houses_equals_dijkstra(golden_grids):
    for house in list(golden_grids)[::9]:
        terrain = golden_grids[house]
        traversable, goals = np.isin(terrain, oracle.TRAVERSABLE_CLASSES), terrain == oracle.FRONT_DOOR
        wanted = dijkstra(traversable, grown(traversable, goals), EIGHT_CONNECTED)
        np.testing.assert_allclose(costing(EIGHT_CONNECTED)(traversable, goals), wanted, rtol=1e-6)
