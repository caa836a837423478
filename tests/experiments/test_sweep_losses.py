"""What a sweep makes of its log."""

import csv
import dataclasses

from dc2g_jax.estimation.training import TrainingConfig
from experiments.sweep_losses import write_results
from experiments.training_loop import Log


def test_runs_that_diverged_come_last(tmp_path):
    runs = {name: dataclasses.replace(TrainingConfig(), seed=seed) for seed, name in enumerate("abc")}
    log = Log(tmp_path)
    for step, losses in ((10, (0.5, float("nan"), 0.25)), (20, (0.25, None, None))):
        log.write(
            *(
                {"run": run, "step": step, "loss": loss, "error": error - step}
                for run, loss, error in zip(runs, losses, (50, 30, 40), strict=True)
            )
        )
    write_results(tmp_path, runs, log, {}, (50, 50))
    with (tmp_path / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["run"], row["diverged"], row["error"], row["steps"]) for row in rows] == [
        ("c", "0", "20", "20"), ("a", "0", "30", "20"), ("b", "1", "10", "20"),
    ]  # fmt: skip
