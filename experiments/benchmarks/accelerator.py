"""Speed of an accelerator and its agreement with the CPU, in a few minutes, the most important figures first."""

import dataclasses
import functools
import hashlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from dc2g_jax._src.planning.named import FIGURE_PLANNERS
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import HouseDataset
from dc2g_jax._src.readers.starts import published_episodes, sample_starts
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.rollout import rollout
from dc2g_jax._src.runtime.devices import mesh_for_batch, replicate
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.step import supervised_step
from dc2g_jax.indoor.houses.dataset import IndoorHouse, indoor_houses
from dc2g_jax.indoor.learning.networks import load_costs
from dc2g_jax.indoor.maps.mapping import IndoorMapSettings
from dc2g_jax.indoor.search.agent import Agent
from dc2g_jax.indoor.search.guides import agent_with
from dc2g_jax.indoor.search.searches import TIME_LIMIT, sample_episodes, search_all
from experiments.reproduce_fig5 import TranslationOptions
from experiments.translator.pairs import image_set
from experiments.translator.training import TranslatorTraining

from .bench import SENSING_RANGE, Bench, own
from .planners import PLANNER_UNIT, with_episodes
from .rows import Row, attempt, growing
from .sweeps import planner_batches
from .timing import Measured, measure
from .training import training_rows
from .workload import Workload

#: Numbers of robots side by side.
_BATCHES = {"frontier": (1024, 16384, 65536, 262144), "oracle": (65536, 262144), "dc2g": (16384, 65536)}

#: Optimizer steps in a call.
_STEPS = 20


class _Part(NamedTuple):
    """A part of the report.

    Attributes:
      section: section of its rows.
      seconds: it is left out if less time is left; most of it is compilation.
      lower: the option to lower if memory runs out; '' for none.
      rows: measures its rows.
    """

    section: str
    seconds: int
    lower: str
    rows: Callable[[], Iterator[Row]]


def _once(call: Callable[[], Any]) -> Measured:
    """Time one long call, after a first one that compiles."""
    return measure(call, repeats=1, shortest_repeat=0.0)


def _compared(bench: Bench, row: Row, workload: Workload, planner: str, reach: int) -> Row:
    """Run whole episodes here, and all of them on the CPU too, or every tenth for a planner with a network.

    Networks round differently on other devices, so for `dc2g` the row gives the share of equal episodes. The checksum
    is 52 bits of the SHA-256 of all actions here.
    """
    run = functools.partial(rollout, bench.planner(planner, reach), workload.worlds, sensing=bench.rules(reach).sensing)
    measured = _once(lambda: run(*workload.episodes))
    every = 10 if planner == "dc2g" else 1
    some = jax.tree.map(lambda leaf: leaf[::every], workload.episodes)
    here, there = measured.output.actions[::every], run(*some, devices=jax.devices("cpu")).actions
    equal = float(np.mean(np.all(here == there, axis=1)))
    agreement = {"equal episodes": equal} if planner == "dc2g" else {"same actions": float(equal == 1)}
    row = with_episodes(row, measured)
    digest = int(hashlib.sha256(measured.output.actions.tobytes()).hexdigest()[:13], 16)
    return dataclasses.replace(row, checksum=digest, facts=row.facts | agreement)


def _is_published(bench: Bench, dataset: HouseDataset) -> bool:
    return dataset.source == "published" and not bench.quick


def _golden(bench: Bench, dataset: HouseDataset) -> Iterator[Row]:
    """The published episodes if the houses are the published ones, otherwise sampled episodes; compared with a CPU."""
    what, workload, reach = "", bench.workload, SENSING_RANGE
    if _is_published(bench, dataset):
        starts = tuple(start for start, *_ in published_episodes())
        houses = tuple(dataset.house(name) for name in dict.fromkeys(start.house for start in starts))
        what, workload, reach = ", published starts", Workload(dataset.name, houses, starts), 5
    for planner in ("frontier",) if bench.quick else ("oracle", "frontier", "dc2g"):
        row = own("golden", planner + what, PLANNER_UNIT, cells=workload.cells, sensing_range=reach)
        yield attempt(row, functools.partial(_compared, bench, row, workload, planner, reach))


def _batches(bench: Bench, robots: int) -> Iterator[Row]:
    for planner, sizes in ({"frontier": (4,)} if bench.quick else _BATCHES).items():
        yield from planner_batches(bench, [planner], sorted({min(size, robots) for size in sizes}))


def _fig7(bench: Bench, dataset: HouseDataset) -> Iterator[Row]:
    """All episodes of Fig. 7 with all its planners, from starts to results, without figures and files."""
    planners = ("oracle",) if bench.quick else FIGURE_PLANNERS
    if _is_published(bench, dataset):
        settings, starts = "published", [start for start, *_ in published_episodes()]
    else:
        settings, starts = "paper", sample_starts(dataset.split("test")[: 2 if bench.quick else None], 10, seed=0)
    row = own("fig7", f"{settings}: {len(starts)} episodes x {len(planners)} planners", "episodes")

    def run() -> np.ndarray:
        # A runner keeps the oracle's results, so each call needs a new one.
        results = Runner(dataset, SETTINGS[settings]).run(starts, planners, bench.network)
        return np.array([result.steps for result in results])

    yield attempt(row, lambda: row.with_figures(_once(run), float(len(starts) * len(planners))))


