"""Run exactly the episodes listed in a CSV file: `python -m experiments.run_episodes --starts starts.csv --out DIR`."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from dc2g_jax.cli.common import (
    DatasetOption,
    NetworkOption,
    OutOption,
    PlannersOption,
    StepLimitOption,
    check_planners,
    command_line,
    digests,
    network_for,
)
from dc2g_jax.cli.episodes import EpisodeProgress, EpisodeTable
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.houses import open_dataset
from dc2g_jax.datasets.starts import read_starts
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import Runner, as_text
from dc2g_jax.rollouts.statistics import summarize


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Run the episodes listed in a CSV file and write `episodes.csv`.

    Attributes:
      starts: CSV file with columns house,x,y,heading (0 = +x, 1 = +y, 2 = -x, 3 = -y; y grows downward) and,
        optionally, range and, for the settings `published` and `reference`, expanding_range in cells.
      planner: planners to run, by name; one of your own as package.module:Class.
      settings: rules. `published`: as the paper's 400 episodes were run, 5-cell sensing. `reference`: as the authors'
        code at any range. `paper`: as the paper's text says, 8-cell sensing. `occluded`: the same,
        but houses, trees and other tall things hide what is behind them. A range in the file wins.
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      network: folder of a trained network for `dc2g` and `dc2g_uncertain`; the shipped one where not given.
      step_limit: actions after which an episode ends without success; where not given, 500, and on
        maps of over 50 x 50 cells one action for every five cells of the map.
      out: folder to write to; a new one below outputs/ where not given.
      resume: go on with the run in `out`, begun with the same options, where it stopped.
    """

    starts: Annotated[Path, tyro.conf.arg(metavar="CSV")]
    planner: PlannersOption = ("oracle", "frontier", "dc2g")
    settings: Literal["published", "reference", "paper", "occluded"] = "paper"
    dataset: DatasetOption = None
    network: NetworkOption = None
    step_limit: StepLimitOption = None
    out: OutOption = None
    resume: bool = False


def main(options: Options) -> None:
    """Run the episodes."""
    check_planners(options.planner)
    dataset = open_dataset(options.dataset)
    starts = read_starts(options.starts, dataset)
    network = network_for(options.planner, options.network)
    runner = Runner(dataset, SETTINGS[options.settings], step_limit=options.step_limit, progress=EpisodeProgress())
    for start in starts:
        runner.rules(start)  # a range that cannot be had is refused before anything is written
    # Of the rows, which are read: an annotation or another order of columns changes nothing.
    digest = hashlib.sha256(json.dumps(starts).encode()).hexdigest()
    out = output_folder(options, "run_episodes", inputs={"starts": digest, **digests(dataset, network=network)})
    table = EpisodeTable(out / "episodes.csv")
    summaries = {}
    for planner in options.planner:
        # Two columns of each shard, since all results of long runs would not fit in memory.
        shards = table.shards(runner, starts, [planner], network)
        columns = [np.array([(one.extra, one.success) for one in shard]) for shard in shards]
        summaries[planner] = summarize(*np.concatenate(columns).T)
    print(f"houses of {dataset.name}, settings {options.settings}, episodes of each planner: {len(starts)}")
    print(as_text(summaries))
    print(f"Written: {out / 'episodes.csv'}")


if __name__ == "__main__":
    command_line(Options, main)
