"""A robot that searches for an object in a house of two rooms."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.maps.classes import BED, GOALS, PLANT
from dc2g_jax.indoor.maps.mapping import EXPLORED_CHANNEL, OBSTACLE_CHANNEL, IndoorMapSettings
from dc2g_jax.indoor.search.agent import (
    DECLARED,
    LIMITS,
    Agent,
    Guidance,
    Searcher,
    arrives,
    look_around_first,
    random_until_seen,
    with_mpc,
)
from dc2g_jax.indoor.search.guides import (
    nearest_frontier,
    nowhere,
    predicted,
    promising_frontier,
    true_costs,
    until_seen,
)
from dc2g_jax.indoor.search.searches import is_active, leg, picture, reset, site_of
from dc2g_jax.robot.driving.footprint import Ground
from dc2g_jax.robot.driving.mppi import MPPISettings
from dc2g_jax.robot.driving.robot import stopped_by_obstacles
from dc2g_jax.robot.driving.vehicle import at_rest, drive
from dc2g_jax.robot.mapping.camera import intrinsics
from tests.support.refusals import refusal
from tests.support.two_rooms import two_rooms

BED_TARGET, PLANT_TARGET = GOALS.index(BED), GOALS.index(PLANT)
LIMIT = 200
KEY = jax.random.key(0)


@pytest.fixture(scope="module")
def site():
    """The house, and the distances in it."""
    return site_of(two_rooms().world, two_rooms().name, agent_with(true_costs))


def agent_with(guide=nowhere, **parts):
    """An agent whose map and images are small."""
    return Agent(
        guide=guide,
        steering=with_mpc,
        camera=intrinsics(90.0, 30, 40),
        mapping=IndoorMapSettings(cells=120, local=60),
        controller=MPPISettings(limits=LIMITS, samples=32, horizon=30),
        **parts,
    )


def robot_at(x, y, yaw=0.0):
    start = jnp.array([x, y, yaw], jnp.float32)
    return reset(KEY, (start, jnp.int32(PLANT_TARGET)), agent_with(), LIMIT)


def test_the_distance_to_objects_is_that_of_the_path_around_walls(site):
    # From the far end of the bedroom to the plant: through the door.
    row, column = 28, 6
    assert 3.5 < float(site.true_distance[PLANT_TARGET, row, column]) < 5.5
    assert float(site.true_distance[BED_TARGET, row, column]) < 1
    assert np.isinf(np.asarray(site.true_distance)[:, ~np.asarray(site.free)]).all()
    # There is no couch.
    assert np.isinf(np.asarray(site.true_distance)[GOALS.index(5)]).all()


@pytest.fixture(scope="module")
def journey(site):
    """A robot that knows the costs, sent from the bed's side to the plant, facing away."""
    agent = agent_with(true_costs)
    drive_on = jax.jit(lambda robot: leg(robot, site, agent))
    robots = [robot_at(0.6, -2.9, 3.0)]
    while bool(is_active(robots[-1])):
        robots.append(drive_on(robots[-1]))
    return robots


def test_a_robot_with_true_costs_reaches_the_object(journey, site):
    last = journey[-1]
    steps = int(last.periods)
    assert int(last.status) == DECLARED
    assert 40 < steps < LIMIT
    track = np.asarray(last.track)
    shortest = float(site.true_distance[PLANT_TARGET, 29, 6])
    assert np.hypot(*np.diff(track[:, :2], axis=0).T).sum() < 1.25 * shortest
    # The plant's cells have their middles from x = 4.7 to 5.0 and y = -2.7 to -3.0.
    off = np.maximum(np.abs(track[steps, :2] - (4.85, -2.85)) - 0.2, 0)
    assert np.hypot(*off) < 1.0
    np.testing.assert_array_equal(np.diff(track[steps + 1 :], axis=0), 0)


