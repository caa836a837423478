"""What a sweep makes of its log."""

import csv
import dataclasses

import jax
import numpy as np
import pytest

from dc2g_jax._src.cli.commands.sweep import Options, kind_of, network_folder, train_group, write_results
from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.files.tables import read_table
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.loop import Log
from dc2g_jax._src.training.sweeps import group_by_shape, in_turns
from tests.support.trainings import DRAW_PAIRS, training_set


def test_runs_that_diverged_come_last(tmp_path):
    runs = {name: dataclasses.replace(TrainingConfig(), seed=seed) for seed, name in enumerate("abc")}
    log = Log(tmp_path)
    for step, left_out in ((10, (0, 1, 0)), (20, (0, 3, 0))):
        log.write(
            *(
                {"run": run, "step": step, "loss": None, "error": error - step, "steps_left_out": count}
                for run, count, error in zip(runs, left_out, (50, 30, 40), strict=True)
            )
        )
    write_results(tmp_path, runs, log, {}, (50, 50))
    with (tmp_path / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["run"], row["diverged"], row["error"], row["steps"]) for row in rows] == [
        ("c", "0", "20", "20"), ("a", "0", "30", "20"), ("b", "1", "10", "20"),
    ]  # fmt: skip


def test_runs_are_of_a_kind_where_only_the_seed_differs(tmp_path):
    architecture = Architecture(widths=(4, 8, 8, 8))
    config = TrainingConfig(architecture=architecture, losses=(("l1", 1.0), ("log", 0.5)), learning_rate=2e-3)
    other_seed = dataclasses.replace(config, seed=7)
    options = Options(out=tmp_path)
    assert kind_of(options, config) == kind_of(options, other_seed) == "l1 + 0.5 log"
    options = Options(out=tmp_path, learning_rates=(1e-3, 2e-3), widths=("4,8,8,8", "4,4,4,4"))
    assert kind_of(options, config) == "l1 + 0.5 log, rate 0.002, widths 4-8-8-8"


@pytest.mark.slow
def test_runs_that_wait_their_turn_end_like_runs_trained_together(tmp_path):
    data = training_set()
    pairs = DRAW_PAIRS(jax.random.key(0), data, batch_size=64)

    def weights(out, at_once, turns=slice(None), track=None):
        options = Options(
            out=out, track=track, losses=("l1",), widths=("4,4,4,4",), steps=3, batch_size=4, seeds=(0, 1, 2)
        )
        (group,) = group_by_shape(options.runs(50))
        for turn in in_turns(group, at_once)[turns]:
            train_group(options, turn, data, pairs, {})
        return [network_in_folder(network_folder(out, run)).weights for run in group] if turns == slice(None) else None

    together = weights(tmp_path / "together", 64, track="tensorboard")
    in_turn = weights(tmp_path / "in_turn", 2)
    curves = [
        read_table(tmp_path / name / "curve.csv", ("run", "step", "loss"), remedy="")
        for name in ("together", "in_turn")
    ]
    runs = {path.name for path in (tmp_path / "together" / "runs").iterdir()}
    for curve in curves:
        assert [(row["run"], row["step"]) for _, row in curve] == [(run, "3") for run in sorted(runs)]
    losses = np.array([[float(row["loss"]) for _, row in curve] for curve in curves])
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-3)
    assert len(set(losses[0])) == 3
    assert {path.name for path in (tmp_path / "together" / "tensorboard").iterdir()} == runs
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-5), together, in_turn)
    out = tmp_path / "resumed"
    weights(out, 2, slice(1))
    for state in out.glob("runs/*/config.json"):  # a turn that is done is not opened again
        state.write_text("{}")
    resumed = weights(out, 2)
    jax.tree.map(np.testing.assert_array_equal, in_turn, resumed)
