"""The command is a call of `dc2g_jax.sweep`."""

import pytest

from dc2g_jax._src.cli.commands.sweep import Options
from dc2g_jax._src.training.cost_to_go_data import DataConfig
from experiments import sweep_losses
from tests.support.refusals import refusal


def test_options_are_the_arguments_of_the_function(tmp_path):
    arguments = Options(out=tmp_path, losses=("l1",), widths=("4,8", "16,32"), steps=7, validate_every=3).arguments()
    assert (arguments["losses"], arguments["widths"]) == (("l1",), [(4, 8), (16, 32)])
    assert (arguments["config"].steps, arguments["pauses"].validate_every) == (7, 3)
    refusal(lambda: Options(out=tmp_path, widths=("4,x",)).arguments(), "widths: 4,x", "24,48,96")


@pytest.mark.slow
def test_the_experiment_sweeps_all_losses_in_procedural_houses(tmp_path, capsys):
    options = sweep_losses.Options(
        out=tmp_path / "losses", seeds=(0,), widths=("4,4",), steps=6, batch_size=2, split=None,
        data=DataConfig(extra_houses=0, starts_per_house=1, ranges=(8,)),
    )  # fmt: skip
    sweep_losses.main(options)
    printed = capsys.readouterr().out
    for loss in ("quantile", "l1", "l2", "huber", "log"):
        assert loss in printed
    assert (tmp_path / "losses" / "sweep.png").stat().st_size > 0
