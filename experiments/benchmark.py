"""Benchmark the package against alternatives: `python -m experiments.benchmark`."""

import dataclasses
import itertools
import sys
import time
from collections.abc import Callable, Iterator
from typing import Literal

import jax

from dc2g_jax._src.cli.common import command_line
from dc2g_jax._src.cli.options import DatasetOptions, NetworkOptions, OutOptions, SharedOptions, require_positive
from dc2g_jax._src.cli.outputs import output_folder
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.hub import load_network
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.runtime.errors import InputError

from .benchmarks import machine, report
from .benchmarks.accelerator import accelerator_rows
from .benchmarks.bench import Bench
from .benchmarks.kernels import kernel_rows, network_rows
from .benchmarks.planners import planner_rows
from .benchmarks.rows import Row
from .benchmarks.stepping import environment_rows
from .benchmarks.sweeps import batch_rows, grid_rows
from .benchmarks.training import step_rows, training_rows
from .benchmarks.workload import make_workload

Section = Literal["planners", "environment", "kernels", "network", "training", "batch", "grid"]

_SECTIONS: dict[Section, Callable[[Bench], Iterator[Row]]] = {
    "planners": planner_rows,
    "environment": environment_rows,
    "kernels": kernel_rows,
    "network": network_rows,
    "training": lambda bench: itertools.chain(training_rows(bench), step_rows(bench)),
    "batch": batch_rows,
    "grid": grid_rows,
}

_ABOUT = (
    "Medians of repeats, worst beside them; compilation apart. A planner step is one robot's plan, action and "
    "observation, counted once; every program replans from scratch at every step, by the rules of the authors' code. "
    "`frontier_lazy` does the same with fewer looks: it searches outward and tests each pose only when it comes to it. "
    "Houses: training and validation ones, never test houses. Shares are of what this machine was measured to do, from "
    "counted work: words handled by each operation as written, inputs and outputs read and written once and what a "
    "loop carries once a turn. Where that fits into the caches the share of the memory bandwidth can exceed 100 %."
)


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, NetworkOptions, OutOptions, SharedOptions):
    """Measure planners, environment, kernels, network, training, beside plain C, Numba, NumPy, PyTorch and libraries.

    Writes `benchmark.json` and `benchmark.md` after each row, and prints the table.
    Programs that are not installed are left out with the reason; `pip install -e ".[benchmark]" torch` brings them.

    Attributes:
      accelerator: measure an accelerator instead, the most important parts first: the same episodes as on the CPU,
        planners by batch size, Fig. 7, trainings, object goals. Writes `accelerator.json` and `accelerator.md`.
      minutes: with --accelerator, time limit; parts that exceed it are left out.
      robots: with --accelerator, largest number of robots side by side.
      runs: with --accelerator, number of training runs side by side.
      only: parts to measure; all by default.
      quick: measure small cases, as a test of a minute; the figures mean little.
      repeats: number of repeats; by default 5, or 2 with --quick.
      starts_per_house: episodes in each training and validation house.
    """

    accelerator: bool = False
    minutes: float = 9.0
    robots: int = 262144
    runs: tuple[int, ...] = (8, 64)
    only: tuple[Section, ...] = ()
    quick: bool = False
    repeats: int | None = None
    starts_per_house: int = 12


def check(options: Options) -> None:
    """Check the options.

    Raises:
      InputError: an option is invalid; the message names it.
    """
    require_positive(options, "repeats", "starts_per_house", "robots")
    if options.minutes <= 0 or min(options.runs, default=1) < 1:
        raise InputError(f"--minutes {options.minutes:g}, --runs: give positive numbers")
    if options.accelerator and not options.quick and jax.default_backend() == "cpu":
        raise InputError("--accelerator: JAX finds none; install the extra `cuda`, or give --quick to see that it runs")
    if options.accelerator and options.only:
        raise InputError("--only: chooses parts of the other benchmark; leave out one of --only and --accelerator")


def main(options: Options) -> None:
    """Measure and write."""
    check(options)
    started = time.monotonic()
    dataset = open_dataset(options.dataset)
    repeats = options.repeats or (2 if options.quick else 5)
    workload = make_workload(
        dataset, per_house=1 if options.quick else options.starts_per_house, most_houses=4 if options.quick else None
    )
    network = load_network(options.network)
    if not isinstance(network, NetworkCostToGo):
        raise InputError(f"{options.network}: is no compact network; the benchmark measures that kind alone")
    out = output_folder(options, "benchmark")

    description = machine.describe()
    print(", ".join(f"{name} {value}" for name, value in description.items()))
    if machine.load() > machine.cores() / 2:
        print(f"The machine is busy (load {machine.load():.1f}): the figures will be low", file=sys.stderr)
    peaks = machine.peaks(repeats, quick=options.quick)
    print("\n".join(report.peak_lines(peaks)))
    bench = Bench(
        workload=workload,
        network=network,
        repeats=repeats,
        quick=options.quick,
        peaks={resource: peak.rate for resource, peak in peaks.items()},
    )
    if options.accelerator:
        until = started + 60 * options.minutes
        found = accelerator_rows(bench, dataset, robots=options.robots, runs=options.runs, until=until)
    else:
        found = (row for section in options.only or _SECTIONS for row in _SECTIONS[section](bench))
    name = "accelerator" if options.accelerator else "benchmark"
    facts = {
        "machine": description,
        "about": _ABOUT,
        "dataset": dataset.name,
        "houses": len(workload.houses),
        "episodes": len(workload.starts),
        "repeats": repeats,
        "quick": options.quick,
    }
    rows: list[Row] = []
    for row in found:
        facts["seconds"] = round(time.monotonic() - started, 1)
        print(f"{facts['seconds']:5.0f} s  {row.section}: {report.line_of(row)}", file=sys.stderr, flush=True)
        rows.append(row)
        written = report.write(out, name, facts, peaks, rows)
    print(report.text(rows))
    print(f"Written: {', '.join(str(path) for path in written)}")


if __name__ == "__main__":
    command_line(Options, main)
