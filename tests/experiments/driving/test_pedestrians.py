import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.robot.driving.footprint import Ground
from dc2g_jax.robot.driving.vehicle import VehicleState, at_rest
from dc2g_jax.robot.mapping.camera import Frame, intrinsics, level_camera
from experiments.driving.pedestrians import (
    NOWHERE,
    PATIENCE,
    PERSON_HEIGHT,
    PERSON_RADIUS,
    RETURNS,
    SPACE,
    WALKING_SPEED,
    place,
    walk,
    walkable_cells,
    without_people,
)
from tests.oracles.vehicle_oracle import clearance
from tests.support.maps import drawn

TERRAIN = drawn("""
    RRRRRRRRRR
    SSSSSSSSSS
    S..P.....S
    SSSPPPSSSS
    D..#......
""")
PERIODS, PEOPLE = 300, 12
FAR_AWAY = at_rest(jnp.array([500.0, 500.0]), 0.0)


@pytest.fixture(scope="module")
def sidewalks() -> Ground:
    return Ground(walkable_cells(TERRAIN), 1.0)


@pytest.fixture(scope="module")
def walks(sidewalks):
    """A program that lets people walk past a vehicle that stands: them, [periods people ...]."""

    def run(key, people, vehicle):
        def period(people, key):
            after = walk(key, people, sidewalks, vehicle, 0.3)
            return after, after

        return jax.lax.scan(period, people, jax.random.split(key, PERIODS))[1]

    return jax.jit(run)


@pytest.fixture(scope="module")
def walks_once():
    return jax.jit(lambda key, people, sidewalks, vehicle: walk(key, people, sidewalks, vehicle, 0.3))


@pytest.fixture(scope="module")
def placed():
    return jax.jit(place, static_argnames="count")


@pytest.fixture(scope="module")
def people(placed, sidewalks):
    return placed(jax.random.key(0), sidewalks, PEOPLE, jnp.array([0.5, -1.5]))


def test_people_walk_on_sidewalks_and_paths():
    letters = np.array([[letter in "SP" for letter in row] for row in ("R" * 10, "S" * 10, "S..P.....S", "SSSPPPSSSS")])
    np.testing.assert_array_equal(walkable_cells(TERRAIN)[:4], letters)


def test_people_begin_on_sidewalks_away_from_the_vehicle(people, sidewalks):
    position = np.asarray(people.position)
    assert clearance(position, np.asarray(sidewalks.cells), 1.0).min() >= PERSON_RADIUS
    # Three meters to the cell's middle, and a quarter aside of it.
    assert np.linalg.norm(position - [0.5, -1.5], axis=-1).min() > 3 - np.hypot(0.25, 0.25)
    assert len(np.unique(people.heads_for, axis=0)) > 5


def test_of_nobody_there_is_one_who_is_nowhere(placed, walks_once, sidewalks):
    nobody = placed(jax.random.key(0), sidewalks, 0, jnp.zeros(2))
    later = walks_once(jax.random.key(1), nobody, sidewalks, FAR_AWAY)
    for people in (nobody, later):
        assert people.position.shape == (1, 2)
        assert np.abs(people.position).min() > NOWHERE / 2


def test_people_walk_all_over_the_sidewalks_and_never_off_them(walks, people, sidewalks):
    walked = jax.device_get(walks(jax.random.key(1), people, FAR_AWAY))
    free = np.asarray(sidewalks.cells)
    assert clearance(walked.position.reshape(-1, 2), free, 1.0).min() >= PERSON_RADIUS
    speeds = np.linalg.norm(walked.velocity, axis=-1)
    assert speeds.max() <= WALKING_SPEED + 1e-4
    # Only where a step ends at the middle of a cell is it shorter.
    assert np.mean(speeds > WALKING_SPEED - 1e-3) > 0.8
    columns, rows = np.floor(walked.position[..., 0]).astype(int), np.floor(-walked.position[..., 1]).astype(int)
    visited = np.zeros_like(free)
    visited[rows, columns] = True
    np.testing.assert_array_equal(visited, free)
    # Nobody turns back: here, every path goes on.
    heads_for, came_from = walked.heads_for, walked.came_from
    changed = np.any(np.diff(heads_for, axis=0) != 0, axis=-1)
    assert changed.any()
    assert np.all(np.any(heads_for[1:] != came_from[:-1], axis=-1)[changed])


def test_walking_depends_on_the_key_alone(walks, people):
    first, again, other = (walks(jax.random.key(seed), people, FAR_AWAY).position for seed in (2, 2, 3))
    np.testing.assert_array_equal(first, again)
    assert np.any(first != other)


def test_people_do_not_touch_a_vehicle_that_stands_and_turn_round_in_front_of_it(walks, people):
    vehicle = at_rest(jnp.array([5.5, -1.5]), 0.0)
    away = np.linalg.norm(np.asarray(people.position) - [5.5, -1.5], axis=-1) > 1.5
    walked = jax.device_get(walks(jax.random.key(4), people, vehicle))
    gaps = (np.linalg.norm(walked.position - [5.5, -1.5], axis=-1) - 0.55)[:, away]
    assert gaps.min() >= SPACE
    stays = walked.turned_back[:, away] <= RETURNS
    stood = (np.linalg.norm(walked.velocity, axis=-1)[:, away] == 0) & stays
    assert stood.any()
    # Two seconds, and nobody for good: then they go back.
    window = np.lib.stride_tricks.sliding_window_view(stood, 25, axis=0)
    assert not window.all(axis=-1).any()
    assert walked.waited.max() == pytest.approx(PATIENCE, abs=0.11)


