"""The machine: its name, and what it can do at best."""

import dataclasses
import os
import platform
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dc2g_jax._src.cli.outputs import versions
from dc2g_jax._src.runtime.devices import cores
from dc2g_jax._src.runtime.programs import jit

from .timing import measure, text_of

#: Resources, as `shares` of rows name them.
BANDWIDTH, WORD_ARITHMETIC, FLOAT_ARITHMETIC = "memory bandwidth", "32-bit word arithmetic", "float32 arithmetic"


def _cpu_name() -> str:
    for line in text_of("/proc/cpuinfo").splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def load() -> float:
    """Processes that wanted a core over the last minute, on average."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


def _vector_instructions() -> str:
    flags = text_of("/proc/cpuinfo").split()
    return next((name for name in ("avx512f", "avx2", "asimd", "sse2") if name in flags), "unknown")


def _driver() -> str:
    """The accelerator's driver as the system names it, or the runtime that JAX runs it with."""
    named = text_of("/proc/driver/nvidia/version").partition("\n")[0].partition(":")[2].strip()
    return named or " ".join(str(jax.devices()[0].client.platform_version).split())


def describe() -> dict[str, Any]:
    """What the figures were measured on."""
    device = jax.devices()[0]
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "cpu": _cpu_name(),
        "vector instructions": _vector_instructions(),
        "cores": cores(),
        "load": round(load(), 2),
        "memory_gib": round(memory / 2**30, 1),
        "accelerators": [each.device_kind for each in jax.devices() if each.platform != "cpu"],
        "driver": _driver(),
        "platform": device.platform,
        "system": f"{platform.system()} {platform.release()}",
        **versions(),
    }


@dataclasses.dataclass(frozen=True)
class Peak:
    """The most the machine was measured to do.

    Attributes:
      rate: units a second, from the median repeat.
      worst_rate: from the slowest repeat.
      unit: what is counted.
    """

    rate: float
    worst_rate: float
    unit: str


def _peak(call: Callable[[], jax.Array], work: float, unit: str, repeats: int) -> Peak:
    measured = measure(call, repeats=repeats)
    return Peak(rate=work / measured.median, worst_rate=work / measured.worst, unit=unit)


def _bandwidth(repeats: int, elements: int) -> Peak:
    """STREAM triad, a = b + s c, on arrays larger than the caches."""
    b, c = jnp.ones(elements, jnp.float32), jnp.full(elements, 2, jnp.float32)
    triad = jit(lambda b, c: b + jnp.float32(3) * c)
    return _peak(lambda: triad(b, c), 3 * 4.0 * elements, "bytes/s", repeats)


def _word_arithmetic(repeats: int, elements: int, rounds: int = 40) -> Peak:
    """Shifts, and, or, xor on words that stay in registers."""

    def mix(x: jax.Array, y: jax.Array) -> jax.Array:
        for _ in range(rounds):
            x = x ^ (x << 13)
            x = x | (x >> 17) & y
            x = x ^ (x << 5)
        return x

    x = jnp.arange(elements, dtype=jnp.uint32)
    mixed = jit(mix)
    return _peak(lambda: mixed(x, ~x), 7.0 * rounds * elements, "operations/s", repeats)


def _float_arithmetic(repeats: int, side: int) -> Peak:
    """A product of two square matrices."""
    a = jnp.asarray(np.random.default_rng(0).standard_normal((side, side)), jnp.float32)
    product = jit(jnp.matmul)
    return _peak(lambda: product(a, a), 2.0 * side**3, "operations/s", repeats)


def peaks(repeats: int, *, quick: bool = False) -> dict[str, Peak]:
    """Measure what the machine can do, by resource.

    Args:
      repeats: how many times.
      quick: on smaller arrays, which a large cache may hold.
    """
    large = jax.devices()[0].platform != "cpu"
    return {
        BANDWIDTH: _bandwidth(repeats, 2**22 if quick else 2**28 if large else 2**25),
        WORD_ARITHMETIC: _word_arithmetic(repeats, 2**18 if quick else 2**26 if large else 2**21),
        FLOAT_ARITHMETIC: _float_arithmetic(repeats, 512 if quick else 8192 if large else 2048),
    }
