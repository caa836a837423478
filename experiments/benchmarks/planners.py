"""Whole episodes: planner steps and episodes a second, ours and those of the plain programs.

A planner step is one robot's plan, action and observation, and is counted once.
"""

import dataclasses
import functools
import importlib
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from dc2g_jax._src.estimation.estimators import Estimator, NetworkCostToGo
from dc2g_jax._src.figures.replay import actions_from_letters
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT, rollout
from dc2g_jax._src.runtime.devices import cores
from tests.oracles import numpy_gridworld

from ..baselines import c_gridworld
from ..baselines.problem import BaselineName, Outcome, Problem, empty_outcome
from .bench import SENSING_RANGE, Bench, own
from .kernels import network_pace_row
from .rows import Row, attempt
from .timing import Measured
from .workload import Workload

PLANNER_UNIT = "planner steps"


def with_episodes(row: Row, measured: Measured, reference: Any = None, every: int = 1) -> Row:
    """The row of a run of episodes.

    Args:
      row: without figures.
      measured: `steps` and `actions` of the episodes are in its output.
      reference: actions of all episodes that it should repeat.
      every: only every n-th of the episodes was run.
    """
    steps = np.asarray(measured.output.steps)
    facts = {"episodes": len(steps), "episodes/s": len(steps) / measured.median}
    if reference is not None:
        facts["same actions"] = float(np.array_equal(measured.output.actions, reference[::every]))
    return row.with_figures(measured, float(np.sum(steps)), facts=facts)


def own_episodes(
    bench: Bench, row: Row, workload: Workload, planner: str, *, step_limit: int = STEP_LIMIT, slots: int | None = None
) -> tuple[Row, np.ndarray]:
    """Run all episodes with this package, on one core where the row says so: the row, and the actions."""
    run = functools.partial(
        rollout,
        bench.planner(planner),
        workload.worlds,
        *workload.episodes,
        sensing=bench.rules().sensing,
        step_limit=step_limit,
        slots=slots,
        devices=jax.devices()[:1] if row.cores == 1 else None,
    )
    measured = bench.measure(run)
    return with_episodes(row, measured), measured.output.actions


def plain_programs(
    bench: Bench, row: Row, problem: Problem, planner: BaselineName, reference: np.ndarray, *, all_cores: bool = False
) -> Iterator[Row]:
    """The same episodes in C and Numba, on one core and, in C, on all of them."""

    def in_c(threads: int) -> Row:
        measured = bench.measure(lambda: c_gridworld.run_episodes(problem, planner, threads=threads))
        return with_episodes(dataclasses.replace(row, by="C", cores=threads), measured, reference)

    def in_numba() -> Row:
        numba_gridworld = importlib.import_module("experiments.baselines.numba_gridworld")
        measured = bench.measure(lambda: numba_gridworld.run_episodes(problem, planner))
        return with_episodes(numba_row, measured, reference)

    numba_row = dataclasses.replace(row, by="Numba", cores=1)
    for threads in sorted({1, cores()} if all_cores else {1}):
        yield attempt(dataclasses.replace(row, by="C", cores=threads), functools.partial(in_c, threads))
    yield attempt(numba_row, in_numba)


def _in_numpy(bench: Bench, row: Row, planner: numpy_gridworld.PlannerName, reference: np.ndarray) -> Row:
    """Some of the episodes with the plain NumPy program the tests check everything against."""
    workload = bench.workload
    every = len(workload.starts) // (1 if bench.quick else 8) or 1
    problem = workload.problem(sensing_range=SENSING_RANGE, step_limit=STEP_LIMIT, every=every)

    def run() -> Outcome:
        outcome = empty_outcome(problem)
        for episode, (world, pose) in enumerate(zip(problem.world, problem.start.tolist(), strict=True)):
            success, letters, _ = numpy_gridworld.run_episode(
                workload.terrain[world],
                tuple(pose),
                planner,
                rules="reference",
                sensing_radius=SENSING_RANGE,
                expanding_radius=SENSING_RANGE,
                max_steps=STEP_LIMIT,
            )
            outcome.success[episode] = success
            outcome.steps[episode] = len(letters)
            outcome.actions[episode, : len(letters)] = actions_from_letters(letters)
        return outcome

    return with_episodes(row, bench.measure(run), reference, every)


@struct.dataclass
class _Counting(Estimator):
    """A network that tells how many maps it is asked for."""

    estimator: NetworkCostToGo
    tell: Callable[[Any], None] = struct.field(pytree_node=False)

    def init(self, world: World) -> Any:
        """The estimator's own state."""
        return self.estimator.init(world)

    def summarized(self, summary: Callable[[jax.Array], jax.Array]) -> "_Counting":
        """The same, of a network that computes a summary."""
        return _Counting(self.estimator.summarized(summary), self.tell)

    def estimate(self, terrain: jax.Array, state: Any) -> jax.Array:
        """The estimator's own answer."""
        # A call that is not full is padded with maps of which nothing is known.
        jax.debug.callback(self.tell, jnp.sum(jnp.any(terrain != 0, axis=(0, 1))))
        return self.estimator.estimate(terrain, state)


def _with_network_pace(bench: Bench, row: Row) -> Row:
    """How much of the pace the network alone would allow a DC2G rollout keeps: an extra run counts its maps."""
    maps: list[int] = []
    counting = _Counting(bench.network, lambda count: maps.append(int(count)))
    planner = planner_with("dc2g", bench.rules(), counting)
    workload = bench.workload
    done = rollout(planner, workload.worlds, *workload.episodes, sensing=bench.rules().sensing, keep_actions=False)
    jax.effects_barrier()
    maps_a_step = sum(maps) / float(np.sum(done.steps))
    pace = (network_pace_row(bench).rate or 0.0) / maps_a_step
    facts = {"maps/step": maps_a_step, "steps/s of the network alone": pace}
    return dataclasses.replace(row, facts=row.facts | facts, shares={"the network's pace": (row.rate or 0.0) / pace})


def planner_rows(bench: Bench) -> Iterator[Row]:
    """Every planner from start to end of its episodes."""
    workload = bench.workload
    on_cpu = jax.devices()[0].platform == "cpu"
    problem = workload.problem(sensing_range=SENSING_RANGE, step_limit=STEP_LIMIT)
    case = {"cells": workload.cells, "sensing_range": SENSING_RANGE}
    plain: dict[str, tuple[BaselineName, ...]] = {"oracle": ("oracle",), "frontier": ("frontier", "frontier_lazy")}
    for planner in ("oracle", "frontier", "dc2g"):
        # The network's convolutions use every core, whoever asks for them.
        alone = on_cpu and not bench.quick and planner != "dc2g"
        for threads in sorted({1, cores()}) if alone else [cores() if on_cpu else None]:
            row = own("planners", planner, PLANNER_UNIT, cores=threads, **case)
            row, actions = own_episodes(bench, row, workload, planner)
            yield _with_network_pace(bench, row) if planner == "dc2g" else row
        for variant in plain.get(planner, ()):
            row = own("planners", variant, PLANNER_UNIT, **case)
            yield from plain_programs(bench, row, problem, variant, actions, all_cores=True)
            if variant != "frontier_lazy":
                row = dataclasses.replace(row, by="NumPy", cores=1)
                yield attempt(row, functools.partial(_in_numpy, bench, row, variant, actions))
