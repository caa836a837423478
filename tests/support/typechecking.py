"""The type checker that the import hook in `conftest.py` puts around every function of the package."""

import inspect
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping
import numpy.typing as npt
from beartype import BeartypeConf, beartype

_beartype = beartype(conf=BeartypeConf(is_pep484_tower=True))
_jaxtyped = jaxtyping.jaxtyped


def _uncheckable(hint: Any) -> bool:
    """Is this hint, or a member of this union, one whose check at run time is impossible or wrong?

    Protocols that are not declared checkable, and NumPy's `ArrayLike`, which leaves out tuples there.
    """
    if getattr(hint, "_is_protocol", False):
        return not getattr(hint, "_is_runtime_protocol", False)
    return hint == npt.ArrayLike or any(_uncheckable(member) for member in typing.get_args(hint))


def _names_shapes(hint: Any) -> bool:
    """May this hint, or a part of it, be one with shapes? A string may stand for any."""
    parts = hint if isinstance(hint, list) else typing.get_args(hint)
    return isinstance(hint, str) or getattr(hint, "__module__", "") == "jaxtyping" or any(map(_names_shapes, parts))


def jaxtyped(*, typechecker: Callable[..., Any]) -> Callable[..., Any]:
    """`jaxtyping.jaxtyped`, which binds shapes at every call, for all but functions whose hints name none."""

    def decorate(decorated: Any) -> Any:
        hints = decorated.__annotations__.values() if inspect.isfunction(decorated) else [""]
        if any(_names_shapes(hint) or _uncheckable(hint) for hint in hints):
            return _jaxtyped(decorated, typechecker=typechecker)
        return typechecker(decorated)

    return decorate


def check(function: Callable[..., Any]) -> Callable[..., Any]:
    """Check arguments and results of a function against its annotations.

    Constructors are left out: JAX rebuilds pytrees by calling them with whatever the leaves are at that moment
    (placeholders, axis numbers, shapes), which is no misuse of theirs.
    """
    if function.__name__ == "__init__":
        return function
    for name, hint in function.__annotations__.items():
        if _uncheckable(hint):
            function.__annotations__[name] = Any
    return _beartype(function)
