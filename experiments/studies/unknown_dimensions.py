"""Measure the effect of unknown map dimensions: `python -m experiments.studies.unknown_dimensions`.

The network of DC2G sees the whole map, a rescaled crop of the observed cells, or a window around the robot. Everything
else, including the starts, is the same.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from dc2g_jax._src.cli.common import command_line, digests
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, ResumeOptions, StepLimitOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.estimators import Estimator, trait
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.terrain import UNKNOWN
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import Start, sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import PlannerSource, Runner
from dc2g_jax._src.rollouts.results import Results, as_text
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.runtime.progress import EpisodeProgress
from dc2g_jax._src.training.cost_to_go_data import drawn_houses
from dc2g_jax.families.procedural.suburbs import SUBURBS
from experiments.support.neighborhoods import draw_neighborhood

from ..benchmarks.extents import CroppedEstimator, Window, WindowedEstimator
from ..benchmarks.timing import measure

#: Seeds of the procedural houses and neighborhoods of a split. Training uses smaller ones.
SEEDS = {"val": 10_000, "test": 10_001}

#: Unknown cells added around a house, for maps that do not end at its edges.
OPEN_MARGIN = 24


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, StepLimitOptions, OutOptions, ResumeOptions):
    """Compare inputs of DC2G's network: the whole map, a rescaled crop, a window around the robot.

    Attributes:
      split: `val` to make choices, `test` to report results.
      starts_per_house: sampled starts in each of the dataset's houses.
      drawn: number of procedural houses besides, with two sampled starts in each.
      rows: number of maps with several houses in a row, for each number of `doors`, with two sampled starts in each.
      cells: side length of the maps with several houses.
      doors: largest numbers of houses with a front door in these maps.
      windows: side lengths of the windows around the robot, in cells.
      seed: seed of the sampled starts.
    """

    split: Literal["val", "test"] = "val"
    starts_per_house: int = 10
    drawn: int = 32
    rows: int = 6
    cells: int = 200
    doors: tuple[int, ...] = (100, 4)
    windows: tuple[int, ...] = (50,)
    seed: int = 0


class Worlds(NamedTuple):
    """Maps of one size, and starts in them."""

    houses: list[House]
    starts: list[Start]


def estimators_by_planner(network: Estimator, windows: Iterable[int]) -> dict[str, Estimator]:
    """Estimators of DC2G with each extent, by planner name."""
    windowed = {f"dc2g_window_{side}": WindowedEstimator(network, Window(side, prior=float(side))) for side in windows}
    return {"dc2g": network, "dc2g_crop": CroppedEstimator(network), **windowed}


def open_ended(worlds: Worlds) -> Worlds:
    """The same houses and starts in larger maps, with unknown cells around the house."""
    houses = [
        House(f"{house.name}_open", house.split, np.pad(house.terrain, OPEN_MARGIN, constant_values=UNKNOWN))
        for house in worlds.houses
    ]
    starts = [
        start._replace(house=f"{start.house}_open", x=start.x + OPEN_MARGIN, y=start.y + OPEN_MARGIN)
        for start in worlds.starts
    ]
    return Worlds(houses, starts)


def neighborhoods(options: Options, doors: int) -> Worlds:
    """Maps with several houses in a row. They alternate between all suburban styles."""
    styles, seed = list(SUBURBS), SEEDS[options.split] << 32
    houses = [
        House(f"row{number:03d}d{doors}", options.split, draw_neighborhood(seed + number, style, options.cells, doors))
        for number, style in ((number, styles[number % len(styles)]) for number in range(options.rows))
    ]
    return Worlds(houses, sample_starts(houses, 2, seed=options.seed))


def all_worlds(options: Options, dataset: HouseDataset) -> dict[str, Worlds]:
    """All maps to compare planners on, by name."""
    own = usable_houses(dataset, options.split, instead="give another --split")
    drawn = drawn_houses("v", options.split, options.drawn, SEEDS[options.split], own[0].terrain.shape[0])
    worlds = {
        "houses": Worlds(own, sample_starts(own, options.starts_per_house, seed=options.seed)),
        "drawn": Worlds(drawn, sample_starts(drawn, 2, seed=options.seed)),
    }
    worlds |= {f"{name}_open": open_ended(one) for name, one in worlds.items()}
    worlds |= {f"rows_{doors}_doors": neighborhoods(options, doors) for doors in options.doors}
    return {name: one for name, one in worlds.items() if one.starts}


@jit
def _ask(estimator: Estimator, terrain: UInt8[Array, "h w"], before: Float[Array, "1 h w"]) -> Float[Array, "1 h w"]:
    """The mean estimate for a robot in the middle of a map."""
    pose, extent = make_pose(terrain.shape[1] // 2, terrain.shape[0] // 2, 0), trait(estimator, "extent")
    outcomes = estimator.estimate(extent.part(terrain, pose), ())
    return extent.merged(jnp.mean(outcomes, axis=0, keepdims=True), pose, before)


def milliseconds(estimators: Mapping[str, Estimator], house: House) -> dict[str, float]:
    """Duration of one estimate by planner name, for a single map whose middle has been observed."""
    rows, columns = house.terrain.shape
    terrain = np.zeros_like(house.terrain)
    middle = slice(rows // 4, -rows // 4), slice(columns // 4, -columns // 4)
    terrain[middle] = house.terrain[middle]
    before = jnp.zeros((1, rows, columns))
    times = {name: measure(lambda: _ask(one, terrain, before), repeats=9).median for name, one in estimators.items()}  # noqa: B023
    return {name: round(1e3 * seconds, 2) for name, seconds in times.items()}


def main(options: Options) -> None:
    """Run all planners on all maps; print and write the tables."""
    if any(n < 1 for n in (options.starts_per_house, *options.doors, *options.windows)) or options.cells < 50:
        raise InputError("give --starts-per-house, --doors and --windows of at least 1, and --cells of at least 50")
    if min(options.drawn, options.rows) < 0:
        raise InputError(f"--drawn {options.drawn}, --rows {options.rows}: give 0 or more maps")
    network = load_network(options.network)
    estimators = estimators_by_planner(network, options.windows)
    dataset = open_dataset(options.dataset)
    worlds = all_worlds(options, dataset)
    out = output_folder(options, "unknown_dimensions", inputs=digests(dataset, network=network))
    table = EpisodeTable(out / "episodes.csv")
    planners: dict[str, PlannerSource] = {"frontier": "frontier"}
    planners |= {name: functools.partial(planner_with, "dc2g", estimator=one) for name, one in estimators.items()}
    facts: dict[str, dict[str, Any]] = {}
    for name, (houses, starts) in worlds.items():
        maps = HouseDataset(name, "folder", tuple(houses))
        runner = Runner(maps, SETTINGS["paper"], step_limit=options.step_limit, progress=EpisodeProgress())
        results = table.run(runner, starts, planners)
        rows, columns = houses[0].terrain.shape
        print(f"\n{name}: {len(starts)} episodes in {len(houses)} maps of {columns} x {rows} cells, {options.split}")
        taken = milliseconds(estimators, houses[0])
        summaries = Results(results).summary()
        facts[name] = {
            planner: {**summary, "milliseconds": taken.get(planner)} for planner, summary in summaries.items()
        }
        print(as_text(summaries))
        print(f"milliseconds of an estimate: {taken}", flush=True)
    write_json(out / "results.json", {"split": options.split, "worlds": facts})
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
