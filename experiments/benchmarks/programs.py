"""Programs as compiled: how many equations, how long to trace and compile, how much memory."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
from jax.experimental.compilation_cache import compilation_cache

from dc2g_jax._src.runtime.programs import jit

from .work import equations

#: A program may need so much of the memory.
_MOST_MEMORY = 0.5


class TooLarge(Exception):
    """A program needs more memory than there is to spare."""


class CompiledProgram(NamedTuple):
    """A compiled program.

    Attributes:
      call: the program, without its static arguments.
      equations: of its jaxpr, those inside loops and branches included.
      trace_seconds: from Python to the compiler's input.
      compile_seconds: from there to machine code.
      memory: bytes for arguments, results and everything between.
      flops: floating-point operations as the compiler counts them, loops taken once.
    """

    call: Callable[..., Any]
    equations: int
    trace_seconds: float
    compile_seconds: float
    memory: int
    flops: float


def device_memory() -> int:
    """Memory of the first device, in bytes."""
    limits = jax.local_devices()[0].memory_stats() or {}
    return int(limits.get("bytes_limit", os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")))


@contextlib.contextmanager
def nothing_kept() -> Iterator[None]:
    """Everything is traced and compiled anew, whatever was kept in memory or on disk."""
    option = "jax_enable_compilation_cache"
    before = getattr(jax.config, option)
    jax.clear_caches()
    try:
        jax.config.update(option, False)
        compilation_cache.reset_cache()  # it looks at the option once
        yield
    finally:
        jax.config.update(option, before)
        compilation_cache.reset_cache()


def compile_program(function: Callable[..., Any], *arguments: Any, **static: Any) -> CompiledProgram:
    """Trace and compile a function for its arguments.

    Args:
      function: what to compile; already under `jit` where it has static arguments.
      arguments: arrays.
      static: static arguments.

    Raises:
      TooLarge: if the program needs more memory than there is to spare.
    """
    jitted: Any = function if hasattr(function, "trace") else jit(function)
    start = time.perf_counter()
    traced = jitted.trace(*arguments, **static)
    lowered = traced.lower()
    traced_at = time.perf_counter()
    compiled = lowered.compile()
    compiled_at = time.perf_counter()
    analysis = compiled.memory_analysis()
    memory = analysis.temp_size_in_bytes + analysis.argument_size_in_bytes + analysis.output_size_in_bytes
    if memory > _MOST_MEMORY * device_memory():
        raise TooLarge(f"needs {memory / 2**30:.1f} GiB of memory")
    return CompiledProgram(
        call=compiled,
        equations=equations(traced.jaxpr.jaxpr),
        trace_seconds=traced_at - start,
        compile_seconds=compiled_at - traced_at,
        memory=memory,
        flops=float((compiled.cost_analysis() or {}).get("flops", 0.0)),
    )
