"""Sweeps: the grid, what can be trained together, and that together is like alone."""

import contextlib
import dataclasses
import shutil
import subprocess
import sys
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.estimation.estimators import world_cost_to_go
from dc2g_jax._src.figures.training_figures import plot_sweep
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.runtime import devices
from dc2g_jax._src.runtime.devices import mesh_for_batch, replicate
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training import sweeps
from dc2g_jax._src.training.cost_to_go import CostToGoTraining, TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from dc2g_jax._src.training.loop import Pauses, RunStates, Task, steps_left_out
from dc2g_jax._src.training.losses import LOSSES, loss_sha256, parse_losses
from dc2g_jax._src.training.pairs import TrainingSet
from dc2g_jax._src.training.step import learn, placed, stacked, supervised_step
from dc2g_jax._src.training.sweeps import Sweep, group_by_shape, named_losses, runs_of_grid, sweep
from tests.support import maps
from tests.support.compiling import compiled_count
from tests.support.houses import STREET, house
from tests.support.refusals import refusal
from tests.support.trainings import first_state

BASE = TrainingConfig(architecture=Architecture(widths=(4, 4), quantiles=(0.3, 0.7)), steps=20, batch_size=4)
DRAW = DataConfig(own_share=1.0, edge_weight=2.0, half_weight_cost=np.inf, jitter=0.0, whole_share=0.0).draw_batch


@pytest.fixture(scope="module")
def data() -> TrainingSet:
    terrain = maps.random_terrain(0, (12, 12), 0.85, doors=2)
    seen = np.stack([maps.random_cells(seed, (12, 12), 0.8) for seed in range(3)])
    return TrainingSet(
        terrain=jnp.asarray(terrain)[None],
        cost_to_go=world_cost_to_go(World.from_terrain(terrain))[None],
        masks=jax.vmap(bitboard.pack)(jnp.asarray(seen)),
        mask_world=jnp.zeros(3, jnp.int32),
        n_own=jnp.int32(3),
    )


def grid(**axes):
    whole = {"losses": ["l1"], "learning_rates": [1e-3], "widths": [BASE.architecture.widths], "seeds": [0]} | axes
    return runs_of_grid(BASE, **{**whole, "losses": named_losses(whole["losses"])[0]})


def test_losses_from_text():
    assert parse_losses("l1") == (("l1", 1.0),)
    assert parse_losses("quantile = 2, log=0.5") == (("quantile", 2.0), ("log", 0.5))


@pytest.mark.parametrize(
    ("text", "mention"),
    [
        ("l7", "give one of quantile, l1"),
        ("", "give one of quantile"),
        ("l1=zero", "'zero'; give a number above 0"),
        ("l1=-1", "above 0"),
        ("l1=", "above 0"),
        ("l1=nan", "above 0"),
        ("l1=inf", "above 0"),
        ("l1,l1=2", "twice"),
    ],
)
def test_losses_that_are_refused(text, mention):
    with pytest.raises(InputError, match=mention):
        parse_losses(text)


def test_a_grid_is_every_combination():
    losses = ["l1", "l2,log=0.5", "tests.training.test_losses:squares"]
    runs = grid(losses=losses, learning_rates=[1e-3, 2e-3], seeds=[0, 1, 2], widths=[(4,) * 4, (8,) * 4])
    assert len(runs) == 36
    assert len(set(runs.values())) == 36
    assert not any(character in name for name in runs for character in "/ ,:")


@pytest.mark.parametrize("axis", ["losses", "learning_rates", "widths", "seeds"])
def test_an_axis_without_values_or_with_one_twice_is_refused(axis):
    with pytest.raises(InputError, match="give one at least"):
        grid(**{axis: []})
    value = {"losses": "l1", "learning_rates": 1e-3, "widths": (4,) * 4, "seeds": 3}[axis]
    with pytest.raises(InputError, match="twice"):
        grid(**{axis: [value, value]})


def test_one_loss_in_two_spellings_is_refused_and_close_rates_are_not():
    with pytest.raises(InputError, match="'l1=1' is given twice"):
        grid(losses=["l1", "l1=1"])
    assert len(grid(learning_rates=[0.002, 0.0020000001])) == 2


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan")])
def test_learning_rates_that_are_refused(rate):
    with pytest.raises(InputError, match="above 0"):
        grid(learning_rates=[rate])


