"""The sampling controller against plain NumPy, its properties, and a drive through a door."""

import dataclasses
import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.maps import cost_maps as cost_maps
from dc2g_jax.robot.driving import mppi
from dc2g_jax.robot.driving.mppi import MPPISettings
from dc2g_jax.robot.driving.vehicle import CONTROL_PERIOD, VehicleLimits, VehicleState, at_rest, drive
from experiments.objectnav.collecting import distance_for_vehicle
from tests.oracles import mppi_oracle

#: Few and short, with an effort matrix of all entries and limits that bind.
SMALL = MPPISettings(
    limits=VehicleLimits(max_speed=0.8, max_turn_rate=1.2, max_acceleration=2.5, max_turn_acceleration=6.0, radius=0.2),
    horizon=12,
    samples=24,
    noise=(0.35, 0.5),
    temperature=2.0,
    effort=((0.3, 0.1), (0.1, 0.2)),
)
#: Commands are taken on at once, as in the paper's model.
FREE = dataclasses.replace(SMALL, limits=VehicleLimits(1e3, 1e3, 1e6, 1e6, 0.2))


def bowl(position, yaw):
    """Cheapest at (1, -2), facing north."""
    return 3 * jnp.hypot(position[0] - 1, position[1] + 2) + 1 - jnp.sin(yaw)


@functools.partial(jax.jit, static_argnames=("cost_of_pose",))
def improve(controls, noise, state, settings, cost_of_pose=bowl):
    return mppi.improved(controls, noise, state, cost_of_pose, settings)


def moving(position=(0.2, -0.4), yaw=0.7, speed=0.3, turn_rate=-0.4):
    resting = at_rest(np.array(position), yaw)
    return dataclasses.replace(resting, speed=jnp.float32(speed), turn_rate=jnp.float32(turn_rate))


def drawn(settings, seed=0):
    """Controls and noise."""
    rng = np.random.default_rng(seed)
    controls = rng.normal((0.5, 0.0), 0.3, (settings.horizon, 2)).astype(np.float32)
    noise = rng.normal(0, settings.noise, (settings.samples, settings.horizon, 2)).astype(np.float32)
    return controls, noise


@pytest.mark.parametrize("settings", [SMALL, FREE], ids=["limits", "no limits"])
def test_the_update_is_that_of_plain_numpy(settings):
    controls, noise = drawn(settings)
    noise[3] = -controls  # Straight on, or standing.
    limits = settings.limits
    expected, weights = mppi_oracle.improved(
        controls,
        noise,
        (0.2, -0.4, 0.7, 0.3, -0.4),
        lambda x, y, yaw: 3 * math.hypot(x - 1, y + 2) + 1 - math.sin(yaw),
        limits=(limits.max_speed, limits.max_turn_rate, limits.max_acceleration, limits.max_turn_acceleration),
        period=CONTROL_PERIOD,
        temperature=settings.temperature,
        effort=settings.effort,
    )
    new, samples = improve(controls, noise, moving(), settings)
    np.testing.assert_allclose(new, expected, atol=1e-5)
    np.testing.assert_allclose(samples.weights, weights, atol=1e-5)
    assert weights.max() < 0.9  # More than one copy counts.


def test_weights_sum_to_one_even_where_costs_are_huge():
    controls, noise = drawn(SMALL)
    _, samples = improve(controls, noise, moving(), SMALL, lambda position, yaw: 1e6 * bowl(position, yaw))
    np.testing.assert_allclose(samples.weights.sum(), 1, rtol=1e-5)
    assert (samples.weights >= 0).all()


def test_equal_costs_move_the_plan_by_the_mean_of_the_noise():
    settings = dataclasses.replace(FREE, effort=((0.0, 0.0), (0.0, 0.0)))
    controls, noise = drawn(settings)
    controls += (5, 0)  # Never backwards.
    new, samples = improve(controls, noise, moving(), settings, lambda position, yaw: jnp.float32(7))
    np.testing.assert_allclose(samples.weights, 1 / settings.samples, rtol=1e-5)
    np.testing.assert_allclose(new, controls + noise.mean(axis=0), atol=1e-5)


def test_the_colder_the_closer_to_the_best_copy():
    controls, noise = drawn(SMALL)
    apart = []
    for temperature in (100.0, SMALL.temperature, 1e-3):
        new, samples = improve(controls, noise, moving(), dataclasses.replace(SMALL, temperature=temperature))
        commands = jnp.stack([samples.path.speed, samples.path.turn_rate], axis=-1)
        apart.append(float(jnp.abs(new - commands[jnp.argmin(samples.costs)]).max()))
    assert apart == sorted(apart, reverse=True)
    assert apart[-1] < 1e-5


