"""The robot's belief and its steps."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings

from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.world import World
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps
from tests.support.refusals import refusal

SENSING = field_of_view(4)
reset = jax.jit(functools.partial(gridworld.reset, sensing=SENSING))
step = jax.jit(functools.partial(gridworld.step, sensing=SENSING))


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (33, 1), (7, 33), (6, 64)], ids="{0[0]}x{0[1]}".format)
@given(seed=maps.seeds, density=maps.densities)
@settings(max_examples=8)
def test_a_walk_of_random_actions(shape, seed, density):
    terrain = maps.random_terrain(seed, shape, density, doors=2)
    world = World.from_terrain(terrain)
    pose = maps.random_pose(seed, np.ones(shape, bool))
    belief = reset(world, make_pose(*pose))
    seen, ground = oracle.visible(pose, 4, shape), np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
    for count, action in enumerate(np.random.default_rng(seed).choice([0, 0, 0, 1, 2], 15)):
        assert int(belief.steps) == count
        assert (int(belief.pose.x), int(belief.pose.y), int(belief.pose.heading)) == pose
        np.testing.assert_array_equal(bitboard.unpack(belief.seen, shape[1]), seen)
        np.testing.assert_array_equal(belief.terrain, np.where(seen, terrain, 0))
        np.testing.assert_array_equal(bitboard.unpack(belief.traversable, shape[1]), seen & ground)
        goals = terrain == oracle.FRONT_DOOR
        np.testing.assert_array_equal(bitboard.unpack(belief.goals, shape[1]), seen & goals)
        assert bool(gridworld.at_goal(world, belief.pose)) == goals[pose[1], pose[0]]
        belief = step(world, belief, jnp.int32(action))
        pose = oracle.driven(pose, int(action), ground)
        seen |= oracle.visible(pose, 4, shape)


@pytest.mark.parametrize("heading", range(4))
def test_a_step_off_the_map_stays_in_place(street, heading):
    height, width = street.shape
    x, y = ((width - 1, 2), (2, height - 1), (0, 2), (2, 0))[heading]
    belief = reset(World.from_terrain(street), make_pose(x, y, heading))
    after = step(World.from_terrain(street), belief, jnp.int32(0))
    assert (int(after.pose.x), int(after.pose.y), int(after.pose.heading)) == (x, y, heading)
    assert int(after.steps) == 1


@pytest.mark.parametrize("heading", range(4))
def test_a_robot_in_a_wall_turns_and_may_only_leave_it_onto_ground(heading):
    terrain = maps.drawn("""
        ###
        #tR
        ###
    """)
    world = World.from_terrain(terrain)
    belief = reset(world, make_pose(1, 1, heading))
    assert int(step(world, belief, jnp.int32(1)).pose.heading) == (heading - 1) % 4
    after = step(world, belief, jnp.int32(0))
    assert (int(after.pose.x), int(after.pose.y)) == ((2, 1) if heading == 0 else (1, 1))
    assert int(after.steps) == 1


def test_four_turns_either_way_lead_back(street):
    world = World.from_terrain(street)
    for action in (1, 2):
        belief = reset(world, make_pose(3, 3, 2))
        headings = [int(belief.pose.heading)]
        for _ in range(4):
            belief = step(world, belief, jnp.int32(action))
            headings.append(int(belief.pose.heading))
        assert headings == ([2, 1, 0, 3, 2] if action == 1 else [2, 3, 0, 1, 2])


def signature(tree) -> list[tuple]:
    return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)]


def test_a_step_keeps_shapes_dtypes_and_weak_types(street):
    world = World.from_terrain(street)

    def start():
        return gridworld.reset(world, make_pose(1, 4, 0), SENSING)

    before = jax.eval_shape(start)
    after = jax.eval_shape(lambda belief, action: gridworld.step(world, belief, action, SENSING), before, jnp.int32(0))
    assert jax.tree.structure(before) == jax.tree.structure(after)
    assert signature(before) == signature(after)
    assert not any(weak for _, _, weak in signature(before))
    # Whatever the type of the action.
    for action in (0, jnp.int8(1)):
        other = jax.eval_shape(lambda belief, a: gridworld.step(world, belief, a, SENSING), before, action)
        assert signature(other) == signature(before)


def test_reset_of_any_pose_gives_the_same_types(street):
    world = World.from_terrain(street)
    poses = (make_pose(1, 4, 0), make_pose(np.int64(1), np.int64(4), np.int64(0)))
    first, *others = [signature(gridworld.reset(world, pose, SENSING)) for pose in poses]
    assert all(other == first for other in others)


def test_steps_can_be_scanned_and_mapped(street):
    world = World.from_terrain(street)
    actions = np.random.default_rng(0).integers(0, 3, (5, 12))

    def walk(actions):
        belief = gridworld.reset(world, make_pose(1, 4, 0), SENSING)
        return jax.lax.scan(lambda b, a: (gridworld.step(world, b, a, SENSING), None), belief, actions)[0]

    beliefs = jax.jit(jax.vmap(walk))(jnp.asarray(actions))
    for row, one in enumerate(actions):
        belief = reset(world, make_pose(1, 4, 0))
        for action in one:
            belief = step(world, belief, jnp.int32(action))
        jax.tree.map(lambda many, single, row=row: np.testing.assert_array_equal(many[row], single), beliefs, belief)


def test_batch_axes_that_come_first_are_refused(street):
    world, many = World.from_terrain(street), make_pose(np.arange(1, 5), np.full(4, 4), np.zeros(4))
    beliefs = jax.vmap(lambda pose: gridworld.reset(world, pose, SENSING))(many)
    worlds, refused = beliefs.replace(goals=jnp.stack([world.goals] * 4)), "batch axes come last: "
    found = "goals for poses [4] are [4, 1, 8], expected [1, h, 4]; with jax.vmap, give in_axes=-1 and out_axes=-1"
    refusal(lambda: gridworld.reset(worlds, many, SENSING), refused + found)
    refusal(lambda: gridworld.reset(world, many, SENSING), refused, "poses [4] are [1, 8]")
    refusal(lambda: gridworld.reset(world, make_pose(1, 4, np.arange(2)), SENSING), refused, "poses [2] are [1, 8]")
    stack = World.from_terrain(np.stack([street] * 4, axis=-1))
    refusal(lambda: gridworld.step(stack, beliefs, jnp.zeros(4, jnp.int32), SENSING), refused + found)
    refusal(lambda: gridworld.at_goal(worlds, many), refused + found)
    maps_first = np.stack([street] * 4)
    refusal(lambda: gridworld.belief_from_map(maps_first, many), refused, "maps for poses [4] are [4, 8, 10]")
    # As the message says.
    again = jax.vmap(lambda pose: gridworld.reset(world, pose, SENSING), in_axes=-1, out_axes=-1)(many)
    jax.tree.map(np.testing.assert_array_equal, again, gridworld.reset(stack, many, SENSING))
    refusal(lambda: gridworld.step(world, again, jnp.zeros(4, jnp.int32), SENSING), refused, "poses [4] are [1, 8]")


def test_worlds_of_a_batch_are_those_of_its_members(street, island):
    both = World.from_terrain(np.stack([street, island], axis=-1))
    for number, terrain in enumerate((street, island)):
        alone = World.from_terrain(terrain)
        assert alone.terrain.dtype == np.uint8
        jax.tree.map(lambda many, one, n=number: np.testing.assert_array_equal(many[..., n], one), both, alone)
        np.testing.assert_array_equal(alone.terrain, terrain)
        np.testing.assert_array_equal(
            bitboard.unpack(alone.traversable, terrain.shape[1]), np.isin(terrain, oracle.TRAVERSABLE_CLASSES)
        )
