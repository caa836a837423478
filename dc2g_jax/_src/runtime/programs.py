"""Compiled programs that never run one class's code for another.

`jax.jit` finds a compiled program by the structure of its arguments, and two dataclass nodes with equal fields compare
equal whatever their classes. So a program traced for one planner can be handed another planner. Every function that is
compiled here or in the commands goes through `jit` below, which also looks at the classes.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import Jaxpr, JaxprEqn, jaxprs_in_params

#: Programs that each function keeps, by the classes they were traced for; the oldest one is dropped. A process can map
#: only so much memory: on a CPU, rollout programs of some 200 classes exhausted it.
_KEPT = 64

_Result = TypeVar("_Result")


def node_types(tree: Any) -> tuple[type, ...]:
    """Classes of all nodes of a tree, in depth-first order; leaves have none."""
    found: list[type] = []
    structures: list[Any] = [jax.tree.structure(tree)]
    while structures:
        structure = structures.pop()
        node = structure.node_data()
        if node is not None:
            found.append(node[0])
            structures.extend(structure.children())
    return tuple(found)


class jit:
    """`jax.jit`, safe for classes of users: use it wherever a planner or anything else of theirs may be an argument.

    The function is compiled once for each structure, shape and dtype of its arguments, and for their classes. A class
    that is defined again under its old name is another class.

    Args:
      function: a pure function.
      **options: those of `jax.jit`.
    """

    def __init__(self, function: Callable[..., Any], **options: Any):
        functools.update_wrapper(self, function)
        # JAX keeps what it traced by the function's identity, so a new `partial` shares nothing with the others.
        self._new = lambda: jax.jit(functools.partial(function), **options)
        self._programs: dict[tuple[type, ...], Any] = {}
        self._lock = threading.Lock()

    def of(self, args: Any, kwargs: Any) -> Any:
        """The `jax.jit` of these arguments' classes, for those who call it often with the same ones."""
        types = node_types((args, kwargs))
        with self._lock:  # or two threads would each compile one
            if types not in self._programs:
                if len(self._programs) == _KEPT:
                    del self._programs[next(iter(self._programs))]
                self._programs[types] = self._new()
            return self._programs[types]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run the function, compiled."""
        return self.of(args, kwargs)(*args, **kwargs)

    def lower(self, *args: Any, **kwargs: Any) -> Any:
        """Lower the function for these arguments, as `jax.jit` does."""
        return self.of(args, kwargs).lower(*args, **kwargs)

    def trace(self, *args: Any, **kwargs: Any) -> Any:
        """Trace the function for these arguments, as `jax.jit` does."""
        return self.of(args, kwargs).trace(*args, **kwargs)


def count_programs() -> list[float]:
    """A list that grows by the seconds of each program that is compiled, or loaded from disk, from now on."""
    seconds: list[float] = []

    def hear(event: str, duration_secs: float, **_: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            seconds.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(hear)
    return seconds


# fmt: off
#: Primitives that XLA compiles within one operation of a CPU. Others call a library, or have no code there.
_WITHIN_ONE_OPERATION = frozenset({
    "abs", "add", "and", "argmax", "argmin", "bitcast_convert_type", "broadcast_in_dim", "clamp", "closed_call",
    "concatenate", "cond", "convert_element_type", "copy", "cumsum", "div", "dynamic_slice", "dynamic_update_slice",
    "eq", "exp", "floor", "gather", "ge", "gt", "integer_pow", "iota", "is_finite", "jit", "le", "log", "lt", "max",
    "min", "mul", "ne", "neg", "not", "optimization_barrier", "or", "pad", "pjit", "platform_index",
    "population_count", "reduce_and", "reduce_max", "reduce_min", "reduce_or", "reduce_sum", "rem", "reshape",
    "rev", "round", "scan", "select_n", "shift_left", "shift_right_arithmetic", "shift_right_logical", "sign",
    "slice", "sqrt", "square", "squeeze", "stack", "stop_gradient", "sub", "transpose", "while", "xor",
    "xla_metadata_value",
})
# fmt: on

#: Compiler options of programs with a part that is `one_operation`. Otherwise XLA divides loops among threads and large
#: sums in two, for which it has no code within an operation. Cores are devices here, so no speed is lost.
ONE_OPERATION_OPTIONS = {
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner,small-while-loop-hoisting,tree_reduction_rewriter"
}


def is_one_operation(jaxpr: Jaxpr) -> bool:
    """Whether XLA compiles a program within one operation of a CPU.

    It does not if the program calls a network, sorts, calls back, reduces floating-point numbers, seeks the least or
    largest of 8-bit integers, or scatters values to more than one place.
    """

    def fits(equation: JaxprEqn) -> bool:
        name = equation.primitive.name
        inputs: list[Any] = [variable.aval for variable in equation.invars]
        if name == "scatter":
            return inputs[1].size == inputs[1].shape[-1]  # the second input tells the places
        if name.startswith("reduce_") and jnp.issubdtype(inputs[0].dtype, jnp.inexact):
            return False
        if name in ("reduce_max", "reduce_min") and inputs[0].dtype.itemsize == 1:
            return False  # a library's, here
        return name in _WITHIN_ONE_OPERATION and all(map(is_one_operation, jaxprs_in_params(equation.params)))

    return all(map(fits, jaxpr.eqns))


def _called(function: Callable[..., _Result], program: Any, args: Any, **attributes: str) -> _Result:
    """`function(*args)` within a program; on a CPU, a call of its compiled `program` with these attributes."""

    def call(*args: Any) -> _Result:
        return jax.tree.map(functools.partial(set_xla_metadata, inlineable="false", **attributes), program(*args))

    if not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(args)):
        return function(*args)  # not within a program
    return jax.lax.platform_dependent(*args, cpu=call, default=function)


def apart(function: Callable[..., _Result], *args: Any) -> _Result:
    """`function(*args)` within a program, compiled by itself on a CPU.

    Its arguments are computed once. Fused with the function, they may be computed again for each of its elements.

    Args:
      function: a pure function.
      *args: its arguments.
    """
    return _called(function, jit(function), args)


def one_operation(function: Callable[..., _Result], *args: Any) -> _Result:
    """`function(*args)` within a program, as a single operation of the runtime on a CPU if `is_one_operation`.

    On boards of a few hundred words, starting an operation takes longer than computing it, and a planner step has some
    150 of them. The whole program must be compiled with `ONE_OPERATION_OPTIONS`.

    Args:
      function: a pure function. What it captures is as good as an argument.
      *args: its arguments.
    """
    leaves: list[Any]
    tree: Any
    leaves, tree = jax.tree.flatten(args)
    trace: Any = jax.make_jaxpr(lambda *leaves: function(*tree.unflatten(leaves)), return_shape=True)
    closed, shape = trace(*leaves)
    captured = [number for number, value in enumerate(closed.consts) if isinstance(value, jax.core.Tracer)]

    # XLA ends the process where an operation does not use one of its inputs, so each of them is also a result.
    @jax.jit
    def program(*inputs: Any) -> tuple[Any, Any]:
        given = dict(zip(captured, inputs[len(leaves) :], strict=True))
        constants = [given.get(number, value) for number, value in enumerate(closed.consts)]
        results = jax.core.eval_jaxpr(closed.jaxpr, constants, *inputs[: len(leaves)])
        return jax.tree.unflatten(jax.tree.structure(shape), results), inputs

    inputs = (*leaves, *(closed.consts[number] for number in captured))
    if not is_one_operation(closed.jaxpr):
        return program(*inputs)[0]
    return jax.lax.optimization_barrier(_called(program, program, inputs, xla_cpu_small_call="true"))[0]
