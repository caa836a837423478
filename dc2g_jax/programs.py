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
from jax.experimental.xla_metadata import set_xla_metadata

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

    def _of(self, args: Any, kwargs: Any) -> Any:
        """The program of these arguments' classes."""
        types = node_types((args, kwargs))
        with self._lock:  # or two threads would each compile one
            if types not in self._programs:
                if len(self._programs) == _KEPT:
                    del self._programs[next(iter(self._programs))]
                self._programs[types] = self._new()
            return self._programs[types]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Run the function, compiled."""
        return self._of(args, kwargs)(*args, **kwargs)

    def lower(self, *args: Any, **kwargs: Any) -> Any:
        """Lower the function for these arguments, as `jax.jit` does."""
        return self._of(args, kwargs).lower(*args, **kwargs)

    def trace(self, *args: Any, **kwargs: Any) -> Any:
        """Trace the function for these arguments, as `jax.jit` does."""
        return self._of(args, kwargs).trace(*args, **kwargs)

    def compiled_count(self) -> int:
        """Number of compiled programs that are kept."""
        return sum(program._cache_size() for program in self._programs.values())


def apart(function: Callable[..., _Result], *args: Any) -> _Result:
    """`function(*args)` within a program, compiled by itself on a CPU.

    Its arguments are computed once. Fused with the function, they may be computed again for each of its elements.

    Args:
      function: a pure function.
      *args: its arguments.
    """
    program = jit(function)

    def call(*args: Any) -> _Result:
        return jax.tree.map(functools.partial(set_xla_metadata, inlineable="false"), program(*args))

    return jax.lax.platform_dependent(*args, cpu=call, default=program)
