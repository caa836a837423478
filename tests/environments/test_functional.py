"""The functional environment against a plain simulation, planners' action sequences and its own promises."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental import checkify

from dc2g_jax._src.environments.functional import (
    FrontDoor,
    Observation,
    egocentric,
    front_door,
    image,
    observe,
    one_hot_view,
)
from dc2g_jax._src.environments.wrappers import FlattenObservation
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.terrain import FIGURE_RGB, OUTSIDE
from dc2g_jax._src.planning.planners import Oracle
from dc2g_jax._src.readers.houses import stack_worlds
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.rollouts.rollout import rollout
from tests.oracles import numpy_gridworld as oracle
from tests.support.houses import STREET, WALLED, YARD, house, start_poses
from tests.support.refusals import refusal

HOUSES = (house("street", STREET), house("yard", YARD))
TERRAINS = (STREET, YARD)
RANGE, LIMIT = 4, 60
ENVIRONMENT, PARAMS = front_door(HOUSES, sensing_range=RANGE, step_limit=LIMIT)
reset = jax.jit(ENVIRONMENT.reset)
start = jax.jit(ENVIRONMENT.start)
step = jax.jit(ENVIRONMENT.step)
advance = jax.jit(ENVIRONMENT.advance)


def pose_of(observation) -> tuple[int, int, int]:
    pose = observation.pose
    return int(pose.x), int(pose.y), int(pose.heading)


def begin(number: int, x: int, y: int, heading: int):
    return start(jnp.int32(number), make_pose(x, y, heading), PARAMS)


class Simulation:
    """One episode in plain NumPy."""

    def __init__(self, terrain: np.ndarray, pose: tuple[int, int, int]):
        self.terrain, self.pose, self.steps = terrain, pose, 0
        self.seen = oracle.visible(pose, RANGE, terrain.shape)

    def act(self, action: int) -> tuple[bool, bool]:
        """Take an action: is a door reached, are the steps used up?"""
        self.pose = oracle.driven(self.pose, action, np.isin(self.terrain, oracle.TRAVERSABLE_CLASSES))
        self.steps += 1
        self.seen |= oracle.visible(self.pose, RANGE, self.terrain.shape)
        reached = bool(self.terrain[self.pose[1], self.pose[0]] == oracle.FRONT_DOOR)
        return reached, self.steps == LIMIT and not reached

    def check(self, observation) -> None:
        assert pose_of(observation) == self.pose
        np.testing.assert_array_equal(observation.terrain, np.where(self.seen, self.terrain, 0))


@jax.jit
def walk(key, actions):
    """The first observation and house of a robot, and what comes of its actions, one after another."""

    def cycle(carry, action):
        key, state = carry
        key, own = jax.random.split(key)
        observation, state, *outcome = ENVIRONMENT.step(own, state, action, PARAMS)
        return (key, state), (observation, state.house, *outcome)

    observation, state = ENVIRONMENT.reset(key, PARAMS)
    return observation, state.house, jax.lax.scan(cycle, (key, state), actions)[1]


def test_random_actions_against_a_plain_simulation():
    """Many steps over many episodes, whose random starts are checked as well."""
    actions = np.random.default_rng(0).choice([0, 0, 0, 1, 2], 1500)
    observation, house_index, steps = jax.device_get(walk(jax.random.key(0), jnp.asarray(actions, jnp.int32)))
    simulation = Simulation(TERRAINS[house_index], pose_of(observation))
    simulation.check(observation)
    bumped, endings = 0, collections.Counter()
    for number, action in enumerate(actions):
        observation, next_house, reward, *ends, info = jax.tree.map(lambda leaf, at=number: leaf[at], steps)
        before = simulation.pose
        terminated, truncated = simulation.act(int(action))
        bumped += action == 0 and simulation.pose == before
        simulation.check(info["final_observation"])
        assert reward == -1.0
        assert ends == [info["terminated"], info["truncated"]] == [terminated, truncated]
        assert info["episode_return"] == -simulation.steps == -info["episode_length"]
        if terminated or truncated:
            endings[int(house_index), terminated] += 1
            house_index, first = next_house, pose_of(observation)
            assert first in start_poses(TERRAINS[house_index])
            simulation = Simulation(TERRAINS[house_index], first)
        assert next_house == house_index
        simulation.check(observation)
    # Both ways to end, in both houses, and obstacles were met.
    assert len(endings) == 4
    assert bumped > 50


def test_a_robot_that_only_drives_forward_stays_on_ground():
    for number, terrain in enumerate(TERRAINS):
        for x, y, heading in sorted(start_poses(terrain)):
            _, state = begin(number, x, y, heading)
            for _ in range(max(terrain.shape)):
                state = advance(state, jnp.int32(0), PARAMS)[0]
                pose = pose_of(observe(state))
                assert terrain[pose[1], pose[0]] in oracle.TRAVERSABLE_CLASSES


def test_the_oracle_s_actions_end_the_episode_when_the_rollout_says():
    starts = sample_starts(HOUSES, 4, seed=3)
    episodes = episodes_from(starts, {"street": 0, "yard": 1})
    planned = rollout(Oracle(), stack_worlds(HOUSES), *episodes, sensing=field_of_view(RANGE), step_limit=LIMIT)
    assert np.all(planned.success)
    for number, one in enumerate(starts):
        _, state = begin(("street", "yard").index(one.house), one.x, one.y, one.heading)
        for count in range(planned.steps[number]):
            action = jnp.int32(planned.actions[number, count])
            _, state, _, terminated, truncated, info = step(jax.random.key(0), state, action, PARAMS)
            assert (bool(terminated), bool(truncated)) == (count + 1 == planned.steps[number], False)
        assert float(info["episode_return"]) == -planned.steps[number]


def test_a_door_reached_with_the_last_step_is_no_truncation():
    params = dataclasses.replace(PARAMS, step_limit=jnp.int32(2))
    for first_action, ends in ((0, (True, False)), (1, (False, True))):
        _, state = begin(1, 3, 3, 3)
        _, state, _, *first_ends, _ = step(jax.random.key(0), state, jnp.int32(first_action), params)
        assert not any(first_ends)
        *_, terminated, truncated, _ = step(jax.random.key(0), state, jnp.int32(0), params)
        assert (bool(terminated), bool(truncated)) == ends


def test_starts_are_uniform_over_houses_and_over_their_road_in_every_heading():
    keys = jax.random.split(jax.random.key(5), 4000)
    observations, states = jax.jit(jax.vmap(ENVIRONMENT.reset, in_axes=(0, None)))(keys, PARAMS)
    pose = observations.pose
    drawn = np.stack([states.house, pose.x, pose.y, pose.heading], axis=-1).tolist()
    poses = [{(x, y, heading) for house, x, y, heading in drawn if house == number} for number in range(2)]
    assert poses == [start_poses(terrain) for terrain in TERRAINS]
    # Each house as often as the other, whatever its road: 0.5 within four standard deviations.
    assert abs(float(jnp.mean(states.house)) - 0.5) < 4 * 0.5 / np.sqrt(4000)
    # The street's two rows of road.
    assert abs(float(jnp.mean(pose.y[states.house == 0])) - 4.5) < 4 * 0.5 / np.sqrt(2000)


def signature(tree) -> list[tuple]:
    return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)]


@pytest.mark.parametrize("action", [np.int64(1), 0, np.int8(2)], ids=["int64", "int", "int8"])
def test_step_keeps_structure_shapes_dtypes_and_weak_types(action):
    before = jax.eval_shape(ENVIRONMENT.reset, jax.random.key(0), PARAMS)
    given = jax.eval_shape(ENVIRONMENT.start, jnp.int32(0), make_pose(0, 4, 0), PARAMS)
    after = jax.eval_shape(ENVIRONMENT.step, jax.random.key(0), before[1], action, PARAMS)
    assert jax.tree.structure(before) == jax.tree.structure(given) == jax.tree.structure(after[:2])
    assert signature(before) == signature(given) == signature(after[:2])
    assert signature(after[5]["final_observation"]) == signature(before[0])
    assert not any(weak for _, _, weak in signature(after))
    assert [leaf.dtype for leaf in after[2:5]] == [jnp.float32, jnp.bool_, jnp.bool_]


def test_many_robots_go_through_what_each_does_alone():
    actions = jnp.asarray(np.random.default_rng(2).choice([0, 0, 0, 1, 2], (5, 200)), jnp.int32)
    keys = jax.random.split(jax.random.key(7), 5)
    together = jax.vmap(walk)(keys, actions)
    for robot in range(5):
        alone = walk(keys[robot], actions[robot])
        jax.tree.map(lambda many, one, at=robot: np.testing.assert_array_equal(many[at], one), together, alone)


def test_the_same_key_of_either_kind_begins_the_same_episode():
    keys = jax.random.key(4), jax.random.key(4), jax.random.PRNGKey(4), jax.random.key(5)
    one, again, old_style, other = (reset(key, PARAMS) for key in keys)
    jax.tree.map(np.testing.assert_array_equal, one, again)
    jax.tree.map(np.testing.assert_array_equal, one, old_style)
    assert pose_of(one[0]) != pose_of(other[0])


@pytest.mark.parametrize("heading", range(4))
@pytest.mark.parametrize("cell", [(0, 0), (9, 7), (4, 2)], ids=str)
def test_egocentric_cells_lie_ahead_and_to_the_right(heading, cell):
    terrain = np.arange(80, dtype=np.uint8).reshape(8, 10)
    radius = 3
    seen = np.asarray(egocentric(Observation(jnp.asarray(terrain), make_pose(*cell, heading)), radius))
    assert seen.shape == (7, 7)
    assert seen.dtype == np.uint8
    ahead, right = oracle.STEPS[heading], oracle.STEPS[(heading + 1) % 4]
    for up in range(-radius, radius + 1):
        for aside in range(-radius, radius + 1):
            x, y = (cell[axis] + up * ahead[axis] + aside * right[axis] for axis in (0, 1))
            inside = 0 <= x < 10 and 0 <= y < 8
            assert seen[radius - up, radius + aside] == (terrain[y, x] if inside else OUTSIDE)


def test_a_plane_of_the_one_hot_view_is_one_where_the_view_has_its_class():
    observation, _ = begin(0, 0, 4, 1)
    planes = one_hot_view(observation, 3)
    assert (planes.shape, planes.dtype) == ((OUTSIDE + 1, 7, 7), jnp.float32)
    assert np.all(np.asarray(planes).sum(axis=0) == 1)
    np.testing.assert_array_equal(planes.argmax(axis=0), egocentric(observation, 3))


def test_images_of_a_batch():
    """A cell has its class's color, and the robot, which points ahead, is black."""
    poses = [pose for terrain in TERRAINS for pose in sorted(start_poses(terrain))[:4]]
    seen = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(begin(n // 4, *pose)[0] for n, pose in enumerate(poses)))
    images = np.asarray(jax.jit(jax.vmap(image))(seen))
    assert (images.shape, images.dtype) == ((8, 8 * STREET.shape[0], 8 * STREET.shape[1], 3), np.uint8)
    for (x, y, heading), terrain, picture in zip(poses, np.asarray(seen.terrain), images, strict=True):
        middles = picture[4::8, 4::8]
        elsewhere = np.ones(terrain.shape, bool)
        elsewhere[y, x] = False
        np.testing.assert_array_equal(middles[elsewhere], FIGURE_RGB[terrain[elsewhere]])
        own = (picture[8 * y : 8 * y + 8, 8 * x : 8 * x + 8] == 0).all(axis=-1)
        rows, columns = np.nonzero(own)
        dx, dy = oracle.STEPS[heading]
        assert (columns.mean() - 3.5) * dx + (rows.mean() - 3.5) * dy < 0  # a triangle is wider behind
        assert 20 < own.sum() < 40


def test_without_autoreset_an_episode_stays_at_its_end():
    environment, _ = front_door(HOUSES[:1], step_limit=1, autoreset=False)
    seen, state = environment.reset(jax.random.key(0))
    seen, state, _, _, truncated, info = environment.step(jax.random.key(1), state, 1)
    assert truncated
    jax.tree.map(np.testing.assert_array_equal, seen, info["final_observation"])
    assert state.belief.steps == 1


def test_the_interface_of_gymnax():
    """Names, spaces and values as in its base class, and parameters that need not be given."""
    assert (ENVIRONMENT.name, ENVIRONMENT.num_actions, ENVIRONMENT.default_params) == ("FrontDoor-v0", 3, PARAMS)
    assert repr(ENVIRONMENT) == f"FrontDoor(sensing=Kernel(radius={ENVIRONMENT.sensing.radius}))"
    actions, observations = ENVIRONMENT.action_space(PARAMS), ENVIRONMENT.observation_space(PARAMS)
    assert (actions.n, actions.shape, actions.dtype) == (3, (), jnp.int32)
    assert observations.spaces["terrain"].shape == STREET.shape
    key = jax.random.key(0)
    seen, state = begun = ENVIRONMENT.reset(key)
    jax.tree.map(np.testing.assert_array_equal, begun, reset(key, PARAMS))
    jax.tree.map(np.testing.assert_array_equal, ENVIRONMENT.step(key, state, 1), step(key, state, 1, PARAMS))
    assert observations.contains(seen)
    drawn = observations.sample(key)
    assert observations.contains(drawn)
    assert signature(drawn) == signature(seen)
    beyond = dataclasses.replace(seen, pose=make_pose(STREET.shape[1], 0, 0))
    assert not observations.contains(beyond)
    assert not observations.contains(dataclasses.replace(seen, terrain=seen.terrain.at[0, 0].set(OUTSIDE)))
    assert {int(actions.sample(one)) for one in jax.random.split(key, 40)} == {0, 1, 2}
    assert actions.contains(jnp.array([-1, 0, 2, 3])).tolist() == [False, True, True, False]
    refusal(lambda: FrontDoor(ENVIRONMENT.sensing).reset(key), "no params are given")


def test_checkify_refuses_unknown_actions():
    """For one of many robots, too; without `checkify` such an action does nothing."""
    robots = jax.vmap(ENVIRONMENT.step, in_axes=(0, 0, 0, None))
    checked = jax.jit(checkify.checkify(robots, errors=checkify.index_checks))
    keys = jax.random.split(jax.random.key(0), 3)
    _, states = jax.vmap(ENVIRONMENT.reset, in_axes=(0, None))(keys, PARAMS)
    checked(keys, states, jnp.array([0, 1, 2]), PARAMS)[0].throw()
    for unknown in (3, -1):
        error, after = checked(keys, states, jnp.array([0, unknown, 2]), PARAMS)
        with pytest.raises(checkify.JaxRuntimeError, match=f"index {unknown} is out of bounds for axis 0 with size 3"):
            error.throw()
        jax.tree.map(lambda new, old: np.testing.assert_equal(new[1], old[1]), after[0].pose, states.belief.pose)


def test_a_training_loop_for_five_values_and_flat_observations():
    """The calls of PureJaxRL's `ppo.py`: a network of the spaces' sizes acts for several robots, inside a scan."""
    env = FlattenObservation(ENVIRONMENT, radius=2)
    (inputs,) = env.observation_space(PARAMS).shape
    weights = jax.random.normal(jax.random.key(1), (inputs, env.action_space(PARAMS).n))

    def env_step(carry, key):
        states, last = carry
        actions = jax.random.categorical(key, last @ weights)
        keys = jax.random.split(key, len(last))
        seen, states, reward, done, info = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, states, actions, PARAMS)
        return (states, seen), (last, reward, done, info)

    keys = jax.random.split(jax.random.key(0), 4)
    first, states = jax.vmap(env.reset, in_axes=(0, None))(keys, PARAMS)
    scan = jax.jit(lambda carry, keys: jax.lax.scan(env_step, carry, keys))
    (states, last), (seen, reward, done, info) = scan((states, first), jax.random.split(jax.random.key(2), 2 * LIMIT))
    assert (seen.shape, seen.dtype) == ((2 * LIMIT, 4, 25 * (OUTSIDE + 1)), jnp.float32)
    np.testing.assert_array_equal(last[0], one_hot_view(observe(jax.tree.map(lambda leaf: leaf[0], states)), 2).ravel())
    assert done.any(axis=0).all()
    np.testing.assert_array_equal(done, info["terminated"] | info["truncated"])
    assert np.all(info["episode_length"][done] == -info["episode_return"][done])
    assert np.all(reward == -1)
    # What such a loop keeps of every step is small.
    assert max(leaf.size for leaf in jax.tree.leaves(info)) == done.size


def test_six_values_are_those_of_the_environment_with_flat_observations():
    flat = FlattenObservation(ENVIRONMENT, radius=2, six_values=True)
    assert (flat.name, flat.num_actions) == (ENVIRONMENT.name, ENVIRONMENT.num_actions)
    _, state = ENVIRONMENT.reset(jax.random.key(3), PARAMS)
    states = state
    for step in range(LIMIT):
        given = jax.random.key(step), state, jnp.int32(1), PARAMS
        (seen, states, *rest, told), (expected, state, *wanted, info) = flat.step(*given), ENVIRONMENT.step(*given)
        np.testing.assert_array_equal(seen, one_hot_view(expected, 2).ravel())
        np.testing.assert_array_equal(told["final_observation"], one_hot_view(info["final_observation"], 2).ravel())
        jax.tree.map(np.testing.assert_array_equal, (states, rest), (state, wanted))
    assert rest[-1]  # truncated


def test_flat_observations_are_drawn_evenly_between_zero_and_one():
    space = FlattenObservation(ENVIRONMENT).observation_space()
    drawn = space.sample(jax.random.key(0))
    assert drawn.shape == (17**2 * (OUTSIDE + 1),)
    assert space.contains(drawn)
    np.testing.assert_allclose([drawn.mean(), drawn.std()], [1 / 2, 12**-0.5], atol=0.02)


def test_a_robot_may_see_all_around():
    env, params = front_door(HOUSES, sensing_range=3, field_of_view=360)
    observation, _ = env.reset(jax.random.key(0), params)
    pose = tuple(int(part) for part in (observation.pose.x, observation.pose.y, observation.pose.heading))
    seen = np.asarray(observation.terrain) != 0
    assert seen.any()
    assert not (seen & ~oracle.visible(pose, 3, seen.shape, 360)).any()
    assert (seen & ~oracle.visible(pose, 3, seen.shape, 180)).any()


def test_refusals():
    refusal(lambda: front_door([]), "give at least one")
    refusal(
        lambda: front_door([*HOUSES, house("walled", WALLED)]), "walled", "no front door can be reached", "leave it"
    )
    refusal(lambda: front_door([*HOUSES, house("narrow", STREET[:, :9])]), "narrow", "street")
    refusal(lambda: front_door(HOUSES, sensing_range=0), "sensing_range 0:", "from 1 to")
    refusal(lambda: front_door(HOUSES, field_of_view=361), "field of view 361:", "from 1 to 360 degrees")
    refusal(lambda: front_door(HOUSES, step_limit=0), "step_limit 0:", "from 1 to")
    refusal(lambda: front_door(HOUSES, step_limit=2**31), "step_limit 2147483648:", "from 1 to 2147483647")
