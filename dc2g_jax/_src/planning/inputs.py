"""What a robot's software gives to a planner, checked: maps and poses."""

import math
import operator
from typing import Any

import numpy as np
import numpy.typing as npt

from dc2g_jax._src.runtime.errors import InputError, check_number, short


def map_of(name: str, cells: npt.ArrayLike, kind: type, give: str) -> np.ndarray:
    """The cells of a map as an array, checked to be integers `[rows columns]`, at least one.

    Args:
      name: name of the map for messages.
      cells: an array, or lists of rows.
      kind: type of the integers.
      give: what to give instead, for messages.

    Raises:
      InputError: the cells are something else.
    """
    try:
        array = np.asarray(cells)
    except ValueError:
        raise InputError(f"{name} is {short(cells)}; give {give}") from None
    if array.ndim != 2 or array.size == 0 or not np.issubdtype(array.dtype, kind):
        raise InputError(f"{name} has dtype {array.dtype} and shape {array.shape}; give {give}")
    return array


def numbers_of(name: str, values: Any, count: int, *, whole: bool = False, limit: float = math.inf) -> tuple[Any, ...]:
    """Values as Python numbers, checked to be exactly `count`.

    Args:
      name: name of the values for messages.
      values: numbers of any type.
      count: how many there must be.
      whole: whether they must be integers.
      limit: largest absolute value.

    Raises:
      InputError: the values are something else.
    """
    convert: Any = operator.index if whole else float
    try:
        numbers = tuple(map(convert, values))
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"{name} is {short(values)}; give {count} {'whole numbers' if whole else 'numbers'}")
    for number in numbers:
        check_number(name, number, least=-limit, most=limit)
    return numbers
