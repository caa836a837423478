"""Short loops, as suits the device. JAX compiles the branch of the device that a program is for, and no other."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
from jaxtyping import Array

_Carry = TypeVar("_Carry")


def repeated(count: int, function: Callable[[Array, _Carry], _Carry], carry: _Carry) -> _Carry:
    """`jax.lax.fori_loop(0, count, function, carry)`, written out but for a CPU.

    A GPU would copy what the loop carries in every turn, and start kernels for its counter and its condition.
    """
    loop = functools.partial(jax.lax.fori_loop, 0, count, function)
    return jax.lax.platform_dependent(carry, cpu=loop, default=functools.partial(loop, unroll=True))