def test_runs_of_one_shape_go_together():
    runs = grid(losses=["l1", "l2=3"], seeds=[0, 1], widths=[(4,) * 4, (8,) * 4])
    groups = group_by_shape(runs, 64)
    assert [len(group) for group in groups] == [4, 4]
    assert {name for group in groups for name in group} == set(runs)
    for group in groups:
        assert len({config.recipe for config in group.values()}) == 1
        for name, config in group.items():
            assert {loss: weight for loss, weight in config.losses if weight} == dict(runs[name].losses)


def test_more_runs_than_fit_take_turns():
    runs = grid(seeds=range(5))
    turns = group_by_shape(runs, 2)
    assert [len(turn) for turn in turns] == [2, 2, 1]
    assert {name: config for turn in turns for name, config in turn.items()} == runs
    with pytest.raises(InputError, match="--runs-at-once 0"):
        group_by_shape(runs, 0)


@pytest.fixture
def stack(monkeypatch):
    """Runs divided among the devices, as on accelerators."""
    monkeypatch.setattr(devices, "platform", lambda mesh: "gpu")


def take_steps(data, state, hyperparameters, recipe, steps: int, runs: int = 1):
    mesh, training, losses = mesh_for_batch(recipe.batch_size, runs), CostToGoTraining(recipe, DRAW), []
    state, data = placed(state, mesh), replicate(data, mesh)
    for _ in range(steps):
        state, loss = supervised_step(state, data, hyperparameters, training=training, mesh=mesh)
        losses.append(np.asarray(loss))
    return state, np.array(losses)


def train(data, configs, steps: int, states=None):
    hyperparameters, recipe = stacked([config.hyperparameters for config in configs]), configs[0].recipe
    states = stacked([first_state(config) for config in configs]) if states is None else states
    return take_steps(data, states, hyperparameters, recipe, steps, len(configs))


@pytest.mark.slow
@pytest.mark.usefixtures("stack")
def test_together_is_like_alone(data):
    configs = list(group_by_shape(grid(losses=["l1", "l2=3"], learning_rates=[1e-3, 4e-3]), 64)[0].values())
    states, losses = train(data, configs, 5)
    for index, config in enumerate(configs):
        state, of_run = take_steps(data, first_state(config), config.hyperparameters, config.recipe, 5)
        np.testing.assert_allclose(of_run, losses[:, index], rtol=1e-4)
        alone, ours = jax.tree.leaves(state.weights), jax.tree.leaves(states.weights)
        for one, all_of_them in zip(alone, ours, strict=True):
            np.testing.assert_allclose(all_of_them[index], one, rtol=1e-3, atol=1e-5)


@pytest.mark.usefixtures("stack")
def test_runs_together_are_one_program(data):
    configs = list(group_by_shape(grid(seeds=[3, 4, 5, 6]), 64)[0].values())
    train(data, configs, 1)
    before = compiled_count(learn)
    train(data, [dataclasses.replace(config, seed=7, learning_rate=2e-3) for config in configs], 2)
    assert compiled_count(learn) == before


@pytest.mark.usefixtures("stack")
def test_stopped_and_gone_on_is_bit_for_bit_like_not_stopped(data):
    configs = list(group_by_shape(grid(seeds=[0, 1]), 64)[0].values())
    whole, _ = train(data, configs, 6)
    half, _ = train(data, configs, 2)
    again, _ = train(data, configs, 4, jax.tree.map(lambda leaf: jnp.asarray(np.array(leaf)), half))
    jax.tree.map(np.testing.assert_array_equal, whole, again)


def test_a_loss_of_no_weight_makes_no_run_diverge(data):
    config = dataclasses.replace(BASE, losses=(("l1", 1.0), ("l2", 0.0)))
    state = first_state(config)
    state = dataclasses.replace(state, weights=jax.tree.map(lambda leaf: 1e10 * leaf, state.weights))
    batch = DRAW(jax.random.key(0), data, batch_size=4)

    def loss_and_gradients(losses):
        run = dataclasses.replace(config, losses=losses)
        return jax.jit(CostToGoTraining(run.recipe, DRAW).gradient)(state, batch, run.hyperparameters)

    both, one = loss_and_gradients((("l1", 1.0), ("l2", 0.0))), loss_and_gradients((("l1", 1.0),))
    assert not np.isfinite(loss_and_gradients((("l1", 0.0), ("l2", 1.0)))[0])
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5), both, one)


