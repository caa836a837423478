"""Drive from camera to door with increasing noise: `python -m experiments.noisy_mapping`."""

import dataclasses
import functools
import math
from collections.abc import Mapping
from typing import Literal

from dc2g_jax._src.cli.common import NetworkOption, command_line, digests
from dc2g_jax._src.cli.episodes import EpisodeTable
from dc2g_jax._src.cli.options import DatasetOptions, OutOptions, ResumeOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.estimation.checkpoints import SHIPPED_NOISY_NETWORK
from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.files.atomic import write_json
from dc2g_jax._src.files.resources import resource
from dc2g_jax._src.files.rows import ResumableTable
from dc2g_jax._src.files.tables import text_table
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.readers.starts import sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import Results
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.progress import EpisodeProgress
from experiments.driving.drive import Equipment
from experiments.support.drive_figures import plot_noise
from experiments.support.driving import DriveResult, DrivingOptions, drive_all, equipment, summarize_drives


@dataclasses.dataclass(frozen=True)
class Options(DrivingOptions, DatasetOptions, OutOptions, ResumeOptions):
    """Drive vehicles with cameras to front doors (section IV-D), with noise on depth, classes, pixels and pose.

    Extra time is relative to a vehicle that knows the map. It is compared with the extra steps of a gridworld robot
    from the same starts, with and without occlusion.

    Attributes:
      split: houses to drive in: `val` to make choices, `test` to report results.
      starts_per_house: sampled starts in each house.
      levels: noise levels; 0 is no noise, 1 the presumed noise of the paper's maps.
      network: folder of a network trained on clean maps; the shipped one by default.
      noisy_network: folder of a network trained with mapping noise; the shipped one by default.
      seed: seed of starts, noise and pedestrians.
    """

    split: Literal["train", "val", "test"] = "test"
    starts_per_house: int = 3
    levels: tuple[float, ...] = (0.0, 0.5, 1.0, 2.0)
    network: NetworkOption = None
    noisy_network: NetworkOption = None
    seed: int = 0


def table_text(results: Mapping[str, Mapping[str, float]]) -> str:
    """The table; gridworld robots leave no ground and touch nobody."""
    columns = ("extra", "median_extra", "success", "seconds_off_ground", "seconds_touching_people")
    heads = ("", "extra time %", "median %", "success %", "s off ground", "s touching")
    rows = []
    for name, result in results.items():
        values = [result.get(column, math.nan) * (100 if column == "success" else 1) for column in columns]
        rows.append((name, *("" if math.isnan(value) else f"{value:.1f}" for value in values)))
    return text_table(heads, rows)


def main(options: Options) -> None:
    """Run the gridworld episodes, then drive at each noise level."""
    if not options.levels or not all(0 <= level < math.inf for level in options.levels):
        raise InputError(f"--levels {' '.join(map(str, options.levels))}: give one at least, all of them from 0 on")
    dataset = open_dataset(options.dataset)
    clean, noisy = load_network(options.network), load_network(options.noisy_network or resource(SHIPPED_NOISY_NETWORK))
    networks: dict[str, Estimator] = {"clean": clean, "noisy": noisy}
    houses = usable_houses(dataset, options.split, instead="give another --split")
    starts = sample_starts(houses, options.starts_per_house, seed=options.seed)
    out = output_folder(options, "noisy_mapping", inputs=digests(dataset, network=clean, noisy_network=noisy))
    results: dict[str, dict[str, float]] = {}
    for settings in ("paper", "occluded"):
        runner = Runner(dataset, SETTINGS[settings], progress=EpisodeProgress())
        grid = EpisodeTable(out / f"gridworld_{settings}.csv").run(runner, starts, ["dc2g"], networks["clean"])
        summary = Results(grid).summary()["dc2g"]
        results[f"gridworld, {settings}"] = {
            "extra": summary["mean_extra"], "median_extra": summary["median_extra"], "success": summary["success"],
        }  # fmt: skip
    (out / "drives").mkdir(exist_ok=True)
    progress = EpisodeProgress()

    def run(name: str, robot: Equipment, *, knows_map: bool = False) -> list[DriveResult]:
        go = functools.partial(
            drive_all, robot, houses, starts, seed=options.seed, pedestrians=options.pedestrians, knows_map=knows_map,
            on_progress=lambda ended: progress(name, ended, len(starts)),
        )  # fmt: skip
        table = ResumableTable(out / "drives" / f"{name}.csv", DriveResult)
        return table.next_results([start[:4] for start in starts], go)

    size = houses[0].terrain.shape
    oracle = run("oracle", equipment("oracle", None, size, 0.0, options), knows_map=True)
    for trained, network in networks.items():
        for level in options.levels:
            drives = run(f"{trained}_{level:g}", equipment("dc2g", network, size, level, options))
            results[f"trained {trained}, noise {level:g}"] = summarize_drives(drives, oracle)
    write_json(out / "results.json", results)
    print(table_text(results))
    plot_noise(out / "noisy_mapping", options.levels, results, f"{len(starts)} starts in {dataset.name}")
    print_files(out)


if __name__ == "__main__":
    command_line(Options, main)
