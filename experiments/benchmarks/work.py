"""How much work a program is: operations and bytes, counted while it runs through its loops."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, jaxpr_as_fun, jaxprs_in_params

from dc2g_jax._src.runtime.programs import jit

# fmt: off
#: Primitives that handle one element with one instruction, or a few.
_ELEMENTWISE = frozenset({
    "and", "or", "xor", "not", "shift_left", "shift_right_logical", "shift_right_arithmetic", "population_count",
    "add", "sub", "mul", "neg", "abs", "sign", "max", "min", "rem", "div", "select_n", "eq", "ne", "lt", "le", "gt",
    "ge", "clamp", "sqrt", "is_finite", "convert_element_type",
})
_REDUCTIONS = frozenset({
    "reduce_or", "reduce_and", "reduce_sum", "reduce_max", "reduce_min", "argmax", "argmin", "cumsum",
})
# fmt: on
_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}


class Work(NamedTuple):
    """Work of one call as its program is written, before the compiler merges anything.

    Attributes:
      operations: elements handled by elementwise and reducing operations. A word of 32 cells is one.
      bytes: read and written at the least: inputs and outputs once, and whatever a loop reads or carries once a turn.
    """

    operations: int
    bytes: int


def _size(variables: Sequence[Any]) -> int:
    return sum(int(np.prod(variable.aval.shape)) for variable in variables)


def _bytes(values: Sequence[Any]) -> int:
    return sum(np.asarray(value).nbytes for value in values)


def _operations(equations: Sequence[JaxprEqn]) -> int:
    """Operations of a straight program: one without loops and branches whose course depends on values."""
    count = 0
    for equation in equations:
        name = equation.primitive.name
        if name in _ELEMENTWISE:
            count += _size(equation.outvars)
        elif name in _REDUCTIONS:
            count += _size(equation.invars)
        else:
            turns = equation.params["length"] if name == "scan" else 1
            count += turns * sum(_operations(inner.eqns) for inner in jaxprs_in_params(equation.params))
    return count


def _branches(jaxpr: Jaxpr) -> bool:
    """Does a program's course depend on values?"""
    return any(
        equation.primitive.name in ("while", "cond")
        or any(_branches(inner) for inner in jaxprs_in_params(equation.params))
        for equation in jaxpr.eqns
    )


class _Counter:
    """Runs a program equation by equation and counts."""

    def __init__(self) -> None:
        self.operations = self.bytes = 0
        self._programs: dict[int, tuple[ClosedJaxpr, Callable[..., Any], int]] = {}

    def call(self, closed: ClosedJaxpr, arguments: Sequence[Any]) -> list[Any]:
        """Run a program: as a whole where it is straight, else step by step."""
        key = id(closed.jaxpr)
        if key not in self._programs:
            if _branches(closed.jaxpr):
                self._programs[key] = (closed, lambda *values: self._steps(closed, values), 0)
            else:
                self._programs[key] = (closed, jit(jaxpr_as_fun(closed)), _operations(closed.jaxpr.eqns))
        _, run, operations = self._programs[key]
        self.operations += operations
        return list(run(*arguments))

    def _steps(self, closed: ClosedJaxpr, arguments: Sequence[Any]) -> list[Any]:
        jaxpr = closed.jaxpr
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *arguments], strict=True))

        def read(variable: Any) -> Any:
            return variable.val if isinstance(variable, Literal) else values[variable]

        for equation in jaxpr.eqns:
            inputs = [read(variable) for variable in equation.invars]
            values.update(zip(equation.outvars, self._equation(equation, inputs), strict=True))
        return [read(variable) for variable in jaxpr.outvars]

    def _equation(self, equation: Any, inputs: list[Any]) -> list[Any]:
        name, params = equation.primitive.name, equation.params
        if name == "while":
            return self._loop(params, inputs)
        if name == "scan" and _branches(params["jaxpr"].jaxpr):
            return self._scan(params, inputs)
        if name == "cond":
            index, *operands = inputs
            return self.call(params["branches"][int(index)], operands)
        if name in _CALLS and isinstance(params.get(_CALLS[name]), ClosedJaxpr):
            return self.call(params[_CALLS[name]], inputs)
        if any(_branches(inner) for inner in jaxprs_in_params(params)):
            raise NotImplementedError(f"cannot count inside {name}")
        self.operations += _operations([equation])
        outputs = equation.primitive.bind(*inputs, **params)
        return list(outputs) if equation.primitive.multiple_results else [outputs]

    def _loop(self, params: dict[str, Any], inputs: list[Any]) -> list[Any]:
        n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
        cond_consts, body_consts, carry = inputs[:n_cond], inputs[n_cond : n_cond + n_body], inputs[n_cond + n_body :]
        # A loop that holds another leaves the counting of bytes to it.
        outer = _branches(params["body_jaxpr"].jaxpr)
        bytes_a_turn = 0 if outer else _bytes(body_consts) + 2 * _bytes(carry)
        while bool(self.call(params["cond_jaxpr"], [*cond_consts, *carry])[0]):
            carry = self.call(params["body_jaxpr"], [*body_consts, *carry])
            self.bytes += bytes_a_turn
        return carry

    def _scan(self, params: dict[str, Any], inputs: list[Any]) -> list[Any]:
        n_consts, n_carry = params["num_consts"], params["num_carry"]
        consts, carry, given = inputs[:n_consts], inputs[n_consts : n_consts + n_carry], inputs[n_consts + n_carry :]
        rows = range(params["length"])
        made = []
        for row in reversed(rows) if params["reverse"] else rows:
            found = self.call(params["jaxpr"], [*consts, *carry, *(leaf[row] for leaf in given)])
            carry = found[:n_carry]
            made.append(found[n_carry:])
        if params["reverse"]:
            made.reverse()
        return [*carry, *map(jnp.stack, zip(*made, strict=True))]


def count_work(function: Callable[..., Any], *arguments: Any) -> Work:
    """Count the work of one call, by running it."""
    flat = jax.tree.leaves(arguments)
    counter = _Counter()
    outputs = counter.call(jax.make_jaxpr(function)(*arguments), flat)
    return Work(counter.operations, counter.bytes + _bytes(flat) + _bytes(outputs))
