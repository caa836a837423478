"""Results of a run in a CSV file, kept as soon as they are there: the run can go on where it stopped."""

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Generic, Literal, TypeVar, get_args, get_origin, get_type_hints

from dc2g_jax.errors import InputError
from dc2g_jax.files.tables import read_table, write_table

#: A NamedTuple of text, numbers, yes and no; a row of the file, its fields the columns. It begins with the fields that
#: say what it is the result of.
_Row = TypeVar("_Row", bound=tuple)


def write_rows(path: Path, kind: type[_Row], rows: Sequence[_Row]) -> None:
    """Write rows of one type: yes and no as 1 and 0, `None` as nothing."""
    cells = [[int(value) if isinstance(value, bool) else value for value in row] for row in rows]
    write_table(path, [*get_type_hints(kind)], cells)


def read_rows(path: Path, kind: type[_Row]) -> list[_Row]:
    """Read what `write_rows` wrote. Fields with a default, or that may be `None`, may be empty or absent.

    Raises:
      InputError: for a file that cannot be read, a missing column, or a value that is none; names the line.
    """
    types, defaults = get_type_hints(kind), getattr(kind, "_field_defaults", {})
    optional = [name for name, one in types.items() if name in defaults or NoneType in get_args(one)]
    columns = [name for name in types if name not in optional]
    rows = []
    for line, cells in read_table(path, columns, optional=optional, remedy="give the table of an earlier run"):
        try:
            values = {name: _value(types[name], cell) for name, cell in cells.items() if cell}
        except ValueError as error:
            raise InputError(
                f"{path}: line {line}: {error}; repair the line, or remove the file to run it anew"
            ) from None
        rows.append(kind(**{**dict.fromkeys(optional), **defaults, **values}))
    return rows


def _value(kind: Any, text: str) -> Any:
    """A cell as a value of a type."""
    if NoneType in get_args(kind):
        return _value(get_args(kind)[0], text)
    if get_origin(kind) is Literal:
        if text in get_args(kind):
            return text
        raise ValueError(f"{text!r} is none of {', '.join(get_args(kind))}")
    return bool(int(text)) if kind is bool else kind(text)


class ResumableTable(Generic[_Row]):
    """A file of results, written anew whenever there are more.

    Opened where a run is resumed, it gives back what is there and has the rest made. A run asks in the same order every
    time.

    Args:
      path: the file.
      kind: type of its rows.

    Raises:
      InputError: the file is there and cannot be read.
    """

    def __init__(self, path: Path, kind: type[_Row]):
        self._path, self._kind = path, kind
        self._rows = read_rows(path, kind) if path.exists() else []
        self._given = 0

    def next_results(self, asked: Sequence[tuple[Any, ...]], make: Callable[[], list[_Row]]) -> list[_Row]:
        """The next rows: from the file, or, where it ends, new ones, which it then holds too.

        Args:
          asked: the values that each row begins with.
          make: makes the rows.

        Raises:
          InputError: the file holds other rows.
        """
        first, after = self._given, self._given + len(asked)
        if asked and first == len(self._rows):
            self._rows += make()
            write_rows(self._path, self._kind, self._rows)
        rows = self._rows[first:after]
        for row, values in itertools.zip_longest(rows, asked):
            found = () if row is None else row[: len(values)]
            if found != values:
                raise InputError(
                    f"{self._path}: has {','.join(map(str, found)) or 'nothing'} where this run has "
                    f"{','.join(map(str, values))}; remove the file to run it anew"
                )
        self._given = after
        return rows
