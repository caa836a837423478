"""Run planners from one start, then write their table, figures, animations and recordings."""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from tqdm import tqdm

from dc2g_jax._src.cli.common import FieldOfViewOption, PlannersOption, SettingsOption, check_planners, network_for
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.map_options import StartOption
from dc2g_jax._src.cli.options import NetworkOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.figures.animation import animate
from dc2g_jax._src.figures.episode_figures import plot_episode, plot_trajectories
from dc2g_jax._src.figures.replay import replay_result
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.planning.planners import GAVE_UP, MODE_NAMES
from dc2g_jax._src.planning.rules import Rules, named_settings
from dc2g_jax._src.readers.houses import House, HouseDataset
from dc2g_jax._src.readers.starts import Start, why_no_start
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax._src.viewer.recording import record_episode

#: Bytes that the replay of an episode needs per cell and step, and the limit for all replays together.
_REPLAY_BYTES, _MOST_BYTES = 45, 6e9


@dataclasses.dataclass(frozen=True, kw_only=True)
class OneStartOptions(NetworkOptions, OutOptions):
    """One episode, run by several planners.

    Attributes:
      start: column, row (growing downward) and heading (0 right, 1 down, 2 left, 3 up); sampled by default, on the road
        where there is one.
      seed: seed of the sampled start.
      planner: planners to run besides the oracle, in the order of the figures; package.module:Name for one of your
        own.
      settings: rules, as in dc2g run; `occluded`: walls and other tall objects hide what is behind them.
      sensing_range: number of cells that a robot sees ahead.
      field_of_view: width of the robots' field of view in degrees, as in dc2g run.
      animation: formats of the animation.
      no_figures: draw no figures and no animation, which take most of the time on large maps.
      no_record: write no rerun recording, which takes most of the space on large maps.
    """

    start: StartOption = None
    seed: int = 0
    planner: PlannersOption = ("dc2g", "frontier")
    settings: SettingsOption = "paper"
    sensing_range: int = 8
    field_of_view: FieldOfViewOption = None
    animation: tuple[Literal["gif", "mp4"], ...] = ("gif",)
    no_figures: bool = False
    no_record: bool = False


def run_one_start(
    options: OneStartOptions,
    command: str,
    name: str,
    house: House,
    start: Start,
    *,
    step_limit: int | None = None,
    warnings: Sequence[str] = (),
) -> None:
    """Run the oracle and the planners from one start, print their results and write all files.

    Where no goal can be reached, the planners explore until they give up, and the reason is printed.

    The sensing range comes from the options, not from the start. Figure, animation and recording are called `name`.

    Raises:
      InputError: a planner is unknown, the network or the output folder cannot be used, the step limit is less than 1,
        or not even the oracle reaches a goal in reach within it.
    """
    start = start._replace(sensing_range=options.sensing_range)
    check_planners(options.planner)
    network = network_for(options.planner, options.network)
    dataset = HouseDataset(house.name, "folder", (house,))
    settings = named_settings(options.settings, options.field_of_view)
    runner = Runner(dataset, settings, step_limit=step_limit, progress=EpisodeProgress())
    rules = runner.rules(start)
    out = output_folder(options, command)
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    planners = list(dict.fromkeys(("oracle", *options.planner)))
    results = EpisodeTable(out / "episodes.csv").run(runner, [start], planners, network)
    _print_results(results, house, runner.step_limit)
    if results[0].oracle_steps is None:
        print(why_no_start(start, house))
    _draw(out, name, options, house, {result.planner: result for result in results}, rules, network)
    print_files(out)


def _print_results(results: Sequence[EpisodeResult], house: House, limit: int) -> None:
    first = results[0]
    height, width = house.terrain.shape
    print(
        f"{house.name}: {width} x {height} cells, {first.range}-cell sensing, start at column {first.x}, "
        f"row {first.y}, heading {('right', 'down', 'left', 'up')[first.heading]}"
    )
    rows = []
    for result in results:
        outcome = "reached the goal" if result.success else f"stopped at the limit of {limit} steps"
        if not result.success and result.mode == MODE_NAMES[GAVE_UP]:
            reachable = result.oracle_steps is not None
            outcome = f"gave up: {'nothing left to explore' if reachable else 'no door can be reached from this start'}"
        extra = "" if result.extra is None else f"{result.extra:.1f} %"
        if result.planner == "oracle":
            extra = "knows the map"
        rows.append((result.planner, f"{result.steps:,}", extra, outcome))
    print(text_table(("planner", "steps", "extra steps", "outcome"), rows))


def _draw(
    out: Path,
    name: str,
    options: OneStartOptions,
    house: House,
    results: Mapping[str, EpisodeResult],
    rules: Rules,
    network: Estimator | None,
) -> None:
    """Write the figures, animations and recording of the episodes in `results`, given by planner."""
    figures, record = not options.no_figures, not options.no_record
    if figures:
        plot_trajectories(out / "trajectories", house, results)
    if not (figures or record):
        return
    chosen = _replayable({planner: results[planner] for planner in options.planner}, house.terrain.size)
    if not chosen:
        return
    animations = options.animation if figures else ()
    total = len(chosen) + len(animations) + figures + record
    with tqdm(total=total, desc=f"{'drawing':>16}", unit="file", file=sys.stderr) as bar:
        frames = {}
        for planner, result in chosen.items():
            frames[planner] = replay_result(result, house, rules, network)
            bar.update()
        if figures:
            plot_episode(out / name, house, frames)
            bar.update()
        for extension in animations:
            animate(out / f"{name}.{extension}", house, frames)
            bar.update()
        if record:
            record_episode(out / f"{name}.rrd", house=house, result_by_planner=chosen, frames_by_planner=frames)
            bar.update()


def _replayable(results: Mapping[str, EpisodeResult], cells: int) -> dict[str, EpisodeResult]:
    """The episodes that fit into memory when replayed. The longest are left out, with a message."""
    kept = dict(results)
    while sum(result.steps + 1 for result in kept.values()) * cells * _REPLAY_BYTES > _MOST_BYTES:
        longest = max(kept, key=lambda planner: kept[planner].steps)
        print(
            f"{longest}: {kept[longest].steps:,} steps on {cells:,} cells are too many to be replayed: left out of the "
            "figure, the animation and the recording; a coarser grid (--cells) takes less memory",
            file=sys.stderr,
        )
        del kept[longest]
    return kept