def _training(bench: Bench, runs: Sequence[int]) -> Iterator[Row]:
    """Training steps by number of runs at once; one run is the default training."""
    for count in runs:
        way = "together" if count > 1 else "one after another"
        (row,) = training_rows(bench, count, [way], steps=2 if bench.quick else _STEPS)
        whole = TrainingConfig.steps / row.facts["steps of a run/s"]
        yield dataclasses.replace(row, facts=row.facts | {f"{TrainingConfig.steps} steps, s, extrapolated": whole})


def _translator(bench: Bench, dataset: HouseDataset) -> Iterator[Row]:
    """Steps of the translator with the paper's loss."""
    options = TranslationOptions(size=32, base_filters=4) if bench.quick else TranslationOptions()
    config, steps = options.config("l1+gan"), 2 if bench.quick else _STEPS
    data = image_set(dataset, "train", size=options.size, masks=options.masks, per_house=1)
    mesh = mesh_for_batch(config.batch_size)
    training = TranslatorTraining(config, options.draw(config.batch_size))
    state, pairs = replicate((training.first_state(config.hyperparameters), data), mesh)

    def train() -> jax.Array:
        nonlocal state
        for _ in range(steps):
            state, loss = supervised_step(state, pairs, config.hyperparameters, training=training, mesh=mesh)
        return loss

    measured = bench.measure(train)
    whole = options.steps * measured.median / steps
    row = own("translator", f"{options.base_filters} filters", "steps", batch=config.batch_size, cells=options.size)
    yield row.with_figures(measured, steps, checksum=None, facts={f"{options.steps} steps, s, extrapolated": whole})


def _searched(bench: Bench, agent: Agent, houses: Sequence[IndoorHouse], row: Row, batch: int) -> Row:
    episodes = sample_episodes(houses, batch // len(houses))
    limit = 5 if bench.quick else TIME_LIMIT
    found = _once(lambda: search_all(agent, houses, episodes, limit=limit))
    facts = {"searches/s": len(episodes) / found.median}
    return row.with_figures(found, float(np.sum(found.output.steps)), facts=facts, checksum=None)


def _searches(bench: Bench, robots: int) -> Iterator[Row]:
    """Searches for objects in procedural houses, by number of searches at once."""
    houses = indoor_houses(split="val", count=1 if bench.quick else 8, cell_size=IndoorMapSettings.cell_size)
    batches = (1,) if bench.quick else (min(robots, 1024),)
    for name in ("frontier",) if bench.quick else ("frontier", "promising"):
        searched = functools.partial(_searched, bench, agent_with(name, load_costs()), houses)
        yield from growing(batches, own("searches", name, "control periods"), searched)


def accelerator_rows(
    bench: Bench, dataset: HouseDataset, *, robots: int, runs: Sequence[int], until: float
) -> Iterator[Row]:
    """Rows as they are measured. A failure, and a part left out for lack of time, is a row that says so.

    Args:
      bench: what to measure with.
      dataset: the houses.
      robots: most robots side by side.
      runs: sizes of the sweeps of training runs; the default training is measured before them.
      until: when to stop, on the clock of `time.monotonic`.
    """
    sweeps = [2] if bench.quick else runs
    parts = [
        _Part("golden", 60, "", lambda: _golden(bench, dataset)),
        _Part("batch", 90, "--robots", lambda: _batches(bench, robots)),
        _Part("fig7", 90, "", lambda: _fig7(bench, dataset)),
        _Part("training", 30, "", lambda: _training(bench, [1])),
        _Part("training", 60, "--runs", lambda: _training(bench, sweeps)),
        _Part("translator", 60, "", lambda: _translator(bench, dataset)),
        _Part("searches", 60, "--robots", lambda: _searches(bench, robots)),
    ]
    if bench.quick:
        parts = [part._replace(seconds=0) for part in parts]
    return _in_time(parts, until)


def _in_time(parts: Sequence[_Part], until: float) -> Iterator[Row]:
    for part in parts:
        whole, rows = own(part.section, "all that is left of it", ""), part.rows()
        left, wanted = until - time.monotonic(), part.seconds
        while left > wanted:
            row = attempt(whole, functools.partial(next, rows, None))
            if row is None:
                break
            if part.lower and "memory" in (row.missing or ""):
                row = dataclasses.replace(row, missing=f"{row.missing}; lower {part.lower}")
            yield row
            left, wanted = until - time.monotonic(), 0
        else:
            yield dataclasses.replace(whole, missing=f"left out: {max(left, 0):.0f} s are left; give more --minutes")
