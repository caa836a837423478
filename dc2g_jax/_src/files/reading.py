"""Reading of files that others made: nothing is decoded before its kind and size are known.

A file may be a device or a pipe, which never ends; compressed data, a nested document or a declared size may need far
more memory than the file has bytes. Readers of this package therefore open files here, say how many bytes they take,
and check types before values.
"""

import contextlib
import io
import json
import math
import stat
from collections.abc import Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dc2g_jax._src.runtime.errors import InputError, check_number, short

#: Largest sizes, in bytes: of files of facts, such as the card of a network; of other texts; of pictures and arrays.
FACTS, TEXT, PIXELS = 2**20, 2**26, 2**28

#: Most digits of a whole number in a document, and most levels of one in YAML.
_MOST_DIGITS, _DEEPEST_YAML = 18, 8


def check_file(path: Path, remedy: str, *, at_most: int | None = None) -> None:
    """Check the kind and the size of a file without opening it.

    Args:
      path: the file.
      remedy: end of the message: what to do.
      at_most: largest size in bytes; `None` for any.

    Raises:
      InputError: there is no such file, it is a folder, a device or a pipe, or it is larger.
    """
    try:
        found = path.stat()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {remedy}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {remedy}") from None
    except ValueError as error:  # NUL, or characters that no file name has
        raise InputError(f"{path}: is not the name of a file ({error}); {remedy}") from None
    if not stat.S_ISREG(found.st_mode):
        kind = "a folder" if stat.S_ISDIR(found.st_mode) else "a device or a pipe"
        raise InputError(f"{path}: cannot be read (is {kind}, not a file); {remedy}")
    if at_most is not None and found.st_size > at_most:
        raise InputError(f"{path}: has {found.st_size} bytes, more than the {at_most} that are read; {remedy}")


@contextlib.contextmanager
def opened(path: Path, remedy: str, *, at_most: int | None = None) -> Iterator[BufferedIOBase]:
    """Open a file to read bytes, checked as by `check_file`. Errors of reading in the block are `InputError`s too."""
    check_file(path, remedy, at_most=at_most)
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}); {remedy}") from None


def read_bytes(path: Path, remedy: str, *, at_most: int) -> bytes:
    """The bytes of a file, checked as by `check_file`."""
    with opened(path, remedy, at_most=at_most) as file:
        return file.read(at_most)


def read_text(path: Path, remedy: str, *, at_most: int) -> str:
    """The text of a file in UTF-8, without its byte-order mark.

    Raises:
      InputError: see `check_file`, or it is not UTF-8.
    """
    data = read_bytes(path, remedy, at_most=at_most)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte 0x{data[error.start]:02x} at offset {error.start} is not UTF-8 text; {remedy}"
        ) from None


def read_lines(file: BufferedIOBase, path: Path, *, at_most: int) -> Iterator[tuple[int, bytes]]:
    """The lines of an open file with their numbers, from 1.

    Raises:
      InputError: a line has more than `at_most` bytes.
    """
    number = 0
    while line := file.readline(at_most + 1):
        number += 1
        if len(line) > at_most:
            raise InputError(f"{path}: line {number} has more than {at_most} bytes; repair or delete the line")
        yield number, line


def parse_json(text: str | bytes) -> Any:
    """The value of a JSON document. NaN and infinities are accepted, since Python writes them.

    Raises:
      ValueError: it is not JSON, is nested too deeply, or has a whole number of more than 18 digits.
    """
    try:
        return json.loads(text, parse_int=_few_digits)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _few_digits(digits: str) -> int:
    if len(digits) > _MOST_DIGITS + 1:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def number(value: Any) -> float:
    """A number of a JSON document. Raises TypeError for other values, such as text and booleans."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{short(value)} is not a number")
    return float(value)


def whole_number(value: Any) -> int:
    """A whole number of a JSON document. Raises TypeError for other values, such as 1.5."""
    if number(value) != int(value):
        raise TypeError(f"{short(value)} is not a whole number")
    return int(value)


def finite_number(where: str, value: Any, remedy: str) -> float:
    """A finite number of a document or table, or the one that a text writes.

    Args:
      where: begins the message: the file, and the place in it.
      value: the number or text.
      remedy: end of the message: what to do.

    Raises:
      InputError: it is something else.
    """
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            value = float(value)
    check_number(where, value, hint=f"({remedy})")
    return float(value)


def read_object(path: Path, remedy: str, *, at_most: int = FACTS) -> dict[str, Any]:
    """The JSON object in a file.

    Raises:
      InputError: see `check_file`, or the file holds no JSON object.
    """
    text = read_text(path, remedy, at_most=at_most)
    try:
        facts = parse_json(text)
    except ValueError as error:
        raise InputError(f"{path}: cannot be read (not JSON: {error}); {remedy}") from None
    if not isinstance(facts, dict):
        raise InputError(f"{path}: holds {short(facts)}, which is no JSON object; {remedy}")
    return facts


class _PlainLoader(yaml.SafeLoader):
    """YAML without aliases, which may stand for documents of any size, and of few levels."""

    _level = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, unless it is an alias or lies too deep."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not read")
        self._level += 1
        if self._level > _DEEPEST_YAML:
            raise yaml.YAMLError("nested too deeply")
        node = super().compose_node(parent, index)
        self._level -= 1
        return node


def read_yaml(path: Path, remedy: str) -> Any:
    """The value of a YAML document of at most 16 KiB, without aliases and not nested deeply."""
    text = read_text(path, remedy, at_most=2**14)
    try:
        return yaml.load(text, _PlainLoader)
    except yaml.MarkedYAMLError as error:
        where = f" line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise InputError(f"{path}:{where} is not YAML ({error.problem}); repair the file") from None
    except Exception as error:  # invalid dates and numbers, characters, aliases: many kinds of errors
        raise InputError(f"{path}: is not YAML ({' '.join(str(error).split())}); repair the file") from None


def read_array(path: Path, remedy: str) -> np.ndarray:
    """The array of a `.npy` file, of numbers or booleans."""
    data = read_bytes(path, remedy, at_most=PIXELS)
    try:
        return _array_of(data)
    except Exception as error:  # a damaged header raises many kinds of errors
        raise InputError(f"{path}: is not a plain array ({str(error) or type(error).__name__}); {remedy}") from None


def _array_of(data: bytes) -> np.ndarray:
    """The array of the bytes of an `.npy` file, whose header is checked before memory is taken. Read-only."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in headers:
        raise ValueError(f"its format has the version {version}")
    shape, by_columns, dtype = headers[version](stream)
    if dtype.kind not in "buif" or min(shape, default=1) < 0:
        raise ValueError(f"it holds {short(dtype)} of shape {short(shape)}")
    content = memoryview(data)[stream.tell() :]
    if math.prod(shape) * dtype.itemsize != len(content):
        raise ValueError(f"it declares {short(shape)} and has {len(content)} bytes")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if by_columns else "C")
