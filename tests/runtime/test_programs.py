"""No class is run by the program of another, however alike the two are."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.runtime import programs
from dc2g_jax._src.runtime.programs import jit
from tests.support.compiling import compiled_count
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
    "searches, estimator",
    "training",
    "sweep",
    "translator",
    "indoor training",
    "environment",
    "pictures",
    "benchmark",
)


#: A constant that is too large for the code of one operation.
TABLE = np.arange(40 * 99, dtype=np.int32).reshape(40, 99)


@pytest.fixture(scope="module")
def verdicts() -> dict[str, str]:
    """What each boundary does where the structures of two classes collide, in a process of its own."""
    done = subprocess.run([sys.executable, "-m", "tests.support.collisions"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.slow
def test_two_classes_of_one_structure_are_told_apart(verdicts, boundary):
    assert verdicts[boundary] == "right"


@pytest.mark.slow
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
    assert compiled_count(added) == 1
    added(kind(2, jnp.int32(0)))
    assert compiled_count(added) == 2


def test_programs_of_classes_long_gone_are_dropped(monkeypatch):
    monkeypatch.setattr(programs, "_KEPT", 3)
    added = jit(lambda one: one.sum())
    kinds = [adder(number) for number in range(10)]
    for number, kind in enumerate(kinds):
        assert int(added(kind(1, jnp.int32(0)))) == number
    assert compiled_count(added) == 3
    assert int(added(kinds[0](1, jnp.int32(0)))) == 0


@pytest.mark.parametrize(
    ("function", "fits"),
    [
        (lambda cells: cells.sum(), True),
        (lambda cells: jnp.asarray(cells).at[0, cells[0, 0] % 9].set(7), True),
        (lambda cells: jnp.where(cells > 3, jnp.cumsum(cells, axis=0), jax.lax.population_count(cells)), True),
        (lambda cells: jax.lax.cond(cells[0, 0] > 3, lambda: cells + TABLE, lambda: cells - cells.argmax(0)), True),
        (lambda cells: cells.astype(jnp.float32).sum(), False),
        (lambda cells: cells.astype(jnp.uint8).max(0), False),
        (lambda cells: cells.astype(jnp.int16).min(0), True),
        (lambda cells: jnp.zeros(99).at[cells[0]].add(1.0), False),
        (lambda cells: jnp.sort(cells, axis=0), False),
        (lambda cells: cells.astype(jnp.float32) @ cells.astype(jnp.float32).T, False),
        (lambda cells: jax.pure_callback(np.sort, jax.ShapeDtypeStruct((40, 99), np.int32), cells), False),
    ],
)  # fmt: skip
def test_one_operation_where_the_compiler_has_code_for_it_and_the_same_result_elsewhere(function, fits):
    cells = np.random.default_rng(0).integers(9, size=(40, 99), dtype=np.int32)
    run = programs.jit(
        lambda cells: programs.one_operation(function, cells), compiler_options=programs.ONE_OPERATION_OPTIONS
    )
    assert programs.is_one_operation(jax.make_jaxpr(function)(cells).jaxpr) == fits
    assert ("xla_cpu_small_call" in run.lower(cells).as_text()) == fits
    np.testing.assert_allclose(run(cells), function(cells), rtol=1e-6)


def test_one_operation_may_do_without_an_argument():
    """XLA finds that the argument does not matter, and would end the process."""

    def only_one(cells, number):
        return jax.lax.fori_loop(0, 3, lambda _, sums: sums + cells[None].at[number].get(mode="clip"), cells)

    run = jax.jit(
        lambda *args: programs.one_operation(only_one, *args), compiler_options=programs.ONE_OPERATION_OPTIONS
    )
    cells = np.arange(40)
    np.testing.assert_array_equal(run(cells, 7), 4 * cells)