def test_a_margin_ends_the_path_nearer_or_where_it_can_go_no_further():
    agent = agent_with(margin=0.25)
    robot = robot_at(2.0, -2.0)
    distance = jnp.full_like(robot.costs, jnp.inf)
    middle = robot.costs.shape[0] // 2

    def arrived(here, beside, to_goal=True):
        costs = distance.at[middle, middle].set(here).at[middle, middle + 1].set(beside)
        guided = dataclasses.replace(robot, guidance=Guidance(costs, jnp.bool_(to_goal)))
        return bool(arrives(guided, robot.vehicle.position, agent))

    assert arrived(0.2, 0.1)
    assert not arrived(0.3, 0.2)
    assert arrived(0.4, 0.5)
    assert not arrived(0.46, 0.5)
    assert not arrived(0.1, 0.2, to_goal=False)


def test_speeds_in_the_track_move_the_robot(journey):
    steps = int(journey[-1].periods)
    track = np.asarray(journey[-1].track, float)[: steps + 1]
    np.testing.assert_allclose(np.hypot(*np.diff(track[:, :2], axis=0).T), 0.1 * track[1:, 3], atol=2e-3)
    turned = (np.diff(track[:, 2]) + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(turned, 0.1 * track[1:, 4], atol=1e-4)
    assert np.abs(np.diff(track[:, 3])).max() <= 0.1 * LIMITS.max_acceleration + 1e-5


def test_leaves_of_a_robot_keep_their_types(journey):
    def types(robot):
        return [jax.typeof(leaf) for leaf in jax.tree.leaves(robot)]

    assert types(journey[0]) == types(journey[-1])


def test_the_map_of_a_robot_is_that_of_the_house(journey):
    last, world = journey[-1], two_rooms().world
    row, column = -np.asarray(last.map.origin)
    cells = np.asarray(last.map.cells)[row : row + world.free.shape[0], column : column + world.free.shape[1]]
    explored, obstacle = (cells >> EXPLORED_CHANNEL) & 1 == 1, (cells >> OBSTACLE_CHANNEL) & 1 == 1
    assert (explored & world.free).sum() > 0.5 * world.free.sum()
    assert (obstacle & ~world.obstacle).sum() <= 0.02 * obstacle.sum()


def test_a_wall_stops_the_vehicle_and_lets_it_turn_and_leave(site):
    ground = Ground(site.free, 0.1)
    vehicle = dataclasses.replace(at_rest(jnp.array([2.8, -2.85]), jnp.float32(0)), speed=jnp.float32(1))
    # The face of the wall is at x = 3.2.
    for _ in range(6):
        driven = drive(vehicle, jnp.array([1.0, 1.0]), LIMITS)
        vehicle, bumped = stopped_by_obstacles(vehicle, driven, ground, 0.2)
    assert bool(bumped)
    assert float(vehicle.speed) == 0
    assert 2.85 < float(vehicle.position[0]) <= 3.0 + 1e-3
    assert float(vehicle.yaw) > 0.3
    inside = dataclasses.replace(vehicle, position=jnp.array([3.1, -2.85]), yaw=jnp.float32(np.pi))
    left, bumped = stopped_by_obstacles(inside, drive(inside, jnp.array([1.0, 0.0]), LIMITS), ground, 0.2)
    assert not bool(bumped)
    assert float(left.position[0]) < 3.1


def with_cells(robot, **channels):
    """A robot whose map has these channels in these slices of the world's rows and columns, and is explored there."""
    cells = np.zeros(robot.map.cells.shape, np.uint32)
    down, right = -np.asarray(robot.map.origin)
    for name, places in channels.items():
        bit = {"floor": 0, "wall": 1 << OBSTACLE_CHANNEL, "plant": (1 << OBSTACLE_CHANNEL) | (1 << PLANT - 1)}[name]
        for rows, columns in places:
            place = slice(down + rows[0], down + rows[1]), slice(right + columns[0], right + columns[1])
            cells[place] |= np.uint32(bit | (1 << EXPLORED_CHANNEL))
    return dataclasses.replace(robot, map=robot.map.replace(cells=jnp.asarray(cells)))


@pytest.fixture
def guided(site):
    def guide_one(robot, guide, estimator=None):
        """What the guide says that is given a picture only if it follows predicted costs, and nothing of the house."""
        image = picture(robot, site) if estimator else None
        return guide(robot, image, agent_with(guide, estimator=estimator))

    return guide_one


def test_the_true_costs_lie_around_the_robot(site):
    robot = robot_at(2.05, -1.55)
    agent = agent_with(true_costs, true_distance=site.true_distance)
    distance = np.asarray(true_costs(robot, None, agent).distance)
    world = np.asarray(site.true_distance[PLANT_TARGET])
    # The robot is in row 15 and column 20; the local map begins 30 cells before.
    np.testing.assert_array_equal(distance[15 : 15 + world.shape[0], 10 : 10 + world.shape[1]], world[:45, :50])
    assert np.isinf(distance[:15]).all()


def test_the_goal_reacher_takes_over_when_the_target_is_seen(guided):
    robot = robot_at(2.05, -1.55)
    floor = [((10, 30), (5, 40))]
    blind = guided(with_cells(robot, floor=floor), until_seen(nowhere))
    assert not bool(blind.to_goal)
    seen = guided(with_cells(robot, floor=floor, plant=[((15, 18), (36, 39))]), until_seen(nowhere))
    assert bool(seen.to_goal)
    # 16 cells to the plant, less an arm's length.
    np.testing.assert_allclose(seen.distance[30, 30], 0.9, atol=0.11)
    speck = guided(with_cells(robot, floor=floor, plant=[((15, 16), (36, 38))]), until_seen(nowhere))
    assert not bool(speck.to_goal)
    enclosed = [((0, 60), (32, 33)), ((0, 60), (0, 1)), ((0, 1), (0, 33)), ((59, 60), (0, 33))]
    lost = guided(with_cells(robot, floor=floor, plant=[((15, 18), (43, 46))], wall=enclosed), until_seen(nowhere))
    assert not bool(lost.to_goal)


def test_the_frontier_is_the_nearest_floor_that_has_not_been_seen(guided):
    robot = robot_at(2.05, -1.55)
    # A room without a gap but for the right end of a corridor.
    walls = [((9, 10), (5, 29)), ((24, 25), (5, 29)), ((9, 25), (4, 5)), ((9, 13), (28, 29)), ((20, 25), (28, 29))]
    known = with_cells(robot, floor=[((10, 24), (5, 30))], wall=walls)
    found = guided(known, nearest_frontier)
    assert not bool(found.to_goal)
    distance = np.asarray(found.distance)
    # Row 16 of the world is row 31 here; column 30 is the first that has not been seen.
    assert distance[31, 40] == 0
    np.testing.assert_allclose(distance[31, 30], 1.0, atol=0.15)
    # Nothing is left nearby, but 45 cells further on.
    far = with_cells(robot, floor=[((10, 24), (5, 30)), ((13, 20), (30, 66))], wall=[*walls, ((12, 13), (28, 67)),
                     ((20, 21), (28, 67))])  # fmt: skip
    np.testing.assert_allclose(np.asarray(guided(far, nearest_frontier).distance)[31, 30], 4.6, atol=0.2)
    closed = with_cells(robot, floor=[((10, 24), (5, 28))], wall=[*walls, ((9, 25), (28, 29))])
    assert np.isinf(np.asarray(guided(closed, nearest_frontier).distance)).all()


class Slope:
    """Predicts that costs fall by so many meters a meter to the east, and that the last column is occupied."""

    def __init__(self, fall):
        self.fall = fall

    def estimate(self, maps, target, heading, image):
        assert maps.shape == (36, 60, 60)
        assert image.shape == (48, 64, 3)
        return (self.fall * 0.1 * (58.0 - jnp.arange(60)) + jnp.zeros((60, 60))).at[:, -1].set(jnp.inf)


def test_predicted_costs_do_not_lead_through_what_has_been_seen(guided):
    robot = with_cells(robot_at(2.05, -1.55, yaw=1.0), wall=[((9, 10), (5, 29))])
    distance = np.asarray(guided(robot, predicted, Slope(1)).distance)
    # The best cell that is not predicted to be occupied, in the last column but one, costs nothing.
    np.testing.assert_allclose(distance[40], [*(0.1 * (58 - np.arange(59))), np.inf], atol=1e-5)
    assert np.isinf(distance[:, -1]).all()
    # The wall is in row 24 of the local map, from column 15 to 38; the robot reaches 2 cells from its middle.
    assert np.isinf(distance[22:27, 15:39]).all()
    assert np.isfinite(distance[21, 15:39]).all()


def test_the_promising_frontier_weighs_distance_and_predicted_costs(guided):
    # A corridor, open 1.3 m to the west of the robot and 2.4 m to the east of it.
    walls = [((12, 13), (6, 46)), ((20, 21), (6, 46))]
    robot = with_cells(robot_at(2.05, -1.55), floor=[((13, 20), (7, 45))], wall=walls)
    near = np.asarray(guided(robot, promising_frontier, Slope(0)).distance)
    far = np.asarray(guided(robot, promising_frontier, Slope(1)).distance)
    np.testing.assert_allclose(near, np.asarray(guided(robot, nearest_frontier).distance))
    # Row 16, column 20 of the world are row 31, column 30 here: one falls to the west, the other to the east.
    assert near[31, 28] < near[31, 30] < near[31, 32]
    assert far[31, 28] > far[31, 30] > far[31, 32]
    np.testing.assert_allclose(far[31, 30] - far.min(), 2.5, atol=0.1)


@pytest.mark.parametrize("guide", [nowhere, true_costs])
def test_only_the_privileged_guide_is_told_the_house_and_none_where_the_robot_is(guide):
    def spy(robot, image, agent):
        given.append((type(robot), agent.true_distance))
        return guide(robot, image, agent)

    given, house = [], two_rooms()
    agent = agent_with(true_costs if guide is true_costs else spy)
    site, agent = site_of(house.world, house.name, agent), agent.replace(guide=spy)
    jax.eval_shape(lambda robot: leg(robot, site, agent), robot_at(2.05, -1.55))
    ((robot, distance),) = given
    assert robot is Searcher
    assert (distance is not None) == (guide is true_costs)


def test_what_a_robot_does_not_have_is_refused(site):
    robot = robot_at(2.05, -1.55)
    refusal(lambda: true_costs(robot, None, agent_with()), "true_costs", "ahead of time", "another one")
    refusal(lambda: predicted(robot, None, agent_with(estimator=Slope(1))), "the camera's picture", "give one with")
    refusal(lambda: predicted(robot, picture(robot, site), agent_with()), "need a network")


def test_a_robot_looks_around_at_the_start():
    robot, agent = robot_at(2.05, -1.55), agent_with()
    costs = lambda position, yaw: jnp.float32(0)  # noqa: E731
    turning = np.asarray(look_around_first(KEY, robot, costs, agent))
    np.testing.assert_array_equal(turning[0], [0, LIMITS.max_turn_rate])
    later = dataclasses.replace(robot, periods=jnp.int32(32))
    sighted = dataclasses.replace(robot, guidance=robot.guidance.replace(to_goal=jnp.bool_(True)))
    for one in (later, sighted):
        plans = [steering(KEY, one, costs, agent) for steering in (look_around_first, with_mpc)]
        np.testing.assert_array_equal(*plans)


def test_random_commands_are_those_the_vehicle_can_take():
    robot, agent = robot_at(2.05, -1.55), agent_with()
    plan = np.asarray(random_until_seen(KEY, robot, lambda position, yaw: jnp.float32(0), agent))
    assert plan.shape == (30, 2)
    assert 0 <= plan[:, 0].min() < 0.2 < 0.8 < plan[:, 0].max() <= 1
    assert -2 <= plan[:, 1].min() < -1 < 1 < plan[:, 1].max() <= 2