@pytest.mark.usefixtures("stack")
def test_a_run_that_diverges_keeps_its_weights_and_leaves_the_others_alone(data):
    configs = list(group_by_shape(grid(seeds=[0, 1]), 64)[0].values())
    losses = tuple((name, float("nan")) for name, _ in configs[1].losses)
    configs[1] = dataclasses.replace(configs[1], losses=losses)
    states, losses = train(data, configs, 4)
    alone, _ = train(data, configs[:1], 4)
    assert np.isfinite(losses[:, 0]).all()
    assert np.isnan(losses[:, 1]).all()
    assert states.step.tolist() == [4, 4]
    assert [steps_left_out(jax.tree.map(lambda leaf, run=run: leaf[run], states)) for run in range(2)] == [0, 4]
    for one, both in zip(jax.tree.leaves(alone.weights), jax.tree.leaves(states.weights), strict=True):
        np.testing.assert_allclose(both[0], one[0], rtol=1e-3, atol=1e-5)
    first = first_state(configs[1]).weights
    jax.tree.map(lambda one, other: np.testing.assert_array_equal(one[1], other), states.weights, first)


def test_runs_go_on_from_the_newest_step_that_all_have_a_state_of(tmp_path):
    configs = list(grid(seeds=[0, 1]).values())
    states = [first_state(config) for config in configs]
    later = [state.replace(step=jnp.int32(2)) for state in states]
    training, runs = CostToGoTraining(BASE.recipe, DRAW), {str(run): config for run, config in enumerate(configs)}
    task = Task(training, None, runs, 20, lambda *args: {}, lambda *args: None)
    with contextlib.closing(RunStates(task, tmp_path)) as checkpoints:
        of_runs = checkpoints._of_runs
        of_runs[1].save(first_state(configs[1]))
        jax.tree.map(np.testing.assert_array_equal, checkpoints.restore(), states)
        assert of_runs[1].steps() == []
        checkpoints.save(later)
        of_runs[0].save(first_state(configs[0]).replace(step=jnp.int32(4)))  # killed before the other was saved
        jax.tree.map(np.testing.assert_array_equal, checkpoints.restore(), later)
        assert [each.steps() for each in of_runs] == [[2], [2]]


def own_loss(estimate, target, levels):
    """Relative error."""
    return jnp.abs(estimate - target) / (0.25 + target)


@pytest.mark.parametrize(
    ("losses", "names"),
    [
        ("l1", {"l1": (("l1", 1.0),)}),
        (["l1", "l2=1,log=0.5"], {"l1": (("l1", 1.0),), "l2=1,log=0.5": (("l2", 1.0), ("log", 0.5))}),
        (["l1", own_loss], {"l1": (("l1", 1.0),), "own_loss": (("own_loss", 1.0),)}),
        ([("mine", own_loss)], {"mine": (("mine", 1.0),)}),
        ({"mine": own_loss, "both": "l1,l2"}, {"mine": (("mine", 1.0),), "both": (("l1", 1.0), ("l2", 1.0))}),
    ],
)
def test_losses_are_names_sums_or_functions(losses, names):
    sums, own = named_losses(losses)
    assert sums == names
    assert set(own.values()) <= {own_loss}


@pytest.mark.parametrize(
    ("losses", "words"),
    [
        ([lambda *args: args[0]], "give a function of your own another name"),
        ({"l1": own_loss}, "give a function of your own another name"),
        ([3], "loss 3: give a name"),
        (["l3"], "give one of quantile, l1"),
        ([lambda estimate: estimate], "another name"),
        ({"mine": lambda estimate: estimate}, "loss 'mine': cannot be called"),
        ([own_loss, own_loss], "'own_loss' is given twice"),
    ],
)
def test_losses_that_are_none_are_refused(losses, words):
    refusal(lambda: named_losses(losses), words)


def row(run, loss, seed, error, **more):
    facts = {"learning_rate": 1e-3, "widths": "4-4", "steps": 10, "steps_left_out": 0}
    return {"run": run, "loss": loss, "seed": seed, "error": error, **facts, **more}


def test_a_sweep_is_told_by_loss_with_the_spread_over_seeds():
    table = (row("a", "l1", 0, 4.0), row("b", "l1", 1, 5.0), row("c", "l2", 0, 2.0), row("d", "l2", 1, 3.0))
    result = Sweep(table, np.array([5, 10]), np.zeros((4, 2)), {}, "")
    assert result.kinds() == {"l2": [2, 3], "l1": [0, 1]}
    assert str(result).splitlines() == [
        "loss  runs       error (cells)",
        "l2       2         2.50 ± 0.71",
        "l1       2         4.50 ± 0.71",
    ]
    diverged = dataclasses.replace(result, table=(*table[:2], row("c", "l2", 0, 2.0, steps_left_out=3), table[3]))
    assert list(diverged.kinds()) == ["l1", "l2"]
    assert "1 diverged" in str(diverged).splitlines()[2]
    faster = dataclasses.replace(result, table=(*table[:3], row("d", "l2", 1, 3.0, learning_rate=2e-3)))
    assert list(faster.kinds())[:2] == ["l2, learning rate 0.001", "l2, learning rate 0.002"]


