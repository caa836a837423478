import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dc2g_jax.robot.driving.vehicle import VehicleLimits, VehicleState, at_rest, drive
from tests.oracles.vehicle_oracle import driven

LIMITS = VehicleLimits(max_speed=2.0, max_turn_rate=3.0, max_acceleration=4.0, max_turn_acceleration=20.0, radius=0.4)
SECONDS = 0.25


def real(low: float, high: float):
    return st.floats(low, high, width=32)


@pytest.fixture(scope="module")
def drives():
    return jax.jit(lambda state, command: drive(state, command, LIMITS, SECONDS))


def state_of(values) -> VehicleState:
    x, y, yaw, speed, turn_rate = (jnp.float32(value) for value in values)
    return VehicleState(jnp.stack([x, y]), yaw, speed, turn_rate)


states = st.tuples(real(-50, 50), real(-50, 50), real(-3, 3), real(0, 2), real(-3, 3))
commands = st.tuples(
    st.one_of(real(-5, 5), st.sampled_from([np.inf, -np.inf])),
    st.one_of(real(-9, 9), st.sampled_from([0.0, 1e-6, -1e-4, np.inf, -np.inf])),
)


@settings(max_examples=50)
@given(values=states, command=commands)
def test_the_arc_is_that_of_many_small_steps(drives, values, command):
    after = drives(state_of(values), jnp.array(command, jnp.float32))
    x, y, yaw, _, _ = values
    expected = driven([x, y], yaw, float(after.speed), float(after.turn_rate), SECONDS, 500)[-1]
    np.testing.assert_allclose(after.position, expected, atol=2e-5)
    turned = yaw + float(after.turn_rate) * SECONDS
    assert np.exp(1j * float(after.yaw)) == pytest.approx(np.exp(1j * turned), abs=1e-5)
    assert -np.pi <= float(after.yaw) < np.pi + 1e-6


@settings(max_examples=50)
@given(values=states, command=commands)
def test_no_limit_is_exceeded_and_what_can_be_reached_is(drives, values, command):
    after = drives(state_of(values), jnp.array(command, jnp.float32))
    *_, speed, turn_rate = values
    allowed = np.clip(command[0], max(speed - 1, 0), min(speed + 1, 2))
    assert float(after.speed) == pytest.approx(allowed, abs=1e-5)
    allowed = np.clip(command[1], max(turn_rate - 5, -3), min(turn_rate + 5, 3))
    assert float(after.turn_rate) == pytest.approx(allowed, abs=1e-5)


def test_a_circle_closes(drives):
    state = state_of([3.0, -2.0, 0.5, 1.0, 2 * np.pi / 5])
    for _ in range(20):
        state = drives(state, jnp.array([1.0, 2 * np.pi / 5]))
    np.testing.assert_allclose(state.position, [3, -2], atol=1e-5)
    assert float(state.yaw) == pytest.approx(0.5, abs=1e-5)


def test_it_turns_on_the_spot_and_never_drives_backwards(drives):
    state = at_rest(jnp.array([1.0, 2.0]), 4.0)
    assert float(state.yaw) == pytest.approx(4 - 2 * np.pi)
    state = drives(state, jnp.array([-1.0, 1.0]))
    assert state.position.tolist() == [1.0, 2.0]
    assert float(state.speed) == 0


def test_a_state_keeps_its_types(drives):
    before = at_rest(jnp.array([1.0, 2.0]), 0.0)
    after = drives(before, jnp.zeros(2))
    for leaf, later in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True):
        assert (leaf.dtype, leaf.weak_type, leaf.shape) == (later.dtype, later.weak_type, later.shape)
