"""Train networks with many losses, weights, learning rates, widths and seeds: `dc2g sweep`.

Runs whose networks have the same shape are trained together and divided among the devices, `--runs-at-once` at a time.
After an interruption, --resume continues where it stopped.
"""

import dataclasses
from typing import Any, Literal

import jax

from dc2g_jax._src.cli.common import digests
from dc2g_jax._src.cli.options import DataOptions, DatasetOptions, OptionalInt, TrainingOptions
from dc2g_jax._src.cli.outputs import command_written, commit, output_folder
from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.figures.training_figures import plot_sweep
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.loop import Pauses
from dc2g_jax._src.training.losses import LOSSES
from dc2g_jax._src.training.sweeps import SWEEP, Sweep, sweep
from dc2g_jax._src.viewer.training_recording import maps_to_watch, prediction_picture


@dataclasses.dataclass(frozen=True)
class Options(Pauses, DatasetOptions, TrainingOptions, DataOptions):
    """Train every combination of losses, learning rates, widths and seeds, together where shapes allow.

    Attributes:
      losses: losses to try: quantile, l1, l2, huber, log, package.module:Name for one of your own, or weighted sums of
        them such as quantile=1,log=0.5.
      architecture: compact_unet, or package.module:Name for a network of your own, a subclass of flax.nnx.Module.
      learning_rates: peak learning rates to try.
      widths: networks to try, each given by its channels from the finest scale: 24,48,96 16,32,64,128 are two.
      seeds: seeds to try.
      steps: optimizer steps of each run.
      batch_size: pairs per step of each run.
      split: split of the houses to run the planner dc2g in at the end, with every network; None for no episodes.
      runs_at_once: largest number of runs to train together; best a multiple of the number of devices. It may change
        when the sweep is resumed.
    """

    losses: tuple[str, ...] = tuple(LOSSES)
    architecture: str = Architecture.network
    learning_rates: tuple[float, ...] = (SWEEP.learning_rate,)
    widths: tuple[str, ...] = (",".join(map(str, Architecture.widths)),)
    seeds: tuple[int, ...] = (0, 1, 2)
    steps: int = SWEEP.steps
    batch_size: int = SWEEP.batch_size
    validate_every: OptionalInt = None
    split: Literal["train", "val", "test"] | None = "val"
    runs_at_once: int = 64

    def arguments(self) -> dict[str, Any]:
        """The arguments for `sweep`.

        Raises:
          InputError: a value is invalid.
        """
        try:
            widths = [tuple(int(width) for width in text.split(",")) for text in self.widths]
        except ValueError:
            raise InputError(f"widths: {' '.join(self.widths)}; give whole numbers such as 24,48,96") from None
        return {
            **{name: getattr(self, name) for name in ("losses", "seeds", "learning_rates", "split", "runs_at_once")},
            "widths": widths,
            "config": TrainingConfig(
                Architecture(network=self.architecture), steps=self.steps, batch_size=self.batch_size
            ),
            "data": self.data,
            "pauses": Pauses(self.validate_every, self.minutes_per_checkpoint),
            "track": self.track,
        }


def run_sweep(options: Options, dataset: HouseDataset, command: str) -> Sweep:
    """Train and validate all runs of a command; write, plot and print the results."""

    def begin() -> None:
        output_folder(options, command, free=("minutes_per_checkpoint", "runs_at_once"), inputs=digests(dataset))
        if options.track is not None:
            maps_to_watch(dataset)  # raises before minutes of other work

    result = sweep(
        options.out, dataset, **options.arguments(), card={"command": command_written(), "commit": commit()},
        picture=None if options.track is None else lambda network: prediction_picture(network, maps_to_watch(dataset)),
        begin=begin,
    )  # fmt: skip
    if jax.process_index() == 0:
        plot_sweep(result, options.out / "sweep")
    print(f"{result}\nWritten to {options.out / 'results.csv'}")
    return result


def main(options: Options) -> None:
    """Train and validate all runs; write, plot and print the results."""
    run_sweep(options, open_dataset(options.dataset), "sweep")
