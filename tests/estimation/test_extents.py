"""What an estimator is asked about a map of unknown size, and what becomes of its answer."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct

from dc2g_jax._src.estimation.estimators import WHOLE_MAP, trait
from dc2g_jax._src.estimation.extents import TownWindow
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sampling import nearest_pixel
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.learned_score import TERMS, LearnedScore
from dc2g_jax._src.planning.rules import complete_rules
from experiments.benchmarks.extents import CroppedEstimator, Window, WindowedEstimator
from tests.support import maps

SHAPE = (9, 31)


@struct.dataclass
class Places:
    """Tells every cell its place in the grid that is asked about, and what it is."""

    def init(self, world):
        del world
        return ()

    def estimate(self, terrain, state):
        del state
        rows, columns = (jax.lax.broadcasted_iota(jnp.float32, terrain.shape, axis) for axis in (0, 1))
        return jnp.stack([100 * rows + columns, terrain.astype(jnp.float32)])


def seen_in(box, shape=SHAPE) -> np.ndarray:
    """A map of which some cells in a box have been observed, for sure those in two of its corners."""
    top, bottom, left, right = box
    terrain = np.zeros(shape, np.uint8)
    part = maps.random_terrain(sum(box), (bottom - top, right - left), 0.5)
    terrain[top:bottom, left:right] = part * maps.random_cells(sum(box), part.shape, 0.3)
    terrain[top, left] = terrain[bottom - 1, right - 1] = 3
    return terrain


def cropped(terrain: np.ndarray, box, side: int, margin: int) -> np.ndarray:
    """What `CroppedEstimator(Places())` has to answer, a cell at a time."""
    top, bottom, left, right = box
    size = max(bottom - top, right - left) + 2 * margin
    top, left = top - (size - bottom + top) // 2, left - (size - right + left) // 2
    read, back = nearest_pixel(np.arange(side), size, side), nearest_pixel(np.arange(size), side, size)
    answer = np.zeros((2, *terrain.shape), np.float32)
    for row in range(terrain.shape[0]):
        for column in range(terrain.shape[1]):
            i, j = (back[min(max(cell, 0), size - 1)] for cell in (row - top, column - left))
            y, x = top + read[i], left + read[j]
            inside = 0 <= y < terrain.shape[0] and 0 <= x < terrain.shape[1]
            answer[:, row, column] = (100 * i + j, terrain[y, x] if inside else 0)
    return answer * np.float32(size / side)


BOXES = [(2, 7, 3, 8), (0, 9, 0, 31), (4, 5, 30, 31), (1, 3, 5, 25), (0, 8, 20, 23)]


def test_a_crop_is_what_was_observed_enlarged_or_made_smaller():
    side, margin = 15, 2
    estimator = CroppedEstimator(Places(), side=side, margin=margin)
    terrain = np.stack([seen_in(box) for box in BOXES], axis=-1)
    wanted = np.stack([cropped(seen_in(box), box, side, margin) for box in BOXES], axis=-1)
    together = jax.jit(estimator.estimate)(terrain, ())
    np.testing.assert_allclose(together, wanted, rtol=1e-6)
    one_by_one = jax.vmap(lambda one: estimator.estimate(one, ()), in_axes=-1, out_axes=-1)(terrain)
    np.testing.assert_array_equal(one_by_one, together)


def test_a_crop_of_the_networks_size_is_left_as_it_is():
    box = (1, 6, 4, 10)
    answer = CroppedEstimator(Places(), side=8, margin=1).estimate(jnp.asarray(seen_in(box)), ())
    np.testing.assert_array_equal(answer[1, 1:6, 4:10], seen_in(box)[1:6, 4:10])


def test_a_crop_without_anything_observed_is_as_large_as_the_network_takes():
    top, left, size = CroppedEstimator(Places(), side=8).square(jnp.zeros(SHAPE, jnp.uint8))
    assert (int(top), int(left), int(size)) == (0, 0, 8)


def in_window(terrain: np.ndarray, x: int, y: int, side: int, before: np.ndarray) -> np.ndarray:
    """What a window has to make of the answer of `Places`, a cell at a time."""
    after = before.copy()
    for row in range(terrain.shape[0]):
        for column in range(terrain.shape[1]):
            i, j = row - y + side // 2, column - x + side // 2
            if 0 <= i < side and 0 <= j < side:
                after[:, row, column] = (100 * i + j, terrain[row, column])
    return after


@pytest.mark.parametrize("side", [1, 6, 70])
def test_a_window_asks_around_the_robot_and_keeps_the_rest(side):
    poses = np.array([(0, 0, 0), (30, 8, 1), (15, 4, 2), (3, 7, 3)])
    terrain = np.stack([seen_in(box) for box in BOXES[:4]], axis=-1)
    before = np.random.default_rng(0).random((2, *terrain.shape)).astype(np.float32)
    window, pose = Window(side), make_pose(*poses.T)
    part = window.part(jnp.asarray(terrain), pose)
    after = window.merged(Places().estimate(part, ()), pose, jnp.asarray(before))
    for robot, (x, y, _) in enumerate(poses):
        np.testing.assert_array_equal(after[..., robot], in_window(terrain[..., robot], x, y, side, before[..., robot]))
    # What lies beyond the map has not been observed.
    wide = np.pad(terrain, ((side, side), (side, side), (0, 0)))
    for robot, (x, y, _) in enumerate(poses):
        top, left = y + side - side // 2, x + side - side // 2
        np.testing.assert_array_equal(part[..., robot], wide[top : top + side, left : left + side, robot])


def test_in_towns_a_window_within_the_map_is_magnified_to_its_size():
    side, shape = 10, (9, 30)
    poses = np.array([(0, 0, 0), (29, 8, 1), (15, 4, 2), (15, 4, 2)])
    zooms = np.array([True, True, True, False])
    terrain = np.random.default_rng(0).integers(0, 9, (*shape, 4)).astype(np.uint8)
    before = np.random.default_rng(1).random((2, *terrain.shape)).astype(np.float32)
    surroundings, pose = TownWindow(jnp.asarray(zooms), side), make_pose(*poses.T)
    part = surroundings.part(jnp.asarray(terrain), pose)
    # The network shrinks the map by 3, so that it reads 3 x 10 cells as they are.
    for robot, (top, left) in enumerate([(0, 0), (6, 20), (3, 10)]):
        window = terrain[top : top + 3, left : left + 10, robot]
        np.testing.assert_array_equal(part[1::3, 1::3, robot], window)
        np.testing.assert_array_equal(part[..., robot], np.kron(window, np.ones((3, 3), np.uint8)))
    np.testing.assert_array_equal(part[..., 3], terrain[..., 3])
    answer = Places().estimate(part, ())
    merged = surroundings.merged(answer, pose, jnp.asarray(before))
    for robot, (top, left) in enumerate([(0, 0), (6, 20), (3, 10)]):
        wanted = before[..., robot].copy()
        # Costs are in cells of the part, which are a third as long.
        wanted[:, top : top + 3, left : left + 10] = answer[:, 1::3, 1::3, robot] * np.float32(1 / 3)
        np.testing.assert_allclose(merged[..., robot], wanted, rtol=1e-6)
    np.testing.assert_array_equal(merged[..., 3], answer[..., 3])


def test_an_estimator_without_an_extent_is_asked_about_the_whole_map():
    assert trait(Places(), "extent") is WHOLE_MAP
    assert trait(CroppedEstimator(Places()), "extent") is WHOLE_MAP
    assert trait(WindowedEstimator(Places(), Window(7)), "extent") == Window(7)


def test_a_planner_keeps_what_has_left_the_window(street):
    rules, window = complete_rules(2), Window(side=4, prior=77.0)
    # The map is asked about as it is, then mirrored: the window is mirrored, not moved.
    planner = LearnedScore(rules, jnp.zeros(len(TERMS)), WindowedEstimator(Places(), window), replan_fraction=0.0)
    world = World.from_terrain(street)
    belief = gridworld.reset(world, make_pose(9, 5, 2), rules.sensing)
    step = jax.jit(functools.partial(gridworld.step, sensing=rules.sensing))
    plan, state = jax.jit(planner.plan), planner.init(world)
    np.testing.assert_array_equal(state.estimates, 77)
    wanted = np.full((2, *street.shape), 77, np.float32)
    for turn in range(4):
        terrain, pose = np.asarray(belief.terrain), jax.device_get(belief.pose)
        _, state = plan(belief, state)
        mirrored = turn % 2 == 1
        part = in_window(terrain, int(pose.x), int(pose.y), window.side, np.full((2, *street.shape), np.nan))
        if mirrored:
            part[0] = 100 * (part[0] // 100) + window.side - 1 - part[0] % 100
        # The planner keeps the mean of the outcomes.
        latest = np.where(np.isnan(part[0]), wanted[0], part.mean(axis=0))
        wanted = np.stack([latest, latest if turn == 0 else wanted[0]])
        np.testing.assert_allclose(np.stack(state.estimates)[:, 0], wanted)
        belief = step(world, belief, jnp.int32(0))
    assert len(np.unique(wanted[0] == 77)) == 2
