"""Planners from one start: run, put in a table, drawn, animated and recorded; for commands that look at one start."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from tqdm import tqdm

from dc2g_jax.cli.common import check_planners, network_for
from dc2g_jax.cli.episodes import EpisodeProgress, EpisodeTable
from dc2g_jax.datasets.houses import House, HouseDataset
from dc2g_jax.datasets.starts import Start
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.checkpoints import TrainedNetwork
from dc2g_jax.grid.sensing import MAX_SENSING_RANGE
from dc2g_jax.inspection.animation import animate
from dc2g_jax.inspection.episode_figures import plot_episode, plot_trajectories
from dc2g_jax.inspection.recording import RecordedEpisode, record_frames
from dc2g_jax.inspection.replay import replay_result
from dc2g_jax.planning.planners import GAVE_UP, MODE_NAMES
from dc2g_jax.planning.rules import SETTINGS
from dc2g_jax.rollouts.evaluation import EpisodeResult, Runner

#: Bytes that the replay of an episode takes for a cell and a step, and the most that all replays may take.
_REPLAY_BYTES, _MOST_BYTES = 45, 6e9

Animation = Literal["gif", "mp4"]


class Request(NamedTuple):
    """What to run.

    Attributes:
      house: where.
      start: from which pose, with which sensing range.
      planners: names, in the order of the figures.
      network: what planners on a network go by; `None` where none of them does.
      runner: runs them, by the rules of the paper's text.
    """

    house: House
    start: Start
    planners: Sequence[str]
    network: TrainedNetwork | None
    runner: Runner


def make_request(
    house: House, start: Start, planners: Sequence[str], network: Path | None, step_limit: int | None = None
) -> Request:
    """What is asked for, once it is sure that it can be run.

    Args:
      house: where.
      start: from which pose, with which sensing range.
      planners: names, in the order of the figures.
      network: folder of the network, `None` for the shipped one.
      step_limit: actions after which an episode ends without success; `None` for as many as suit the map's size.

    Raises:
      InputError: a planner is unknown, the network cannot be read, or the step limit is less than 1.
    """
    check_planners(planners)
    loaded = network_for(planners, network)
    dataset = HouseDataset(house.name, "folder", (house,))
    runner = Runner(dataset, SETTINGS["paper"], step_limit=step_limit, progress=EpisodeProgress())
    return Request(house, start, planners, loaded, runner)


def require_sensing_range(cells: int) -> int:
    """Refuse a sensing range that no kernel has."""
    if not 1 <= cells <= MAX_SENSING_RANGE:
        raise InputError(f"--sensing-range {cells}: give 1 to {MAX_SENSING_RANGE} cells")
    return cells


def run_request(request: Request, table: EpisodeTable) -> dict[str, EpisodeResult]:
    """Run the oracle and the planners, and print their results.

    Returns:
      Planner -> its episode, the oracle first.

    Raises:
      InputError: if not even the oracle reaches a goal within the step limit.
    """
    names = list(dict.fromkeys(("oracle", *request.planners)))
    results = table.run(request.runner, [request.start], names, request.network)
    _print_results(results, request.house, request.runner.step_limit)
    return {result.planner: result for result in results}


def _print_results(results: Sequence[EpisodeResult], house: House, limit: int) -> None:
    first = results[0]
    height, width = house.terrain.shape
    print(
        f"{house.name}: {width} x {height} cells, {first.range}-cell sensing, start at column {first.x}, "
        f"row {first.y}, heading {('right', 'down', 'left', 'up')[first.heading]}"
    )
    width = max(16, *(len(result.planner) + 1 for result in results))
    print(f"{'planner':{width}}{'steps':>8}{'extra steps':>14}   outcome")
    for result in results:
        outcome = "reached the goal" if result.success else f"stopped at the limit of {limit} steps"
        if not result.success and result.mode == MODE_NAMES[GAVE_UP]:
            outcome = "gave up: nothing left to explore"
        extra = "knows the map" if result.planner == "oracle" else f"{result.extra:.1f} %"
        print(f"{result.planner:{width}}{result.steps:>8,}{extra:>14}   {outcome}")


def draw_request(
    out: Path, name: str, request: Request, results: dict[str, EpisodeResult], animations: Sequence[Animation]
) -> None:
    """Write the figure, the ways on the map, the animations and the recording of an episode.

    Args:
      out: folder to write to.
      name: of the files, without an ending.
      request: what was run.
      results: planner -> its episode.
      animations: formats of the animation.
    """
    plot_trajectories(out / "trajectories", request.house, results)
    chosen = _replayable({planner: results[planner] for planner in request.planners}, request.house.terrain.size)
    if not chosen:
        return
    rules = SETTINGS["paper"].rules(request.start.sensing_range)
    bar = tqdm(total=len(chosen) + len(animations) + 2, desc=f"{'drawing':>16}", unit="file", file=sys.stderr)
    episodes = {}
    for planner, result in chosen.items():
        episodes[planner] = RecordedEpisode(result, replay_result(result, request.house, rules, request.network))
        bar.update()
    frames = {planner: episode.frames for planner, episode in episodes.items()}
    plot_episode(out / name, request.house, frames)
    bar.update()
    for ending in animations:
        animate(out / f"{name}.{ending}", request.house, frames)
        bar.update()
    record_frames(out / f"{name}.rrd", house=request.house, episodes=episodes)
    bar.update()
    bar.close()


def _replayable(results: Mapping[str, EpisodeResult], cells: int) -> dict[str, EpisodeResult]:
    """The episodes that can be replayed in the memory there is; the longest are left out, with a line."""
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


def tell_files(out: Path) -> None:
    """Print what has been written."""
    print(f"Written to {out}: {', '.join(sorted(path.name for path in out.iterdir()))}")
    for recording in out.glob("*.rrd"):
        print(f"Step through it: rerun {recording}")
