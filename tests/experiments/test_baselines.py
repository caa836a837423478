"""The programs we compare ourselves with do the same as the recorded episodes and the plain NumPy oracle."""

import stat
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.poses import ACTION_LETTERS
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.pairs import Pair
from dc2g_jax._src.training.step import learn, state_of
from experiments.baselines import c_gridworld, libraries
from experiments.baselines.problem import BaselineName, BaselineUnavailable, Outcome, Problem, make_problem
from tests.oracles import numpy_gridworld as oracle
from tests.support.maps import SHAPES, random_cells, random_pose, random_terrain

RunEpisodes = Callable[[Problem, BaselineName], Outcome]


@pytest.fixture(scope="module", params=["c", pytest.param("numba", marks=pytest.mark.slow)])
def run_episodes(request: pytest.FixtureRequest) -> RunEpisodes:
    """One of the two programs."""
    if request.param == "numba":
        pytest.importorskip("numba", reason="numba is not installed")
        from experiments.baselines import numba_gridworld

        return numba_gridworld.run_episodes
    try:
        c_gridworld.library()
    except BaselineUnavailable as reason:
        pytest.skip(str(reason))
    return c_gridworld.run_episodes


def letters(outcome: Outcome, episode: int) -> str:
    return "".join(ACTION_LETTERS[action] for action in outcome.actions[episode, : outcome.steps[episode]])


def test_recorded_episodes_action_for_action(golden_grids, golden_episodes, run_episodes):
    names, terrain = list(golden_grids), np.stack(list(golden_grids.values()))
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in golden_episodes[::3]:
        groups.setdefault((row["planner"], row["range"], row["expanding_range"]), []).append(row)
    checked = 0
    for (planner, sensing_range, expanding_range), group in groups.items():
        problem = make_problem(
            terrain,
            [names.index(row["house"]) for row in group],
            [[int(row[column]) for column in ("x", "y", "heading")] for row in group],
            sensing_range=int(sensing_range),
            expanding_range=int(expanding_range),
            step_limit=1500,
        )
        for name in (planner, "frontier_lazy")[: 1 + (planner == "frontier")]:
            outcome = run_episodes(problem, name)
            for episode, row in enumerate(group):
                result = (bool(outcome.success[episode]), letters(outcome, episode))
                assert result == (row["success"] == "1", row["actions"]), (name, row)
                assert np.all(outcome.actions[episode, outcome.steps[episode] :] == -1)
                checked += 1
    assert checked >= len(golden_episodes) // 3


def test_random_maps_as_the_oracle(run_episodes):
    endings = set()
    for seed, shape in enumerate([*SHAPES[1:], (12, 17)] * 4):
        terrain = random_terrain(seed, shape, density=(0.6, 0.8, 0.95)[seed % 3], doors=seed % 3)
        if not TRAVERSABLE[terrain].any():
            continue
        pose = random_pose(seed, TRAVERSABLE[terrain])
        radii = {"sensing": 2 + seed % 5, "expanding": 2 + seed % 4}
        problem = make_problem(
            terrain[None],
            [0],
            [pose],
            sensing_range=radii["sensing"],
            expanding_range=radii["expanding"],
            step_limit=60,
        )
        for name in ("oracle", "frontier", "frontier_lazy"):
            success, actions, mode = oracle.run_episode(
                terrain,
                pose,
                name.removesuffix("_lazy"),
                rules="reference",
                sensing_radius=radii["sensing"],
                expanding_radius=radii["expanding"],
                max_steps=60,
            )
            outcome = run_episodes(problem, name)
            assert (bool(outcome.success[0]), letters(outcome, 0)) == (success, actions), (seed, name)
            endings.add((success, mode, len(actions) == 60))
    assert {True, False} == {success for success, _, _ in endings}
    assert "gave_up" in {mode for _, mode, _ in endings}


def test_a_compiler_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(BaselineUnavailable, match="no-such-compiler"):
        c_gridworld.compiler()


