import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.terrain import TRAVERSABLE
from dc2g_jax.robot.driving.footprint import Ground
from dc2g_jax.robot.driving.vehicle import VehicleLimits, at_rest, drive
from experiments.driving.following import aim, path_through, steer
from tests.oracles.vehicle_oracle import clearance, driven
from tests.support.maps import drawn

LIMITS = VehicleLimits()
PERIODS = 260

MAZE = drawn("""
    ........
    .RRR.RR.
    ...R.R..
    .RRR.RR.
    .R....R.
    .RRRRRR.
    ........
""")
#: Column and row; a cell that follows itself is a turn on the spot.
CELLS = [(1, 1), (2, 1), (3, 1), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (1, 4), (1, 5), (2, 5), (3, 5), (4, 5), (5, 5)]
CELLS += [(6, 5), (6, 4), (6, 3), (5, 3), (5, 2), (5, 1), (6, 1)]


@pytest.fixture(scope="module")
def follows():
    """A program that drives a vehicle along a path, [periods ...]."""

    def drive_along(free, path, state):
        def period(state, _):
            target = aim(state, path, Ground(free, 1.0), LIMITS)
            after = drive(state, steer(state, target, path, LIMITS), LIMITS)
            return after, after

        return jax.lax.scan(period, state, length=PERIODS)[1]

    return jax.jit(drive_along)


def the_path(cells, heading):
    padded = np.zeros((len(CELLS) + 5, 2), np.int32)
    padded[: len(cells)] = cells
    return path_through(jnp.asarray(padded), len(cells), heading, 1.0)


def path_driven(start, states, steps=5) -> np.ndarray:
    """Positions along the path, several per period, in double precision."""
    before = jax.tree.map(lambda first, all_: np.concatenate([np.asarray(first)[None], all_[:-1]]), start, states)
    pieces = []
    for i, command in enumerate(zip(states.speed, states.turn_rate, strict=True)):
        pieces.append(driven(before.position[i], before.yaw[i], *command, 0.1, steps))
    return np.concatenate(pieces)


@pytest.mark.parametrize("yaw", [0.0, -3.1])
def test_the_footprint_stays_in_a_corridor_one_cell_wide(follows, yaw):
    free, path = TRAVERSABLE[MAZE], the_path(CELLS, 3)
    start = at_rest(path.points[0], yaw)
    states = jax.device_get(follows(jnp.asarray(free), path, start))
    assert clearance(path_driven(start, states), free, 1.0).min() > LIMITS.radius
    # 19 m with ten corners: three quarters of the highest speed on average.
    arrived = np.linalg.norm(states.position - np.array([6.5, -1.5]), axis=-1) < 0.1
    assert np.argmax(arrived) * 0.1 < 20 / (0.75 * LIMITS.max_speed)
    assert arrived[-1]
    # Heading 3 is against the rows: +y.
    assert float(states.yaw[-1]) == pytest.approx(np.pi / 2, abs=0.01)
    assert float(states.speed[-1]) < 0.01


def test_on_open_ground_it_cuts_corners(follows):
    stairs = [(1 + i // 2, 1 + (i + 1) // 2) for i in range(9)]
    path = the_path(stairs, 0)
    states = jax.device_get(follows(jnp.ones((7, 8), bool), path, at_rest(path.points[0], -np.pi / 4)))
    assert np.linalg.norm(states.position[-1] - np.array([5.5, -5.5])) < 0.1
    length = np.linalg.norm(np.diff(states.position, axis=0), axis=-1).sum()
    assert length < 1.1 * np.hypot(4, 4)


def test_a_path_of_one_cell_is_a_turn_on_the_spot(follows):
    path = the_path([(3, 1)], 2)
    states = jax.device_get(follows(jnp.asarray(TRAVERSABLE[MAZE]), path, at_rest(path.points[0], 0.3)))
    np.testing.assert_allclose(states.position[-1], [3.5, -1.5])
    assert np.cos(states.yaw[-1]) == pytest.approx(-1, abs=1e-4)


def test_beside_a_corner_it_first_goes_back_to_its_path():
    ground = Ground(jnp.array([[True, False], [True, True]]), 1.0)
    path = path_through(jnp.array([[0, 1], [0, 0]]), 2, 3, 1.0)
    # Just clear of the blocked cell's corner (1, -1), which every line to a point further on the path comes nearer to.
    state = at_rest(jnp.array([0.94, -1.295]), 0.0)
    target = jax.jit(lambda state, path: aim(state, path, ground, LIMITS))(state, path)
    np.testing.assert_allclose(target, [0.5, -1.295], atol=1e-6)