def test_who_is_shut_in_leaves_in_the_end(walks_once, people):
    cells = np.zeros(TERRAIN.shape, bool)
    cells[1, :4] = True
    shut_in = jax.tree.map(lambda leaf: leaf[:1], people)
    shut_in = dataclasses.replace(
        shut_in,
        position=jnp.array([[0.5, -1.5]]),
        came_from=jnp.array([[0, 1]]),
        heads_for=jnp.array([[1, 1]]),
        side=jnp.zeros((1, 2)),
    )
    vehicle, gone_after = at_rest(jnp.array([3.5, -1.5]), 0.0), None
    for period in range(400):
        shut_in = walks_once(jax.random.key(period), shut_in, Ground(jnp.asarray(cells), 1.0), vehicle)
        if float(shut_in.position[0, 0]) > NOWHERE / 2:
            gone_after = period / 10
            break
        assert cells[1, int(shut_in.position[0, 0])]
    # It has stood in front of the vehicle four times, two seconds each.
    assert gone_after is not None
    assert gone_after > 4 * PATIENCE
    assert shut_in.turned_back.tolist() == [RETURNS + 1]


def test_nobody_steps_in_front_of_a_vehicle_that_drives(walks_once, sidewalks, people):
    crossing = jax.tree.map(lambda leaf: leaf[:1], people)
    crossing = dataclasses.replace(
        crossing,
        position=jnp.array([[3.5, -2.2]]),
        came_from=jnp.array([[3, 3]]),
        heads_for=jnp.array([[3, 2]]),
        side=jnp.array([[0.0, 0.3]]),
        waited=jnp.zeros(1),
    )
    # It drives along the upper sidewalk, past the path that the person comes from.
    for speed, walks_on in ((0.0, True), (1.5, False)):
        vehicle = VehicleState(jnp.array([1.5, -1.5]), jnp.float32(0), jnp.float32(speed), jnp.float32(0))
        after = crossing
        for _ in range(4):
            after = walks_once(jax.random.key(0), after, sidewalks, vehicle)
        assert (float(after.position[0, 1]) > -2.0) == walks_on


@pytest.mark.parametrize("lone_cells", [[], [(3, 2)]])
def test_where_they_cannot_walk_people_stand_and_without_sidewalks_they_are_nowhere(walks_once, placed, lone_cells):
    cells = np.zeros(TERRAIN.shape, bool)
    for column, row in lone_cells:
        cells[row, column] = True
    ground = Ground(jnp.asarray(cells), 1.0)
    person = placed(jax.random.key(0), ground, 1, jnp.array([500.0, 500.0]))
    if lone_cells:
        assert np.floor(person.position[0] * jnp.array([1, -1])).tolist() == list(lone_cells[0])
    else:
        assert np.abs(person.position).min() > NOWHERE / 2
    later = walks_once(jax.random.key(1), person, ground, FAR_AWAY)
    np.testing.assert_allclose(later.position, person.position, atol=1e-6)


def test_a_camera_shows_those_who_stand_in_front_and_nothing_behind_them():
    camera, pose, reach = intrinsics(90.0, 24, 32), level_camera(1.0, -2.0, 1.0, 0.4, 0.2), 6.0
    bearings, distances = np.array([0.0, 0.02, 0.6, 3.1, -0.5]), np.array([2.0, 3.0, 5.0, 2.0, 7.0])
    # In front; behind the first; behind a wall at 3.5 m; behind the camera; too far away.
    people = np.array([1.0, -2.0]) + distances[:, None] * np.stack([np.cos(0.4 + bearings), np.sin(0.4 + bearings)], -1)
    depth = np.full((24, 32), 3.5, np.float32)
    before = Frame(depth=jnp.asarray(depth), classes=jnp.full((24, 32), 7, jnp.uint8), pose=pose)
    after, shown = without_people(before, jnp.asarray(people, jnp.float32), camera, reach)
    assert shown.tolist() == [True, False, False, False, False]
    covered = np.asarray(after.depth) == 0
    np.testing.assert_array_equal(after.depth, np.where(covered, 0, depth))
    np.testing.assert_array_equal(after.classes, np.where(covered, 0, 7))
    # Walk along each ray in small steps.
    sides = (np.arange(32) - 15.5) / 16, (np.arange(24) - 11.5) / 16
    right, down, ahead = np.asarray(pose.rotation).T
    directions = sides[0][None, :, None] * right + sides[1][:, None, None] * down + ahead
    steps = np.arange(0.005, 3.5, 0.005)
    points = np.asarray(pose.position) + steps[:, None, None, None] * directions
    gap = np.linalg.norm(points[..., None, :2] - people, axis=-1).min(-1)
    upright = (points[..., 2] > 0) & (points[..., 2] < PERSON_HEIGHT)
    inside, grazed = (np.any(upright & (gap < PERSON_RADIUS + more), axis=0) for more in (-0.01, 0.01))
    assert np.sum(inside) > 30
    assert np.all(covered[inside])
    assert not np.any(covered & ~grazed)


def test_where_nobody_is_a_frame_stays_as_it_was():
    camera, pose = intrinsics(90.0, 24, 32), level_camera(1.0, -2.0, 1.0, 0.4, 0.2)
    before = Frame(depth=jnp.full((24, 32), 2.0), classes=jnp.full((24, 32), 7, jnp.uint8), pose=pose)
    after, shown = without_people(before, jnp.full((1, 2), NOWHERE), camera, 6.0)
    jax.tree.map(np.testing.assert_array_equal, (after, shown), (before, np.array([False])))
