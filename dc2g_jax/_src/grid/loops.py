"""Loops that end: short ones, unrolled depending on the device, and bounded ones that run until a condition."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

_Carry = TypeVar("_Carry")
_Result = TypeVar("_Result")

#: A batch shrinks to one place in so many once they suffice.
_ONE_IN = 8

#: Steps between checks for members that are done: in a batch that shrinks, and in the last, small one.
_STEPS_BETWEEN_LOOKS, _STEPS_BETWEEN_LAST_LOOKS = 2, 8


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


def for_each_until(
    going: Callable[[_Carry], Bool[Array, "*batch"]],
    function: Callable[[int, _Carry, Any], _Carry],
    result: Callable[[_Carry, Any], _Result],
    carry: _Carry,
    given: Any,
    *,
    most: int,
    fewest_left: int = 512,
) -> _Result:
    """Repeat a function on an accelerator, for each member of a batch until that member is done.

    Thousands of members take each step together, but few need more than two or three steps. So those that go on are
    gathered into a smaller batch, and later into an even smaller one, of `fewest_left` at least.

    Args:
      going: `carry ->` which members go on.
      function: `(steps, carry, given) ->` the carry after so many more steps. Members that are done must not change.
      result: `(carry, given) ->` the result of members that are done, batch axes last.
      carry: arrays with the batch axes last. Only a batch with one axis shrinks.
      given: constants of each member, likewise.
      most: bound on the calls of `function` for one size of the batch.
      fewest_left: least number of places.
    """
    size = going(carry).size
    left = size // _ONE_IN if going(carry).ndim == 1 and size >= _ONE_IN * fewest_left else 0
    steps = _STEPS_BETWEEN_LOOKS if left else _STEPS_BETWEEN_LAST_LOOKS
    carry = until(
        lambda carry: jnp.sum(going(carry), dtype=jnp.int32) <= left,
        lambda carry: function(steps, carry, given),
        carry,
        most=most,
    )
    of_all = result(carry, given)
    if not left:
        return of_all
    # Spare places hold a member that is done: a copy of one that goes on would count as another one going on.
    members = jnp.nonzero(going(carry), size=left, fill_value=jnp.argmin(going(carry)))[0]
    rest = jax.tree.map(lambda leaf: leaf.at[..., members].get(mode="promise_in_bounds"), (carry, given))
    of_rest = for_each_until(going, function, result, *rest, most=most, fewest_left=fewest_left)
    return jax.tree.map(lambda leaf, own: leaf.at[..., members].set(own, mode="promise_in_bounds"), of_all, of_rest)
