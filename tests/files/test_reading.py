"""What others made is read within a budget: kind and size first, then types, then values."""

import io
import itertools
import os
import time

import numpy as np
import pytest

from dc2g_jax._src.files.reading import (
    number,
    parse_json,
    read_array,
    read_bytes,
    read_lines,
    read_object,
    read_text,
    read_yaml,
    whole_number,
)
from dc2g_jax._src.runtime.errors import LONGEST_MESSAGE, InputError, short
from tests.support.refusals import refusal

REMEDY = "give another"


def test_a_message_is_one_line_of_bounded_length():
    message = str(InputError(f"a.yaml: has {'x' * 10**6}\nand\x1b[31m\x00; write a number"))
    assert len(message) == LONGEST_MESSAGE
    assert message.startswith("a.yaml: has xxx")
    assert message.endswith("xxx and?[31m?; write a number")
    assert str(InputError("für Häuser: ok")) == "für Häuser: ok"


@pytest.mark.parametrize(
    "value",
    ["x" * 10**6, b"x" * 10**6, 10**5000, [[[[[1] * 99] * 99] * 99] * 99] * 99, dict.fromkeys(range(10**5), "x" * 99)],
    ids=["text", "bytes", "number", "lists", "dictionary"],
)
def test_values_of_any_size_are_shortened_in_no_time(value):
    began = time.perf_counter()
    assert len(short(value)) <= 60
    assert time.perf_counter() - began < 1


def test_short_values_are_as_in_python():
    for value in (None, True, 3, 0.5, "word", [1, 2], {"a": 1}, (), float("nan")):
        assert short(value) == repr(value)


def test_only_files_of_a_bounded_size_are_read(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes(path, REMEDY, at_most=5) == b"12345"
    refusal(lambda: read_bytes(path, REMEDY, at_most=4), path, "has 5 bytes, more than the 4 that are read", REMEDY)
    os.mkfifo(tmp_path / "pipe")
    for name, kind in (("pipe", "a device or a pipe"), (".", "a folder")):
        refusal(lambda name=name: read_bytes(tmp_path / name, REMEDY, at_most=5), tmp_path, kind, REMEDY)
    refusal(lambda: read_bytes(tmp_path / "none", REMEDY, at_most=5), "no such file", REMEDY)
    refusal(lambda: read_bytes(tmp_path / "nu\0l", REMEDY, at_most=5), "not the name of a file", REMEDY)
    refusal(lambda: read_bytes(path / "below", REMEDY, at_most=5), "Not a directory", REMEDY)
    (tmp_path / "zero").symlink_to("/dev/zero")
    refusal(lambda: read_bytes(tmp_path / "zero", REMEDY, at_most=5), "a device or a pipe", REMEDY)


def test_text_is_utf_8(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"\xef\xbb\xbfH\xc3\xa4user")
    assert read_text(path, REMEDY, at_most=99) == "Häuser"
    path.write_bytes(b"H\xe4user")
    refusal(lambda: read_text(path, REMEDY, at_most=99), path, "byte 0xe4 at offset 1", REMEDY)


def test_lines_are_bounded(tmp_path):
    lines = io.BufferedReader(io.BytesIO(b"1234\n\n123\n12"))
    assert list(read_lines(lines, tmp_path, at_most=5)) == [(1, b"1234\n"), (2, b"\n"), (3, b"123\n"), (4, b"12")]
    lines.seek(0)
    refusal(lambda: list(read_lines(lines, tmp_path, at_most=4)), tmp_path, "line 1 has more than 4 bytes")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, "9" * 401, "-" + "9" * 5000, '{"a": ' + "1" * 30 + "}", "{", "", "nul"]
)
def test_json_that_is_not_read(tmp_path, text):
    with pytest.raises(ValueError, match=r"^\S"):
        parse_json(text)
    (tmp_path / "a.json").write_text(text)
    refusal(lambda: read_object(tmp_path / "a.json", REMEDY), tmp_path / "a.json", "not JSON", REMEDY)


def test_types_of_json(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": [1, -2.5, NaN, "1", true, null, 3.0, 1e999]}')
    values = read_object(path, REMEDY)["a"]
    assert [number(value) for value in (*values[:2], values[6])] == [1.0, -2.5, 3.0]
    assert [whole_number(value) for value in (values[0], values[6])] == [1, 3]
    for value in values[3:6]:
        with pytest.raises(TypeError, match="is not a number"):
            number(value)
    for value in (*values[1:6], values[7]):
        with pytest.raises((TypeError, ValueError, OverflowError)):
            whole_number(value)
    for other in ("[1]", "3", "null"):
        path.write_text(other)
        refusal(lambda: read_object(path, REMEDY), path, "no JSON object", REMEDY)


ALIASES = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join([f'*{before}'] * 9)}]\n" for before, name in itertools.pairwise("abcdefghijklm")
)


@pytest.mark.parametrize(
    ("text", "mention"),
    [
        (ALIASES, "aliases are not read"),
        ("[" * 5000, "nested too deeply"),
        ("- " * 5000, "nested too deeply"),
        ("? " * 5000, "nested too deeply"),
        ("{a: " * 4000, "nested too deeply"),
        ("a: 2026-13-45", "month"),
        ("a: \x00", "special characters"),
        ("a: " + "9" * 5000, "4300 digits"),
        ("a: !!python/object/apply:os.getcwd []", "line 1"),
        ("x" * 2**15, "more than the 16384"),
    ],
    ids=lambda text: text[:9],
)
def test_yaml_that_is_not_read(tmp_path, text, mention):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    began = time.perf_counter()
    refusal(lambda: read_yaml(path, REMEDY), path, mention)
    assert time.perf_counter() - began < 3


def test_yaml_of_facts(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: 0.5\nb: [1, -0.5, .inf]\nc: {d: [no, 'x']}\n")
    assert read_yaml(path, REMEDY) == {"a": 0.5, "b": [1, -0.5, float("inf")], "c": {"d": [False, "x"]}}


@pytest.mark.parametrize(
    "array", [np.arange(12, dtype=np.int16).reshape(3, 4), np.zeros((0, 2)), np.float32(3)], ids=str
)
def test_arrays_come_back(tmp_path, array):
    for order in "CF":
        np.save(tmp_path / "a.npy", np.asarray(array, order=order))
        found = read_array(tmp_path / "a.npy", REMEDY)
        assert found.dtype == array.dtype
        np.testing.assert_array_equal(found, array)


def declaring(shape: str, dtype: str = "<i8") -> bytes:
    header = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(16)


@pytest.mark.parametrize(
    ("data", "mention"),
    [
        (declaring("(10000000000,)"), "declares (10000000000,) and has 16 bytes"),
        (declaring("(4611686018427387906, 4)"), "and has 16 bytes"),
        (declaring("(-2,)"), "(-2,)"),
        (declaring("(2,)", "|O"), "dtype('O')"),
        (declaring("(4,)", "<U1"), "<U1"),
        (declaring("(2,)").replace(b"NUMPY\x01", b"NUMPY\x03"), "version (3, 0)"),
        (declaring("(2,)")[:-1], "has 15 bytes"),
        (b"", "magic"),
    ],
    ids=str,
)
def test_arrays_that_are_not_read(tmp_path, data, mention):
    (tmp_path / "a.npy").write_bytes(data)
    refusal(lambda: read_array(tmp_path / "a.npy", REMEDY), tmp_path / "a.npy", "not a plain array", mention, REMEDY)
