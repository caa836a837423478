"""Run the episodes listed in a CSV file: `dc2g run --starts starts.csv --out DIR`."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from dc2g_jax._src.cli.common import FieldOfViewOption, PlannersOption, SettingsOption, check_planners, digests
from dc2g_jax._src.cli.episodes import EpisodeTable, NetworksOptions
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions, ResumeOptions, StepLimitOptions
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.planning.planners import GAVE_UP, MODE_NAMES
from dc2g_jax._src.planning.rules import named_settings
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import read_starts
from dc2g_jax._src.rollouts.evaluation import Runner, by_name
from dc2g_jax._src.rollouts.results import as_text
from dc2g_jax._src.rollouts.statistics import summarize
from dc2g_jax._src.runtime.progress import EpisodeProgress


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworksOptions, StepLimitOptions, OutOptions, ResumeOptions):
    """Run the episodes listed in a CSV file and write `episodes.csv`.

    Attributes:
      starts: CSV file with columns house,x,y,heading (0 = +x, 1 = +y, 2 = -x, 3 = -y; y grows downward) and,
        optionally, range and, for the settings `published` and `reference`, expanding_range in cells.
      planner: planners to run; package.module:Name for one of your own.
      settings: rules. `published`: those of the paper's 400 episodes, 5-cell sensing. `reference`: those of the
        authors' code, any range. `paper`: those of the paper's text, 8-cell sensing. `occluded`: the same, but houses,
        trees and other tall objects hide what is behind them. package.module:Name for `Settings` of your own. A range
        in the file takes precedence.
      field_of_view: width of the robots' field of view in degrees, up to 360; for `published` and `reference` 90 only.
    """

    starts: Annotated[Path, tyro.conf.arg(metavar="CSV")]
    planner: PlannersOption = ("oracle", "frontier", "dc2g")
    settings: SettingsOption = "paper"
    field_of_view: FieldOfViewOption = None


def main(options: Options) -> None:
    """Run the episodes."""
    check_planners(options.planner)
    dataset = open_dataset(options.dataset)
    starts = read_starts(options.starts, dataset)
    network = options.open(options.planner)
    settings = named_settings(options.settings, options.field_of_view)
    runner = Runner(dataset, settings, step_limit=options.step_limit, progress=EpisodeProgress())
    for start in starts:
        runner.rules(start)  # an invalid range raises before anything is written
    # The digest is of the parsed rows, so annotations and the order of columns do not matter.
    digest = hashlib.sha256(json.dumps(starts).encode()).hexdigest()
    out = output_folder(options, "run_episodes", inputs={"starts": digest, **digests(dataset, network=network)})
    table = EpisodeTable(out / "episodes.csv")
    summaries, without_door = {}, []
    for planner, source in by_name(options.planner, network).items():
        # Few columns of each shard, since all results of long runs would not fit in memory.
        shards = table.shards(runner, starts, {planner: source})
        columns = [
            np.array([(one.extra, one.success, one.mode == MODE_NAMES[GAVE_UP], one.steps) for one in shard], float)
            for shard in shards
        ]
        extra, success, gave_up, steps = np.concatenate(columns).T
        no_door = np.isnan(extra)  # `None` in the results
        if not np.all(no_door):
            summaries[planner] = summarize(extra[~no_door], success[~no_door])
        if np.any(no_door):
            without_door.append((planner, f"{100 * np.mean(gave_up[no_door]):.1f}", f"{np.mean(steps[no_door]):.1f}"))
    print(f"houses of {dataset.name}, settings {options.settings}, episodes of each planner: {len(starts)}")
    if summaries:
        print(as_text(summaries))
    if without_door:
        print(f"no door can be reached from {np.sum(no_door)} of these starts, left out of extra steps and success:")
        print(text_table(("planner", "gave up %", "steps: mean"), without_door))
    print(f"Written to {out / 'episodes.csv'}")
