"""What was compiled, for tests that nothing is compiled twice."""

from dc2g_jax._src.runtime.programs import jit


def compiled_count(program: jit) -> int:
    """Number of compiled programs that a function keeps."""
    return sum(of_classes._cache_size() for of_classes in program._programs.values())
