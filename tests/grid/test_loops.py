"""Loops until a condition end, even where the condition is wrong."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.loops import for_each_until, repeated, until


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


def test_members_that_go_on_are_gathered_into_smaller_batches():
    wanted = np.random.default_rng(0).geometric(0.6, size=5000)
    wanted[[0, -1]] = 40
    taken = collections.Counter()

    def count(steps, carry, wanted):
        jax.debug.callback(lambda: taken.update({len(wanted): steps}))
        for _ in range(steps):
            carry = carry + (carry < wanted)
        return carry, carry < wanted

    def run(wanted):
        return for_each_until(
            lambda carry: carry[1],
            lambda steps, carry, wanted: count(steps, carry[0], wanted),
            lambda carry, wanted: (carry[0], -wanted),
            (jnp.zeros_like(wanted), jnp.ones(len(wanted), bool)),
            wanted,
            most=50,
            fewest_left=64,
        )

    counted, negative = jax.jit(run)(jnp.asarray(wanted))
    jax.effects_barrier()
    np.testing.assert_array_equal(counted, wanted)
    np.testing.assert_array_equal(negative, -wanted)
    assert taken == {5000: 4, 625: 2, 78: 40}