def test_the_vehicle_can_follow_every_plan():
    controls, noise = drawn(SMALL)
    new, _ = improve(controls, 10 * noise, moving(), SMALL)
    state = moving()
    for command in new:
        state = drive(state, command, SMALL.limits)
        np.testing.assert_allclose([state.speed, state.turn_rate], command, atol=1e-5)


def test_noise_has_its_deviation_and_correlation_at_every_time():
    for correlation in (0.0, 0.8):
        settings = dataclasses.replace(SMALL, samples=4000, correlation=correlation)
        noise = np.asarray(mppi.sampled_noise(jax.random.key(3), settings))
        assert noise.shape == (4000, 12, 2)
        np.testing.assert_allclose(noise.mean(axis=0), 0, atol=0.04)
        np.testing.assert_allclose(noise.std(axis=0), np.broadcast_to(SMALL.noise, (12, 2)), rtol=0.06)
        for apart in (1, 3):
            together = (noise[:, apart:] * noise[:, :-apart]).mean(axis=(0, 1)) / np.square(SMALL.noise)
            np.testing.assert_allclose(together, correlation**apart, atol=0.03)
        np.testing.assert_allclose((noise[..., 0] * noise[..., 1]).mean(), 0, atol=0.01)


def test_shift_drops_what_has_been_driven():
    np.testing.assert_array_equal(
        mppi.shifted_controls(jnp.array([[1.0, 2], [3, 4], [5, 6]])), [[3, 4], [5, 6], [5, 6]]
    )


def test_many_robots_at_once_each_as_alone():
    keys = jax.random.split(jax.random.key(0), 3)
    states = jax.vmap(at_rest)(jnp.array([[0.0, 0], [1, 1], [-2, 0.5]]), jnp.array([0.0, 2, -1]))
    controls = jnp.stack([jnp.zeros((SMALL.horizon, 2))] * 3)

    def plan(key, controls, state):
        return mppi.plan_controls(key, controls, state, bowl, SMALL)[0]

    together = jax.jit(jax.vmap(plan))(keys, controls, states)
    alone = jax.jit(plan)
    for robot in range(3):
        state = jax.tree.map(lambda leaf, robot=robot: leaf[robot], states)
        np.testing.assert_allclose(together[robot], alone(keys[robot], controls[robot], state), atol=1e-5)
        assert together[robot].dtype == controls.dtype
    assert not np.allclose(together[0], together[1])


#: Edge of a cell, meters.
CELL = 0.05


def two_rooms():
    """Obstacles and goal: rooms of 2 by 1.5 m, a wall of 0.1 m with a door of 0.9 m at one end of it."""
    obstacles = np.zeros((42, 64), bool)
    obstacles[[0, -1]] = obstacles[:, [0, -1]] = True
    obstacles[:, 31:33] = True
    obstacles[22:40, 31:33] = False
    goals = np.zeros_like(obstacles)
    goals[4:8, 54:58] = True
    return obstacles, goals


def test_a_vehicle_reaches_the_goal_through_a_door():
    obstacles, goals = map(jnp.asarray, two_rooms())
    limits = VehicleLimits(max_speed=1.0, radius=0.2)
    settings = MPPISettings(limits=limits, samples=128)

    @jax.jit
    def episode(key, state: VehicleState):
        distance = distance_for_vehicle(obstacles, goals, limits.radius + CELL, CELL)
        cost_of_pose = cost_maps.cost_lookup(cost_maps.dense_costs(distance, CELL), CELL, outside=100.0)

        def step(carry, key):
            state, controls = carry
            controls, _ = mppi.plan_controls(key, controls, state, cost_of_pose, settings)
            state = drive(state, controls[0], limits)
            return (state, mppi.shifted_controls(controls)), state

        first = (state, jnp.zeros((settings.horizon, 2)))
        return jax.lax.scan(step, first, jax.random.split(key, 150))[1], distance

    # Behind the wall from the goal, which is across it and not through the door, and facing away from both.
    path, distance = episode(jax.random.key(0), at_rest(np.array([0.5, -0.5]), math.pi))
    x, y = np.asarray(path.position, float).T
    to_go = np.asarray(distance)[(-y / CELL).astype(int), (x / CELL).astype(int)]
    assert to_go[-1] <= 0.2
    arrived = np.argmax(to_go <= 0.2)
    length = np.hypot(np.diff(x), np.diff(y))[:arrived].sum()
    assert length <= 1.2 * float(distance[10, 10])
    rows, columns = np.nonzero(np.asarray(obstacles))
    off_x = np.maximum(np.abs(columns + 0.5 - x[:, None] / CELL) - 0.5, 0)
    off_y = np.maximum(np.abs(rows + 0.5 + y[:, None] / CELL) - 0.5, 0)
    assert np.hypot(off_x, off_y).min() * CELL >= limits.radius
