"""Short loops, unrolled depending on the device. JAX only compiles the branch for the program's device."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
from jaxtyping import Array

_Carry = TypeVar("_Carry")


def repeated(count: int, function: Callable[[Array, _Carry], _Carry], carry: _Carry) -> _Carry:
    """`jax.lax.fori_loop(0, count, function, carry)`, unrolled except on a CPU.

    A GPU would copy the carry in every iteration, and launch kernels for the counter and the condition.
    """
    loop = functools.partial(jax.lax.fori_loop, 0, count, function)
    return jax.lax.platform_dependent(carry, cpu=loop, default=functools.partial(loop, unroll=True))
