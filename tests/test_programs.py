"""No class is run by the program of another, however alike the two are."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest
from flax import struct

from dc2g_jax import programs
from dc2g_jax.programs import jit
from tests.support.places import ROOT

#: Where a user's class enters a compiled program; see `tests.support.collisions`.
BOUNDARIES = (
    "rollout, first state",
    "rollout, steps",
    "rollout, estimator",
    "masks",
    "replay",
    "replay, estimator",
    "online, planner",
    "online, estimator",
    "fleet",
    "searches, guide",
    "training",
    "sweep",
    "translator",
    "indoor training",
    "environment",
    "pictures",
    "benchmark",
)


@pytest.fixture(scope="module")
def verdicts() -> dict[str, str]:
    """What each boundary does where the structures of two classes collide, in a process of its own."""
    done = subprocess.run([sys.executable, "-m", "tests.support.collisions"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_two_classes_of_one_structure_are_told_apart(verdicts, boundary):
    assert verdicts[boundary] == "right"


def test_every_boundary_is_looked_at(verdicts):
    assert sorted(verdicts) == sorted(BOUNDARIES)


def adder(number: int):
    """A class that adds its own number; all have one structure and one name."""

    @struct.dataclass
    class Adder:
        limit: int = struct.field(pytree_node=False)
        value: jax.Array

        def sum(self):
            return self.value + number

    return Adder


def test_a_class_defined_again_under_its_name_is_another():
    added = jit(lambda one: one.sum())
    assert [int(added(adder(number)(1, jnp.int32(0)))) for number in range(300)] == list(range(300))


def test_classes_deep_within_the_arguments_count():
    added = jit(lambda nested, *, plus: nested["deep"][0].sum() + plus.sum())
    for number in range(40):
        one, other = adder(number)(1, jnp.int32(0)), adder(100)(1, jnp.int32(0))
        assert int(added({"deep": (one, None)}, plus=other)) == number + 100
        assert int(added({"deep": (other, None)}, plus=one)) == number + 100


def test_other_values_of_one_class_share_a_program():
    added, kind = jit(lambda one: one.sum()), adder(1)
    assert [int(added(kind(1, jnp.int32(value)))) for value in range(5)] == [1, 2, 3, 4, 5]
    assert added.compiled_count() == 1
    added(kind(2, jnp.int32(0)))
    assert added.compiled_count() == 2


def test_programs_of_classes_long_gone_are_dropped(monkeypatch):
    monkeypatch.setattr(programs, "_KEPT", 3)
    added = jit(lambda one: one.sum())
    kinds = [adder(number) for number in range(10)]
    for number, kind in enumerate(kinds):
        assert int(added(kind(1, jnp.int32(0)))) == number
    assert added.compiled_count() == 3
    assert int(added(kinds[0](1, jnp.int32(0)))) == 0
