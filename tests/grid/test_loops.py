"""Loops until a condition end, even where the condition is wrong."""

import jax
import jax.numpy as jnp
import pytest

from dc2g_jax.grid.loops import repeated, until


@pytest.mark.parametrize(("start", "wanted"), [(0, 10), (7, 10), (10, 10), (12, 12)])
def test_a_loop_ends_when_it_is_done(start, wanted):
    run = jax.jit(lambda number: until(lambda one: one >= 10, lambda one: one + 1, number, most=10))
    assert run(jnp.int32(start)) == wanted


def test_a_loop_that_is_never_done_ends_too():
    run = jax.jit(lambda number: until(lambda one: jnp.bool_(False), lambda one: one + 2, number, most=10))
    assert run(jnp.int32(0)) == 20


def test_a_loop_of_known_length_counts_its_rounds():
    run = jax.jit(lambda number: repeated(5, lambda count, one: 10 * one + count, number))
    assert run(jnp.int32(9)) == 901234
