"""The paper's Fig. 8: planners side by side from one start in a house they have not seen.

`python -m experiments.reproduce_fig8` draws what each planner observed, the cost-to-go it expected, and its path.
"""

import dataclasses

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.map_options import start_in
from dc2g_jax._src.cli.one_start import OneStartOptions, run_one_start
from dc2g_jax._src.cli.options import DatasetOptions
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import Start, sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.progress import EpisodeProgress
from experiments.support.commands import HouseOption


@dataclasses.dataclass(frozen=True)
class Options(OneStartOptions, DatasetOptions):
    """Reproduce Fig. 8: what planners observed and expected from one start, and their paths on the whole map.

    The paper does not name its house, and its episode (98 and 304 steps) is not among the 400 published ones. If no
    house is named, one start is sampled in every test house, and the figure shows the start from which the oracle needs
    the median number of steps. It is chosen before any other planner is run.

    Attributes:
      house: name of the house; chosen as above by default. `start` is a start in this house.
    """

    house: HouseOption = None


def median_start(dataset: HouseDataset, seed: int) -> Start:
    """The start with the median number of oracle steps, of one sampled start in each test house.

    Of two medians, it is the lower one.

    Raises:
      InputError: no episode can be run in any test house.
    """
    starts = sample_starts(usable_houses(dataset, "test", instead="name another --house"), 1, seed=seed)
    results = Runner(dataset, SETTINGS["paper"], progress=EpisodeProgress()).run(starts, ("oracle",))
    order = sorted(range(len(starts)), key=lambda number: (results[number].steps, starts[number].house))
    return starts[order[(len(order) - 1) // 2]]


def main(options: Options) -> None:
    """Choose the start, run the planners, write their files."""
    dataset = open_dataset(options.dataset)
    if options.house is None and options.start is not None:
        raise InputError("--start: in which house? give --house as well")
    if options.house is None:
        start = median_start(dataset, options.seed)
    else:
        start = start_in(options.house, dataset.house(options.house), options.start, options.seed)
    run_one_start(options, "reproduce_fig8", "fig8", dataset.house(start.house), start)


if __name__ == "__main__":
    command_line(Options, main)
