"""Loops that end: short ones, unrolled depending on the device, and those until a condition, bounded."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

_Carry = TypeVar("_Carry")


def repeated(count: int, function: Callable[[Array, _Carry], _Carry], carry: _Carry) -> _Carry:
    """`jax.lax.fori_loop(0, count, function, carry)`, unrolled except on a CPU: JAX compiles the device's branch alone.

    A GPU would copy the carry in every iteration, and launch kernels for the counter and the condition.
    """
    loop = functools.partial(jax.lax.fori_loop, 0, count, function)
    return jax.lax.platform_dependent(carry, cpu=loop, default=functools.partial(loop, unroll=True))


def until(
    done: Callable[[_Carry], Bool[Array, ""]], function: Callable[[_Carry], _Carry], carry: _Carry, *, most: int
) -> _Carry:
    """`jax.lax.while_loop(~done, function, carry)` of at most `most` iterations.

    Every iteration of a search visits another cell or pose, so `most` is never reached. But with a mistake in a
    condition a test would hang instead of failing, and no interrupt reaches a program on a device.
    """

    def go_on(counted: tuple[Array, _Carry]) -> Bool[Array, ""]:
        return (counted[0] < most) & ~done(counted[1])

    return jax.lax.while_loop(go_on, lambda counted: (counted[0] + 1, function(counted[1])), (jnp.int32(0), carry))[1]
