import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.indoor.houses.plans import Furniture, world_from_plan
from dc2g_jax.indoor.houses.worlds import approaches, padded_alike, sample_starts, scene, start_cells
from dc2g_jax.indoor.maps.classes import BED, CHAIR, GOALS, OBJECT_CLASSES, OBJECT_COLORS, PLANT, TABLE
from dc2g_jax.robot.mapping.camera import level_camera
from dc2g_jax.robot.mapping.simulator import cast
from tests.support.two_rooms import BED_BOX, PLANT_BOX, plan, rooms_cut_off


def test_classes_are_named_and_colored_once():
    assert (
        len(OBJECT_CLASSES) == 17 == len(set(OBJECT_CLASSES)) == len({tuple(color) for color in OBJECT_COLORS.tolist()})
    )
    assert [OBJECT_CLASSES[goal] for goal in GOALS] == ["bed", "chair", "sink", "plant", "couch"]


def test_stacked_houses_keep_their_places():
    small, large = world_from_plan(plan(BED_BOX), 0.1), world_from_plan(plan(BED_BOX, PLANT_BOX, width=7.0), 0.1)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded_alike([small, large]))
    assert stacked.free.shape == (2, *large.free.shape)
    rows, columns = small.free.shape
    np.testing.assert_array_equal(stacked.classes[0, :rows, :columns], small.classes)
    assert not stacked.free[0, :, columns:].any()
    assert (stacked.instances[0, rows:] == -1).all()
    assert stacked.object_kinds.tolist() == [[BED, 0], [BED, PLANT]]
    goals = jax.vmap(lambda world, goal: (world.classes == goal).sum())(stacked, jnp.array([BED, PLANT]))
    assert goals.tolist() == [(small.classes == BED).sum(), (large.classes == PLANT).sum()]


def test_cells_without_sense_are_refused():
    with pytest.raises(InputError, match="cell size"):
        world_from_plan(plan(), 0.0)
    with pytest.raises(InputError, match="cells a side"):
        world_from_plan(plan(), 1e-4)


def test_the_higher_object_is_seen_and_a_hidden_one_has_no_cells():
    table = Furniture(TABLE, 1.5, 1.5, 1.2, 0.8, 0.0, 0.75)
    stool = Furniture(CHAIR, 1.5, 1.5, 0.3, 0.3, 0.0, 0.4)
    chair = Furniture(CHAIR, 1.5, 0.95, 0.4, 0.5, 0.0, 0.9)
    world = world_from_plan(plan(stool, table, chair), 0.1)
    assert set(np.unique(world.instances)) == {-1, 1, 2}
    inner = world.instances == 2
    assert np.unique(world.heights[inner]) == pytest.approx(0.9)
    # Middles of cells lie on whole decimeters: x from 1.3 to 1.7, y from 0.7 to 1.2.
    assert inner.sum() == 5 * 6


def test_the_camera_meets_what_stands_in_a_world():
    world = world_from_plan(plan(PLANT_BOX), 0.05)
    pose = level_camera(x=4.25, y=-(3.25 - 0.5), z=0.5, yaw=0.0, pitch=0.0)
    hit = cast(scene(world), pose.position, jnp.array([1.0, 0.0, 0.0]), jnp.float32(8.0))
    # The plant's face lies at x = 5.3 of the plan, that is 5.55 of the world.
    assert hit.distance == pytest.approx(1.3, abs=0.051)
    assert world.classes[int(hit.row), int(hit.column)] == PLANT


def test_starts_are_free_far_enough_away_and_connected():
    world = world_from_plan(plan(PLANT_BOX, BED_BOX), 0.1)
    starts = sample_starts(world, PLANT, 200, rng=np.random.default_rng(0), distance=3.0)
    assert starts.shape == (200, 3)
    x, y = starts[:, 0] - 0.25, starts[:, 1] + 3.25
    assert np.hypot(np.maximum(5.3 - x, 0), np.maximum(y - 0.7, 0)).min() >= 3.0 - 0.15
    inside_bed = (np.abs(x - 1.0) < 0.5 + 0.2) & (np.abs(y - 2.0) < 0.8 + 0.2)
    assert not inside_bed.any()
    assert (np.minimum(x, y) > 0.25 - 1e-6).all()
    assert np.ptp(starts[:, 2]) > 5
    again = sample_starts(world, PLANT, 200, rng=np.random.default_rng(0), distance=3.0)
    np.testing.assert_array_equal(starts, again)


@pytest.mark.parametrize(("door", "opened"), [(0.0, False), (0.3, False), (0.6, True)])
def test_no_start_where_the_robot_does_not_get_through(door, opened):
    world = world_from_plan(plan(PLANT_BOX, door=door), 0.05)
    cells = start_cells(world, PLANT, distance=1.0)
    assert np.any(cells & (world.rooms == 2))
    assert np.any(cells & (world.rooms == 1)) == opened
    assert (rooms_cut_off(world) == []) == opened


def test_an_object_behind_a_wall_is_not_reached():
    world = world_from_plan(plan(Furniture(PLANT, 3.3, 0.5, 0.4, 0.4, 0.0, 0.8)), 0.05)
    near = approaches(world, PLANT)
    assert set(np.unique(world.rooms[near])) == {2}
    assert sample_starts(world, CHAIR, 5, rng=np.random.default_rng(0)).shape == (0, 3)
