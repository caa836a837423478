"""Compare the losses of the cost-to-go network, three seeds each: `python -m experiments.sweep_losses --out DIR`.

It is `dc2g sweep` with defaults for a trial. After an interruption, --resume continues where it stopped.
"""

import dataclasses

from dc2g_jax._src.cli.commands import sweep
from dc2g_jax._src.cli.commands.sweep import run_sweep
from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.readers.houses import PROCEDURAL, open_dataset


@dataclasses.dataclass(frozen=True)
class Options(sweep.Options):
    """Train a small network with every loss and three seeds, on procedural houses, and compare them.

    Attributes:
      dataset: see `dc2g sweep`.
      steps: optimizer steps of each run.
      batch_size: pairs per step of each run.
    """

    dataset: str | None = PROCEDURAL
    steps: int = 1000
    batch_size: int = 16


def main(options: Options) -> None:
    """Train and validate all runs; write, plot and print the results."""
    run_sweep(options, open_dataset(options.dataset), "sweep_losses")


if __name__ == "__main__":
    command_line(Options, main)