def test_the_compiled_program_is_loaded_from_a_folder_of_this_user_alone(monkeypatch, tmp_path):
    built = []

    def compile_into(command, **options):
        folder = Path(command[-1]).parent
        built.append((folder, stat.S_IMODE(folder.stat().st_mode)))
        return subprocess.CompletedProcess(command, 1, stderr="stopped here")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(c_gridworld, "compiler", lambda: ["cc"])
    monkeypatch.setattr(subprocess, "run", compile_into)
    for _ in range(2):
        with pytest.raises(BaselineUnavailable, match="stopped here"):
            c_gridworld.library.__wrapped__()
    (first, mode), (second, _) = built
    assert first != second
    assert mode == 0o700
    assert not any(tmp_path.iterdir())


def test_scipy_labels_what_is_reachable():
    pytest.importorskip("scipy", reason="scipy is not installed")
    for seed in range(10):
        free = random_cells(seed, (20, 45), 0.65)
        x, y, _ = random_pose(seed, free)
        np.testing.assert_array_equal(libraries.reachable_scipy(free, x, y), oracle.reachable(free, x, y))


def test_skimage_finds_the_least_cost():
    pytest.importorskip("skimage", reason="scikit-image is not installed")
    for seed in range(10):
        terrain = random_terrain(seed, (15, 34), 0.7, doors=2)
        traversable, goals = TRAVERSABLE[terrain], terrain == FRONT_DOOR
        expected = oracle.cost_to_go(traversable, goals)
        np.testing.assert_allclose(libraries.cost_to_go_skimage(traversable, goals), expected, rtol=1e-12)
        x, y, _ = random_pose(seed, traversable)
        # Without turns a way over cells has as many steps as the forward actions of a plan at the least.
        plan = oracle.shortest_actions(traversable, (x, y, 0), np.stack([goals] * 4))
        cells = libraries.path_skimage(traversable, x, y, goals)
        assert (cells < 0) == (plan is None)
        assert plan is None or cells <= plan.count(0)
    assert plan is not None


def test_opencv_measures_straight_lines():
    goals = np.zeros((9, 12), bool)
    goals[4, 3] = True
    rows, columns = np.indices(goals.shape)
    expected = np.hypot(rows - 4, columns - 3)
    np.testing.assert_allclose(libraries.distance_opencv(goals), expected, rtol=0.03)


def test_pytorch_estimates_and_learns_the_same():
    pytest.importorskip("torch", reason="PyTorch is not installed")
    from experiments.baselines.torch_network import Network, Trainer, tensors

    generator = np.random.default_rng(0)
    config = TrainingConfig(Architecture(widths=(8, 12, 16), embedding=20), steps=20, batch_size=4)
    training, numbers = CostToGoTraining(config.recipe, DataConfig().draw_batch), config.hyperparameters
    # Some weights are zero at first.
    weights = jax.tree.map(
        lambda leaf: leaf + generator.normal(0, 0.05, leaf.shape).astype(np.float32),
        training.first_state(numbers).weights,
    )
    state, trainer = state_of(weights, training.optimizer(numbers), 0.998), Trainer(config, weights)
    weight = generator.integers(0, 3, (4, 50, 35)).astype(np.float32)
    target = np.where(weight > 0, generator.uniform(0, 100, weight.shape), np.inf).astype(np.float32)
    terrain = generator.integers(0, len(CLASS_NAMES), weight.shape).astype(np.uint8)
    pairs = Pair(*map(jnp.asarray, (terrain, target, weight)))
    of_torch = tensors(terrain, target, weight)

    estimate = trainer.network(of_torch[0]).detach().numpy()
    np.testing.assert_allclose(estimate, compact_unet.apply(config.architecture, weights, pairs.terrain), atol=1e-4)
    for _ in range(10):
        state, loss = learn(state, pairs, numbers, training=training)
        np.testing.assert_allclose(trainer(*of_torch), loss, rtol=1e-4)
    expected = Network(config.architecture, state.average).parameters()
    for mine, other in zip(expected, trainer.average, strict=True):
        np.testing.assert_allclose(mine.detach(), other, atol=1e-3)