HOUSES = HouseDataset("two", "folder", (house("street", STREET), house("lane", STREET[:, ::-1].copy(), "val")))
SMALL = {
    "config": dataclasses.replace(BASE, steps=3, batch_size=2),
    "data": DataConfig(extra_houses=0, starts_per_house=1, ranges=(3,)),
    "widths": [(4, 4)],
}


def sweep_houses(out, **options):
    return sweep(out, HOUSES, **{"losses": ["l1", own_loss], "seeds": [0, 1, 2], "split": None, **SMALL, **options})


@pytest.mark.slow
def test_a_sweep_gives_arrays_and_goes_on_where_it_was(tmp_path):
    whole = sweep_houses(tmp_path / "whole", track="tensorboard")
    assert whole.curves.shape == (6, len(whole.steps))
    assert np.all(np.isfinite(whole.curves))
    assert whole.steps[-1] == 3
    assert set(whole.kinds()) == {"l1", "own_loss"}
    assert len(str(whole).splitlines()) == 3
    plot_sweep(whole, tmp_path / "curves")
    assert (tmp_path / "curves.png").stat().st_size > 0
    assert list(whole.networks) == [one["run"] for one in whole.table]
    assert {path.name for path in (tmp_path / "whole" / "tensorboard").iterdir()} == set(whole.networks)
    in_turn = sweep_houses(tmp_path / "in_turn", runs_at_once=4)
    np.testing.assert_allclose(in_turn.curves, whole.curves, rtol=1e-3)
    for run, network in whole.networks.items():
        kept = network_in_folder(tmp_path / "whole" / "runs" / run / "network")
        jax.tree.map(np.testing.assert_array_equal, kept.weights, network.weights)
        other = in_turn.networks[run].weights
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-3, atol=1e-5), other, network.weights)
    # A turn that is done is not opened again; a network that is gone comes back.
    *first, _, last = whole.networks
    for run in first[:4]:
        shutil.rmtree(tmp_path / "in_turn" / "runs" / run / "states" / "3")
        (tmp_path / "in_turn" / "runs" / run / "states" / "3").mkdir()
    shutil.rmtree(tmp_path / "in_turn" / "runs" / last / "network")
    again = sweep_houses(tmp_path / "in_turn", runs_at_once=4)
    jax.tree.map(np.testing.assert_array_equal, again.networks, in_turn.networks)
    other_data = {"data": dataclasses.replace(SMALL["data"], data_seed=1)}
    refusal(lambda: sweep_houses(tmp_path / "in_turn", **other_data), "data_seed was 0")


def test_a_loss_of_ones_own_that_was_edited_is_not_gone_on_with(tmp_path, monkeypatch):
    for name in ("validation_pairs", "open_training_set"):
        monkeypatch.setattr(sweeps, name, lambda *args, **options: None)
    monkeypatch.setattr(sweeps, "train_runs", mock.Mock(side_effect=KeyboardInterrupt))

    def begin_with(bend):
        def mine(estimate, target, levels):
            return jnp.abs(estimate - target) / (bend + jax.nn.relu(target))

        sweep_houses(tmp_path, losses={"mine": mine})

    for bend in (np.arange(1, 6), np.arange(1, 6)):  # the second is the same function, written anew
        with pytest.raises(KeyboardInterrupt):
            begin_with(bend)
    for bend in (0.5, np.arange(2, 7)):
        refusal(lambda bend=bend: begin_with(bend), "losses_sha256: mine was", "give the same options to resume it")


def test_the_digest_of_a_loss_is_the_same_in_every_process():
    code = "from tests.training.test_sweeps import own_loss, loss_sha256; print(loss_sha256(own_loss))"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert other == loss_sha256(own_loss) != loss_sha256(LOSSES["l1"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"losses": ["l3"]}, "l3"),
        ({"seeds": []}, "seed: no value to try"),
        ({"split": "valid"}, "no split is called 'valid'"),
        ({"runs_at_once": 0}, "--runs-at-once 0"),
        ({"pauses": Pauses(-1)}, "--validate-every -1"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused_before_anything_is_written(tmp_path, options, words):
    refusal(lambda: sweep_houses(tmp_path / "new", **options), words)
    assert not (tmp_path / "new").exists()
