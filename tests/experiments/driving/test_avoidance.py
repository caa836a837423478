import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.sampling import sample_grid
from dc2g_jax._src.grid.terrain import GRASS, TRAVERSABLE
from dc2g_jax._src.readers.starts import start_cells
from dc2g_jax.families.procedural import procedural_training_houses
from dc2g_jax.robot.driving.footprint import Ground, cell_centers
from dc2g_jax.robot.driving.vehicle import VehicleState, at_rest, drive
from experiments.driving.avoidance import People, avoid
from experiments.driving.pedestrians import NOWHERE, PERSON_RADIUS, Pedestrians, place, walkable_cells
from tests.oracles.vehicle_oracle import clearance, driven
from tests.support.maps import drawn
from tests.support.streets import LIMITS, Episode, episodes

HOUSES, STARTS, PEOPLE, PERIODS = 2, 4, 6, 500

#: A person comes along the only path to the door, and can step aside where it ends.
NARROW = drawn("""
    ............S...
    ............S...
    RRRSSSSSSSSSSRRD
    ............S...
    ............S...
""")
#: A person stands in the middle of a road.
BROAD = drawn("""
    RRRRRRRRRRRRRRRR
    RRRRRRRRRRRRRRRR
    RRRRRRRRSRRRRRRD
    RRRRRRRRRRRRRRRR
    RRRRRRRRRRRRRRRR
""")
FAR_AWAY = People(jnp.full((1, 2), NOWHERE), jnp.zeros((1, 2)), PERSON_RADIUS)


def framed(terrain: np.ndarray) -> np.ndarray:
    """The map in the corner of a lawn as large as a house's."""
    height, width = terrain.shape
    return np.pad(terrain, ((0, 50 - height), (0, 50 - width)), constant_values=GRASS)


def standing(cell: tuple[int, int], heads_for: tuple[int, int]) -> Pedestrians:
    """One person, and the others nowhere."""
    cells = jnp.full((PEOPLE, 2), int(NOWHERE)).at[0].set(jnp.array(cell))
    still, nobody = jnp.zeros((PEOPLE, 2)), jnp.zeros(PEOPLE)
    heads = cells.at[0].set(jnp.array(heads_for))
    never = jnp.zeros(len(nobody), jnp.int32)
    return Pedestrians(cell_centers(cells, 1.0), still, cells, heads, still, nobody, never)


@pytest.fixture(scope="module")
def maps() -> np.ndarray:
    """Houses, a start each; then the narrow path, then the broad road."""
    houses = [sample_grid(house) for house in procedural_training_houses(HOUSES, seed=5)]
    return np.stack([house for house in houses for _ in range(STARTS)] + [framed(NARROW), framed(BROAD)])


@pytest.fixture(scope="module")
def driven_episodes(maps) -> Episode:
    rng = np.random.default_rng(0)
    cells = [rng.choice(np.argwhere(start_cells(terrain)))[::-1] for terrain in maps[:-2]]
    cells = jnp.array([*cells, (0, 2), (1, 2)], jnp.int32)
    sidewalks = Ground(jnp.stack([walkable_cells(terrain) for terrain in maps[:-2]]), 1.0)
    keys = jax.random.split(jax.random.key(1), len(maps))
    placing = jax.jit(jax.vmap(lambda key, ground, start: place(key, ground, PEOPLE, start)))
    placed = placing(keys[:-2], sidewalks, cell_centers(cells[:-2], 1.0))
    alone = [standing((9, 2), (8, 2)), standing((8, 2), (8, 2))]
    everybody = jax.tree.map(lambda many, *ones: jnp.concatenate([many, jnp.stack(ones)]), placed, *alone)
    yaws = jnp.asarray(rng.uniform(-3, 3, len(maps)), jnp.float32).at[-2:].set(0)
    return jax.device_get(episodes(keys, jnp.asarray(maps), cells, yaws, everybody, PERIODS))


