"""Seconds and bytes: repeats, medians and worsts, peak memory."""

import contextlib
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

#: A repeat that would be shorter calls the function several times.
_SHORTEST_REPEAT = 0.05


class Measured(NamedTuple):
    """Seconds of one call over repeats, and what it gave.

    Attributes:
      median: seconds of the median repeat.
      worst: of the slowest repeat.
      first: of the first call, compilation included.
      repeats: how many were taken, the first call not among them.
      output: what the last call gave, on the host.
      peak_memory: most bytes the process held meanwhile, or the device where it keeps count.
      added_memory: how much of it came on top of what was held before.
    """

    median: float
    worst: float
    first: float
    repeats: int
    output: Any
    peak_memory: int
    added_memory: int


def measure(call: Callable[[], Any], *, repeats: int, shortest_repeat: float = _SHORTEST_REPEAT) -> Measured:
    """Time a call: once to compile and warm up, then over and over. Its output is waited for.

    Args:
      call: what to time.
      repeats: how many times, at least one.
      shortest_repeat: a repeat calls so often that it takes these seconds at least; 0 for one call.
    """
    held = held_memory()

    def seconds(calls: int) -> tuple[float, Any]:
        start = time.perf_counter()
        for _ in range(calls):
            output = jax.block_until_ready(call())
        return (time.perf_counter() - start) / calls, output

    first, output = seconds(1)
    once = seconds(1)[0] if shortest_repeat else 1.0
    calls = max(1, min(10_000, round(shortest_repeat / max(once, 1e-9))))
    taken = []
    for _ in range(repeats):
        took, output = seconds(calls)
        taken.append(took)
    peak = peak_memory()
    return Measured(
        statistics.median(taken), max(taken), first, repeats, jax.device_get(output), peak, added_memory=peak - held
    )


def checksum(output: Any) -> int:
    """A number that every leaf of an output has a part in."""
    total = 0
    for leaf in jax.tree.leaves(output):
        array = np.nan_to_num(np.asarray(leaf), posinf=0, neginf=0)
        total = (31 * total + int(np.sum(array, dtype=np.float64))) % 2**31
    return total


def text_of(path: str) -> str:
    """The text of a file of the system; empty where it has none."""
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def device_memory(name: str) -> int | None:
    """The first device's own count of its memory, where it keeps one."""
    return (jax.local_devices()[0].memory_stats() or {}).get(name)


def _process_memory(name: str) -> int | None:
    """The system's count of this process's resident memory, in bytes."""
    for line in text_of("/proc/self/status").splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    return None


def held_memory() -> int:
    """Bytes held now; from here on `peak_memory` counts afresh, where the system can do that."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return device_memory("bytes_in_use") or _process_memory("VmRSS") or 0


def peak_memory() -> int:
    """Most bytes held since `held_memory`: the device's own count, else the process's resident memory."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return device_memory("peak_bytes_in_use") or _process_memory("VmHWM") or most
