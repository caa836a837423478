"""Episodes in plain single-threaded C: `gridworld.c`, compiled here and called through ctypes."""

import concurrent.futures
import ctypes
import dataclasses
import functools
import os
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from .problem import BASELINES, BaselineName, BaselineUnavailable, Outcome, Problem, empty_outcome

_SOURCE = Path(__file__).with_name("gridworld.c")
FLAGS = ("-std=c99", "-O3", "-march=native", "-shared", "-fPIC")


def compiler() -> list[str]:
    """The C compiler: the one the environment variable CC names, else the first of cc, gcc and clang.

    Raises:
      BaselineUnavailable: if there is none.
    """
    chosen = shlex.split(os.environ.get("CC", "")) or next(
        ([name] for name in ("cc", "gcc", "clang") if shutil.which(name)), []
    )
    if not chosen or shutil.which(chosen[0]) is None:
        wanted = chosen[0] if chosen else "cc, gcc or clang"
        raise BaselineUnavailable(f"no C compiler ({wanted} is not on the PATH); install one or set CC")
    return chosen


@functools.cache
def library() -> ctypes.CDLL:
    """The compiled program, built once a process in a new folder, which no other user can write to."""
    command = compiler()
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / "gridworld.so"
        result = subprocess.run(
            [*command, *FLAGS, str(_SOURCE), "-o", str(built)], capture_output=True, text=True, check=False
        )
        if result.returncode != 0:
            lines = result.stderr.strip().splitlines() or [f"exit status {result.returncode}"]
            raise BaselineUnavailable(f"{shlex.join(command)} cannot compile {_SOURCE.name}: {lines[0]}")
        return ctypes.CDLL(str(built))


def _address(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)


def _run(problem: Problem, planner: BaselineName) -> Outcome:
    """Run every episode, one after another."""
    outcome = empty_outcome(problem)
    _, height, width = problem.traversable.shape
    status = library().run_episodes(
        height,
        width,
        _address(problem.traversable),
        _address(problem.goals),
        len(problem.world),
        _address(problem.world),
        _address(problem.start),
        *map(_address, problem.sensing),
        *map(_address, problem.expanding),
        BASELINES.index(planner),
        problem.step_limit,
        _address(outcome.steps),
        _address(outcome.success),
        _address(outcome.actions),
    )
    if status != 0:
        raise MemoryError(f"no memory for a robot on {height} x {width} cells")
    return outcome


def run_episodes(problem: Problem, planner: BaselineName, *, threads: int = 1) -> Outcome:
    """Run every episode: one after another on one core, or dealt out to several, each of which does the same.

    Args:
      problem: the episodes.
      planner: who leads the robots.
      threads: cores to use.

    Raises:
      BaselineUnavailable: if there is no compiler.
    """
    library()
    if threads == 1:
        return _run(problem, planner)
    hands = [
        dataclasses.replace(
            problem,
            world=np.ascontiguousarray(problem.world[hand::threads]),
            start=np.ascontiguousarray(problem.start[hand::threads]),
        )
        for hand in range(threads)
    ]
    whole = empty_outcome(problem)
    with concurrent.futures.ThreadPoolExecutor(threads) as pool:
        for hand, part in enumerate(pool.map(_run, hands, [planner] * threads)):
            whole.steps[hand::threads] = part.steps
            whole.success[hand::threads] = part.success
            whole.actions[hand::threads] = part.actions
    return whole
