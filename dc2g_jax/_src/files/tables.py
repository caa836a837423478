"""Tables: strict reading of CSV files, with one-line errors that name file and line, atomic writing, printing."""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from io import BufferedIOBase
from pathlib import Path

from dc2g_jax._src.files.atomic import replacing
from dc2g_jax._src.files.reading import check_file, opened, read_lines
from dc2g_jax._src.runtime.errors import InputError, check_number, short

#: Most bytes of a line, and of a table that is read as a whole.
_LONGEST_LINE, _LARGEST_TABLE = 2**20, 2**22


def read_table(path: Path, columns: Sequence[str], *, remedy: str) -> list[tuple[int, dict[str, str]]]:
    """The rows of a small CSV file, at least one; see `table_lines`."""
    check_file(path, remedy, at_most=_LARGEST_TABLE)
    return list(table_lines(path, columns, remedy=remedy))


def table_lines(
    path: Path, columns: Sequence[str], *, optional: Sequence[str] | None = (), remedy: str
) -> Iterator[tuple[int, dict[str, str]]]:
    """Go through the named columns of a CSV file with a header row, whatever its length.

    A byte-order mark, CRLF line ends, blank lines, further columns and a missing final line end are accepted. Values
    are stripped of surrounding blanks. `optional` columns may be absent or empty; `None` stands for all the rest.

    Yields:
        A tuple `(line number, {column: value})` for each row, in file order; at least one.

    Raises:
        InputError: the file is missing, unreadable or not UTF-8, lacks a required column or a value in one, has a
            column twice, or has no rows.
    """
    header: list[str] | None = None
    empty = True
    try:
        with opened(path, remedy) as file:
            csv.field_size_limit(_LONGEST_LINE)  # the actions of an episode on a large map are many
            reader = csv.reader(_texts(path, file, remedy), skipinitialspace=True)
            for row in reader:
                cells = [cell.strip() for cell in row]
                if not any(cells):
                    continue
                if header is None:
                    header = cells
                    optional = header if optional is None else optional
                    _check_header(path, header, columns, optional)
                    continue
                empty = False
                yield reader.line_num, _pick(path, reader.line_num, header, cells, columns, optional or ())
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num} is not CSV ({error}); repair the file") from None
    if empty:
        found = "is empty" if header is None else f"has the header {short(','.join(header))} but no rows"
        raise InputError(f"{path}: {found}; expected a header with {','.join(columns)} and one row an entry")


def whole_cell(where: str, text: str, low: int, high: int) -> int:
    """The whole number of at most nine digits in a cell of a table, within bounds; `where` begins a message."""
    # `int` alone would accept spellings that do not belong in a table.
    number = int(text) if re.fullmatch(r"-?[0-9]{1,9}", text) else text
    check_number(where, number, whole=True, least=low, most=high)
    return int(number)


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a CSV file with a header row, atomically.

    Args:
        path: the CSV file.
        columns: names for the header.
        rows: values in the order of the columns.
    """
    with replacing(path) as unfinished, unfinished.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def text_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table as text in aligned columns: the first column on the left of its place, the others on the right."""
    lines = [[str(cell) for cell in row] for row in (columns, *rows)]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    return "\n".join("   ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]) for line in lines)


def _texts(path: Path, file: BufferedIOBase, remedy: str) -> Iterator[str]:
    for number, line in read_lines(file, path, at_most=_LONGEST_LINE):
        try:
            yield line.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            byte = line[error.start]
            raise InputError(f"{path}: line {number}: byte 0x{byte:02x} is not UTF-8 text; {remedy}") from None


def _check_header(path: Path, header: list[str], columns: Sequence[str], optional: Sequence[str]) -> None:
    missing = [column for column in columns if column not in header]
    if missing:
        raise InputError(
            f"{path}: the header {short(','.join(header))} lacks the column {', '.join(map(repr, missing))}; "
            f"the first line must name {','.join(columns)}, with commas between"
        )
    for column in (*columns, *optional):
        if header.count(column) > 1:
            raise InputError(f"{path}: the header {short(','.join(header))} names {column!r} twice; leave one of them")


def _pick(
    path: Path, line: int, header: list[str], cells: list[str], columns: Sequence[str], optional: Sequence[str]
) -> dict[str, str]:
    if len(cells) > len(header):
        raise InputError(f"{path}: line {line} has {len(cells)} values for {len(header)} columns; repair the line")
    values = dict(zip(header, cells, strict=False))
    for column in columns:
        if not values.get(column):
            raise InputError(f"{path}: line {line} has no value in column {column!r}; fill it in or delete it")
    return {column: values.get(column, "") for column in (*columns, *optional)}
