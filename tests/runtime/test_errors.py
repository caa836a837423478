"""Checks of numbers and names, and the one line that they raise."""

import math

import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError, check_name, check_number, short
from tests.support.refusals import refusal


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (0, {"whole": True, "least": 1}, "--starts 0: give a whole number of at least 1"),
        (1.5, {"whole": True, "least": 1}, "--starts 1.5: give a whole number of at least 1"),
        (True, {"whole": True, "least": 1}, "--starts True: give a whole number of at least 1"),
        (65, {"whole": True, "least": 1, "most": 64}, "--starts 65: give a whole number from 1 to 64"),
        (0.0, {"above": 0, "hint": "meters"}, "--starts 0.0: give a number above 0 meters"),
        (-1, {"whole": True, "least": 0, "most": 2**32 - 1}, "--starts -1: give a whole number from 0 to 4294967295"),
        (2.0, {"above": 0, "most": 1}, "--starts 2.0: give a number above 0 and of at most 1"),
        (math.nan, {}, "--starts nan: give a number"),
        (math.inf, {"least": 0}, "--starts inf: give a number of at least 0"),
        ("3", {"least": 0}, "--starts '3': give a number of at least 0"),
    ],
)
def test_numbers_out_of_bounds(value, bounds, message):
    assert refusal(lambda: check_number("--starts", value, **bounds)) == message


@pytest.mark.parametrize(
    ("value", "bounds"),
    [
        (1, {"whole": True, "least": 1}),
        (np.int32(3), {"whole": True}),
        (1e-9, {"above": 0}),
        (np.float32(1), {"most": 1}),
    ],
)
def test_numbers_within_bounds(value, bounds):
    check_number("--starts", value, **bounds)


def test_names():
    check_name("split", "val", ("train", "val"))
    assert refusal(lambda: check_name("split", "vla", ("train", "val"))) == (
        "no split is called 'vla'; give one of train, val"
    )


def test_of_many_names_those_most_alike_are_listed():
    known = [f"house{number:03}" for number in range(100)]
    message = refusal(lambda: check_name("house", "house1", known, "(--dataset says which)"))
    assert message.startswith("no house is called 'house1'; give one of house0")
    assert message.endswith(", ... (--dataset says which)")
    assert "house000, house001, house002, ..." in refusal(lambda: check_name("house", "yard", known))


def test_classes_are_written_without_the_module_that_defines_them():
    assert short(InputError) == "<class 'InputError'>"
