"""What one would pick instead of this package: plain C, Numba, library functions, other environments in JAX."""
