"""Work shared out among devices: every accelerator, or every core of the CPU."""

import concurrent.futures
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

#: Compiler options of a program that keeps to one core of a CPU, where each core runs a program of its own.
ONE_CORE: dict[str, Any] = {"xla_cpu_multi_thread_eigen": False}

#: A pytree of NumPy arrays whose first axis is that of the pieces of work.
_Results = TypeVar("_Results")

_Result = TypeVar("_Result")

#: A pytree of arrays.
_State = TypeVar("_State")

#: Seconds that a call of a program on the device should take: between two calls progress is reported, and an interrupt
#: heard.
_SECONDS_PER_CALL = 0.3


class Report(Protocol):
    """How a worker says how far it is: `report(finished)`. The answer is whether it is to go on.

    The first report says that the program is compiled: only then the other workers begin, and find it ready.
    """

    def __call__(self, finished: int) -> bool:
        """See above."""
        ...


def cores() -> int:
    """Cores of the CPU that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def every_device() -> list[jax.Device]:
    """Every accelerator once, or the CPU once a core."""
    devices = jax.local_devices()
    return devices * cores() if devices[0].platform == "cpu" else devices


def on_cores(call: Callable[[int], _Result], count: int) -> list[_Result]:
    """Call a program for 0 to count - 1, on each core of the CPU one at a time.

    Args:
      call: runs a program, compiled with `ONE_CORE`.
      count: how many calls, at least one.

    Returns:
      The results, in order, computed.
    """
    with concurrent.futures.ThreadPoolExecutor(min(count, cores())) as pool:
        return list(pool.map(lambda number: jax.block_until_ready(call(number)), range(count)))


def one_by_one(call: Callable[..., _Result], *batch: Any) -> _Result:
    """`jax.vmap` as a loop: on a CPU, where a branch not taken is then not computed, up to nine times as fast."""
    return jax.lax.map(lambda args: call(*args), batch)


def side_by_side(call: Callable[..., _Result], *batch: Any) -> _Result:
    """`jax.vmap`: for accelerators."""
    return jax.vmap(call)(*batch)


def fold_of(device: jax.Device) -> Callable[..., Any]:
    """How a device does a batch best: `one_by_one` or `side_by_side`."""
    return one_by_one if device.platform == "cpu" else side_by_side


def share_out(
    n_pieces: int,
    devices: Sequence[jax.Device],
    serve: Callable[[jax.Device, Int[np.ndarray, "own"], Report], _Results],
    on_progress: Callable[[int], None] | None = None,
) -> _Results:
    """Do pieces of work, every n-th on one of n devices, each served by a thread.

    Args:
      n_pieces: how many, at least one for each device.
      devices: where; a device that is named twice is served by two threads.
      serve: `(device, numbers of its pieces, report) ->` their results.
      on_progress: called with the number of pieces finished so far at each report.

    Returns:
      All results, in the order of the pieces.
    """
    shares = [np.arange(worker, n_pieces, len(devices)) for worker in range(len(devices))]
    done = [0] * len(devices)
    reporting, compiled, stop = threading.Lock(), threading.Event(), threading.Event()

    def work(worker: int) -> _Results:
        def report(finished: int) -> bool:
            compiled.set()
            with reporting:
                done[worker] = finished
                if on_progress is not None and not stop.is_set():
                    on_progress(sum(done))
            return not stop.is_set()

        return serve(devices[worker], shares[worker], report)

    with concurrent.futures.ThreadPoolExecutor(len(devices)) as pool:
        try:
            served = [pool.submit(work, 0)]
            # The others wait until the first has compiled the program for all, or has failed.
            served[0].add_done_callback(lambda _: compiled.set())
            compiled.wait()
            served += [pool.submit(work, worker) for worker in range(1, len(devices))]
            if concurrent.futures.wait(served, return_when=concurrent.futures.FIRST_EXCEPTION).not_done:
                stop.set()  # one has failed: what the others would find is not wanted
            parts = [future.result() for future in served]
        finally:
            stop.set()
    order = np.argsort(np.concatenate(shares))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *parts)


def serve_paced(
    state: _State,
    go_on: Callable[[_State, Int[Array, ""]], _State],
    count_finished: Callable[[_State], Int[Array, ""]],
    n_pieces: int,
    report: Report,
    *,
    first_steps: int,
) -> _State:
    """Do pieces of work on one device, so many steps a call that each takes about as long; see `share_out`.

    Args:
      state: the first state.
      go_on: `(state, steps) ->` the state after at most so many more steps of each piece.
      count_finished: `state ->` how many pieces are finished.
      n_pieces: how many there are.
      report: told after each call.
      first_steps: steps of the first call that takes any.

    Returns:
      The state in which all pieces are finished, or the work was stopped.
    """
    # Takes no step: this is where the program is compiled.
    state = jax.block_until_ready(go_on(state, jnp.int32(0)))
    finished, steps, goes_on = 0, first_steps, report(0)
    while finished < n_pieces and goes_on:
        began = time.perf_counter()
        state = go_on(state, jnp.int32(steps))
        finished = int(count_finished(state))
        pace = steps / (time.perf_counter() - began)
        steps = max(1, min(int(pace * _SECONDS_PER_CALL), 2 * steps))
        goes_on = report(finished)
    return state