def positions_of(episode: Episode, number: int, steps: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Vehicle [n 2] and people [n people 2] of one episode at several moments a period, up to its end."""
    state, end = episode.state, int(np.argmin(~episode.arrived[number])) or PERIODS
    vehicle = []
    for i in range(end):
        command = state.speed[number, i + 1], state.turn_rate[number, i + 1]
        vehicle.append(driven(state.position[number, i], state.yaw[number, i], *command, 0.1, steps))
    people, share = episode.people[number, : end + 1], np.linspace(0, 1, steps + 1)[:, None, None]
    between = [before + share * (after - before) for before, after in itertools.pairwise(people)]
    return np.concatenate(vehicle), np.concatenate(between)


def test_every_robot_arrives_and_touches_nothing_and_nobody(driven_episodes, maps):
    assert np.all(driven_episodes.arrived[:, -1])
    for number, terrain in enumerate(maps):
        vehicle, people = positions_of(driven_episodes, number)
        assert clearance(vehicle, TRAVERSABLE[terrain], 1.0).min() > LIMITS.radius
        assert np.linalg.norm(people - vehicle[:, None], axis=-1).min() > LIMITS.radius + PERSON_RADIUS


def test_no_limit_is_exceeded(driven_episodes):
    speed, turn_rate = driven_episodes.state.speed, driven_episodes.state.turn_rate
    for values, most, change in (
        (speed, LIMITS.max_speed, LIMITS.max_acceleration),
        (turn_rate, LIMITS.max_turn_rate, LIMITS.max_turn_acceleration),
    ):
        assert np.abs(values).max() <= most
        assert np.abs(np.diff(values, axis=1)).max() <= 0.1 * change + 1e-6
    assert speed.min() == 0


def test_on_a_narrow_path_it_waits_until_the_person_turns_round(driven_episodes):
    vehicle, people = positions_of(driven_episodes, -2)
    apart = np.linalg.norm(people[:, 0] - vehicle, axis=-1)
    assert 0.55 < apart.min() < 1.2
    west = people[:, 0, 0]
    # The person walks against the vehicle, and later back past where that began.
    assert west.min() < 9
    assert west[np.argmin(west) :].max() > 11


def test_it_drives_around_a_person_who_stands(driven_episodes):
    vehicle, people = positions_of(driven_episodes, -1)
    assert np.ptp(people[:, 0], axis=0).max() == 0
    apart = np.linalg.norm(people[:, 0] - vehicle, axis=-1)
    assert 0.55 < apart.min() < 1.2
    # 13.5 m, at first not at full speed.
    assert np.argmax(driven_episodes.arrived[-1]) * 0.1 < 1.3 * 13.5 / LIMITS.max_speed


ROBOTS, GUARDED = 8, 150


@pytest.fixture(scope="module")
def guarded():
    """A program that drives vehicles where wished, guarded: their states, [robots periods ...]."""

    def run(cells, state, wishes, people):
        def period(state, wish):
            after = drive(state, avoid(state, wish, Ground(cells, 1.0), people, LIMITS), LIMITS)
            return after, after

        return jax.lax.scan(period, state, wishes)[1]

    return jax.jit(jax.vmap(run, in_axes=(None, 0, 0, None)))


def test_whatever_is_wished_for_the_footprint_stays_on_the_ground(guarded):
    free, rng = np.random.default_rng(7).random((8, 9)) < 0.8, np.random.default_rng(8)
    cells = rng.choice(np.argwhere(free)[:, ::-1], ROBOTS)
    # Each wish lasts for a while, full speed more often than not.
    wishes = rng.choice([-1.0, 0.7, 1.5, 9.0], (ROBOTS, 30)), rng.uniform(-3, 3, (ROBOTS, 30))
    wishes = np.stack(wishes, axis=-1).repeat(GUARDED // 30, axis=1).astype(np.float32)
    yaws = jnp.asarray(rng.uniform(-3, 3, ROBOTS), jnp.float32)
    start = jax.vmap(at_rest)(cell_centers(jnp.asarray(cells), 1.0), yaws)
    states = jax.device_get(guarded(jnp.asarray(free), start, jnp.asarray(wishes), FAR_AWAY))
    before = jax.tree.map(
        lambda one, more: np.concatenate([np.asarray(one)[:, None], more[:, :-1]], axis=1), start, states
    )
    for i in np.ndindex(ROBOTS, GUARDED):
        places = driven(before.position[i], before.yaw[i], states.speed[i], states.turn_rate[i], 0.1, 3)
        assert clearance(places, free, 1.0).min() > LIMITS.radius
    assert np.linalg.norm(np.diff(states.position, axis=1), axis=-1).sum(axis=1).min() > 1


def moving(x: float, speed: float) -> VehicleState:
    return VehicleState(jnp.array([x, -2.5]), jnp.float32(0), jnp.float32(speed), jnp.float32(0))


@pytest.fixture(scope="module")
def chosen(guarded):
    """The first command on open ground."""

    def choose(state, wish, people):
        states = jax.tree.map(lambda leaf: jnp.stack([leaf] * ROBOTS), state)
        after = guarded(jnp.ones((8, 9), bool), states, jnp.broadcast_to(wish, (ROBOTS, GUARDED, 2)), people)
        return jnp.stack([after.speed[0, 0], after.turn_rate[0, 0]])

    return choose


def person(x: float, velocity: float = 0.0) -> People:
    return People(jnp.array([[x, -2.5]]), jnp.array([[velocity, 0.0]]), PERSON_RADIUS)


def test_it_does_as_wished_where_it_may(chosen):
    wish = jnp.array([1.4, 0.3])
    assert chosen(moving(3.0, 1.4), wish, FAR_AWAY).tolist() == pytest.approx([1.4, 0.3])
    assert chosen(moving(3.0, 1.4), wish, person(8.0)).tolist() == pytest.approx([1.4, 0.3])


def test_it_brakes_where_nothing_is_admissible(chosen):
    command = chosen(moving(3.0, 1.5), jnp.array([1.5, 0.0]), person(3.7))
    assert command.tolist() == pytest.approx([1.35, 0])


def test_it_keeps_its_distance_from_a_person_ahead_who_may_stop(chosen):
    wish = jnp.array([1.2, 0.0])
    # A stand takes 0.42 m from 1.2 m/s after one more period: too near, even behind somebody who walks as fast.
    assert chosen(moving(3.0, 1.2), wish, person(4.1, velocity=1.2))[0] < 1.2
    assert chosen(moving(3.0, 1.2), wish, person(4.9, velocity=1.2))[0] == pytest.approx(1.2)
    # One who comes nearer meets the vehicle half-way.
    assert chosen(moving(3.0, 1.2), wish, person(4.9, velocity=-1.2))[0] < 1.2


def test_a_vehicle_that_touches_a_wall_gets_away_from_it_and_no_deeper_into_it(chosen):
    for yaw, goes in ((0.0, True), (np.pi, False)):
        command = chosen(at_rest(jnp.array([0.2, -2.5]), yaw), jnp.array([1.0, 0.0]), FAR_AWAY)
        assert (command[0] > 0.05) == goes
