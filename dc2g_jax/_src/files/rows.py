"""Rows of one type in a CSV file, saved immediately so that a run can be resumed."""

import csv
import itertools
import mmap
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import NoneType
from typing import Any, Generic, Literal, TypeVar, get_args, get_origin, get_type_hints

from dc2g_jax._src.files.reading import check_file
from dc2g_jax._src.files.tables import table_lines, write_table
from dc2g_jax._src.runtime.errors import InputError, short

#: A row of the file: a NamedTuple of strings, numbers and booleans, whose fields are the columns. Its first fields
#: identify the result.
_Row = TypeVar("_Row", bound=tuple)


def write_rows(path: Path, kind: type[_Row], rows: Sequence[_Row]) -> None:
    """Write rows of one type, with booleans as 1 and 0 and `None` as an empty cell."""
    write_table(path, [*get_type_hints(kind)], map(_cells, rows))


def _cells(row: tuple[Any, ...]) -> list[Any]:
    return [int(value) if isinstance(value, bool) else value for value in row]


def read_rows(path: Path, kind: type[_Row]) -> list[_Row]:
    """All rows of a file; see `rows_of`."""
    return list(rows_of(path, kind))


def rows_of(path: Path, kind: type[_Row]) -> Iterator[_Row]:
    """Read the rows of `write_rows` one by one. Fields that have a default or may be `None` may be empty or missing.

    A row may have a method `check`, which raises ValueError if its values contradict each other.

    Raises:
      InputError: the file cannot be read, a column is missing, or a value is invalid; the message names the line.
    """
    types, defaults = get_type_hints(kind), getattr(kind, "_field_defaults", {})
    optional = [name for name, one in types.items() if name in defaults or NoneType in get_args(one)]
    columns = [name for name in types if name not in optional]
    for line, cells in table_lines(path, columns, optional=optional, remedy="give the table of an earlier run"):
        try:
            values = {name: _value(types[name], cell) for name, cell in cells.items() if cell}
            row = kind(**{**dict.fromkeys(optional), **defaults, **values})
            getattr(row, "check", lambda: None)()
        except ValueError as error:
            raise InputError(
                f"{path}: line {line}: {error}; repair the line, or remove the file to run it anew"
            ) from None
        yield row


def _value(kind: Any, text: str) -> Any:
    """Convert a cell to a type."""
    if NoneType in get_args(kind):
        return _value(get_args(kind)[0], text)
    if get_origin(kind) is Literal:
        if text in get_args(kind):
            return text
        raise ValueError(f"{short(text)} is none of {', '.join(get_args(kind))}")
    if kind is bool and text not in ("0", "1"):
        raise ValueError(f"{short(text)} is neither 0 nor 1")
    if kind is int and not re.fullmatch(r"-?[0-9]{1,18}", text):
        raise ValueError(f"{short(text)} is not a whole number")
    return text == "1" if kind is bool else kind(text)


class ResumableTable(Generic[_Row]):
    """A file of results that grows. It is not held in memory.

    When a run is resumed, it returns the results in the file and computes the rest. A run must request them in the same
    order every time. If the process was killed, the last results may be incomplete.

    Args:
      path: the file.
      kind: type of its rows.

    Raises:
      InputError: the file exists and cannot be read.
    """

    def __init__(self, path: Path, kind: type[_Row]):
        self._path, self._kind = path, kind
        self._kept: Iterator[_Row] = iter(())
        if path.exists():
            check_file(path, "remove it, or give another folder")
            _drop_cut_off_line(path)
            with path.open(encoding="utf-8", errors="replace") as file:
                as_written_now = file.readline(2**16).strip() == ",".join(get_type_hints(kind))
            if not as_written_now:  # rows are added below
                write_rows(path, kind, read_rows(path, kind))
            self._kept = rows_of(path, kind)

    def next_results(self, asked: Sequence[tuple[Any, ...]], make: Callable[[], list[_Row]]) -> list[_Row]:
        """The next rows from the file. If it ends before the last of them, they are computed and appended.

        Args:
          asked: the first values of each row, which identify it.
          make: computes the rows.

        Raises:
          InputError: the file holds other rows, or one that cannot be read.
        """
        rows = list(itertools.islice(self._kept, len(asked)))
        self._check(rows, asked)
        if len(rows) < len(asked):
            made = make()
            self._check(made, asked)
            self._add(made[len(rows) :])
            rows = made
        return rows

    def _check(self, rows: Sequence[_Row], asked: Sequence[tuple[Any, ...]]) -> None:
        for row, values in zip(rows, asked, strict=False):
            if row[: len(values)] != values:
                raise InputError(
                    f"{self._path}: has {','.join(map(str, row[: len(values)]))} where this run has "
                    f"{','.join(map(str, values))}; remove the file to run it anew"
                )

    def _add(self, rows: Sequence[_Row]) -> None:
        if self._path.exists():
            with self._path.open("a", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows(map(_cells, rows))
        else:
            write_rows(self._path, self._kind, rows)


def _drop_cut_off_line(path: Path) -> None:
    """Remove an incomplete last line."""
    if size := path.stat().st_size:
        with path.open("r+b") as file:
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                end = data.rfind(b"\n") + 1
            if end < size:
                file.truncate(end)
