"""Programs as compiled, and how much memory they need."""

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

from dc2g_jax._src.runtime.programs import jit

from .timing import device_memory

#: A program may need so much of the memory.
_MOST_MEMORY = 0.5


class TooLarge(Exception):
    """A program needs more memory than there is to spare."""


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


def compile_program(function: Callable[..., Any], *arguments: Any) -> tuple[Callable[..., Any], int]:
    """Compile a function for its arguments: the program, and bytes for arguments, results and everything between.

    Raises:
      TooLarge: if the program needs more memory than there is to spare.
    """
    compiled = jit(function).lower(*arguments).compile()
    analysis = compiled.memory_analysis()
    memory = analysis.temp_size_in_bytes + analysis.argument_size_in_bytes + analysis.output_size_in_bytes
    there = device_memory("bytes_limit") or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if memory > _MOST_MEMORY * there:
        raise TooLarge(f"needs {memory / 2**30:.1f} GiB of memory")
    return compiled, memory
