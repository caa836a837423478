"""The indoor map against plain loops and against the house that it is of."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.indoor.houses.worlds import scene
from dc2g_jax.indoor.maps import mapping
from dc2g_jax.indoor.maps.classes import BED, PLANT
from dc2g_jax.indoor.maps.mapping import EXPLORED_CHANNEL, OBSTACLE_CHANNEL, IndoorMapSettings
from dc2g_jax.robot.mapping.camera import intrinsics, level_camera, points
from dc2g_jax.robot.mapping.simulator import render
from tests.support.two_rooms import two_rooms

SETTINGS = IndoorMapSettings(cells=90, local=30, cell_size=0.1, reach=4.0)
CAMERA = intrinsics(90.0, 48, 64)
START = jnp.array([2.61, -1.78], jnp.float32)


@pytest.fixture(scope="module")
def world():
    return two_rooms().world


@pytest.fixture(scope="module")
def view(world):
    """A frame that shows the bed, and the map that is made of it."""
    pose = level_camera(*START, 0.9, 2.9, 0.35)
    frame = jax.jit(lambda pose: render(scene(world), CAMERA, pose, SETTINGS.reach))(pose)
    integrate = jax.jit(lambda before, frame: mapping.integrate(before, frame, CAMERA, SETTINGS))
    return frame, integrate(mapping.empty_map(START, SETTINGS), frame), integrate


def in_world(indoor_map, world, channel):
    """A channel of the map on the world's cells."""
    row, column = -np.asarray(indoor_map.origin)
    height, width = world.free.shape
    return np.asarray(mapping.has(indoor_map.cells, channel))[row : row + height, column : column + width]


def test_the_map_shows_what_stands_in_the_house_and_no_more(view, world):
    _, seen, _ = view
    obstacle, explored, bed = (
        in_world(seen, world, channel) for channel in (OBSTACLE_CHANNEL, EXPLORED_CHANNEL, BED - 1)
    )
    assert bed.sum() >= 20
    assert not np.any(bed & (world.classes != BED))
    assert not np.any(obstacle & ~world.obstacle)
    assert not np.any(explored & ~world.free & ~world.obstacle)
    assert np.any(obstacle & world.walls)
    # The camera looks left, away from the door.
    assert not explored[:, 34:].any()
    # Free floor has no holes: all cells of a square in the middle of the view.
    assert (explored & ~obstacle)[6:12, 14:20].all()


def test_points_are_booked_like_in_a_plain_loop(view, world):
    frame, seen, _ = view
    shown = np.asarray(points(frame.depth, CAMERA, frame.pose), float)
    expected = np.zeros((2, *world.free.shape), bool)
    doubtful = np.zeros(world.free.shape, bool)
    for (x, y, z), label, depth in zip(
        shown.reshape(-1, 3), np.asarray(frame.classes).ravel(), np.asarray(frame.depth).ravel(), strict=True
    ):
        place = np.array([-y, x]) / 0.1
        behind = np.sign(place - np.array([1.78, 2.61]) / 0.1) * 0.01
        nearest = np.argmin(np.abs(place - place.round()))
        place[nearest] += behind[nearest]
        row, column = np.floor(place).astype(int)
        doubtful[row, column] |= np.abs(place - place.round()).min() < 1e-3
        if depth > 0:
            expected[0, row, column] |= 0.1 < z < 1.5
            expected[1, row, column] |= label == BED
    for truth, channel in zip(expected, (OBSTACLE_CHANNEL, BED - 1), strict=True):
        found = in_world(seen, world, channel)
        np.testing.assert_array_equal(found[~doubtful], truth[~doubtful])


def test_what_the_floor_shows_to_be_wrong_is_forgotten(view):
    frame, seen, integrate = view
    row, column = np.array([18, 19]) - np.asarray(seen.origin)
    wrong = seen.replace(
        cells=seen.cells.at[row, column].set((1 << OBSTACLE_CHANNEL) | 1).at[0, 0].set(1 << OBSTACLE_CHANNEL)
    )
    after = integrate(wrong, frame)
    assert int(after.cells[row, column]) == 1 << EXPLORED_CHANNEL
    # Far from what is in view everything stays.
    assert int(after.cells[0, 0]) == 1 << OBSTACLE_CHANNEL
    assert jax.tree.map(lambda leaf: (leaf.dtype, leaf.weak_type), after) == jax.tree.map(
        lambda leaf: (leaf.dtype, leaf.weak_type), mapping.empty_map(START, SETTINGS)
    )


def test_frames_vote_on_what_stands_in_a_cell(view):
    frame, exact, _ = view
    settings = IndoorMapSettings(cells=90, local=30, cell_size=0.1, reach=4.0, votes=2)
    integrate = jax.jit(lambda before, frame: mapping.integrate(before, frame, CAMERA, settings))
    wrong = frame.replace(classes=jnp.where(frame.classes == BED, PLANT, frame.classes).astype(jnp.uint8))
    seen, votes = mapping.empty_map(START, settings), {BED: 0, PLANT: 0}
    bed = np.asarray(mapping.has(exact.cells, BED - 1)) & np.asarray(mapping.has(exact.cells, OBSTACLE_CHANNEL))
    for errs in (True, False, True, False, False, True, False, True, True, True, True):
        seen = integrate(seen, wrong if errs else frame)
        for kind, shown in ((BED, not errs), (PLANT, errs)):
            votes[kind] = min(votes[kind] + 1, 3) if shown else max(votes[kind] - 1, 0)
            found = np.asarray(mapping.has(seen.cells, kind - 1))
            # Cells that are mostly of another class have no votes at all.
            assert (found & bed).sum() >= (votes[kind] >= 2) * 0.8 * bed.sum()
            assert votes[kind] >= 2 or not found[bed].any()
    assert votes == {BED: 0, PLANT: 3}
    # A few wrong pixels among the many of a near cell do not vote.
    few = wrong.classes.at[::7, ::7].get()
    speckled = frame.replace(classes=frame.classes.at[::7, ::7].set(few))
    near = mapping.empty_map(START, settings)
    for _ in range(3):
        near = integrate(near, speckled)
    assert np.asarray(mapping.has(near.cells, PLANT - 1)).sum() < 0.1 * bed.sum()


def test_a_robot_knows_the_floor_it_stands_on():
    position = jnp.array([2.61, -1.78])
    stand = jax.jit(lambda place: mapping.mark_explored(mapping.empty_map(START, SETTINGS), place, 0.2, SETTINGS))
    stood = stand(position)
    known = np.argwhere(np.asarray(mapping.has(stood.cells, EXPLORED_CHANNEL))) + np.asarray(stood.origin)
    expected = [
        (row, column)
        for row in range(10, 25)
        for column in range(20, 35)
        if np.hypot((column + 0.5) * 0.1 - 2.61, (row + 0.5) * 0.1 - 1.78) <= 0.2
    ]
    assert [tuple(cell) for cell in known.tolist()] == expected


def test_crops_are_centered_on_the_robot_and_empty_off_the_map():
    rng = np.random.default_rng(0)
    cells = rng.integers(0, 1 << 18, (90, 90), dtype=np.uint32)
    indoor_map = mapping.IndoorMap(jnp.asarray(cells), jnp.array([-20, 7]))
    # The robot is in row 12, column 90 of the world: row 32, column 83 of the map.
    position = jnp.array([9.04, -1.28], jnp.float32)
    around = np.pad(cells, 100)[100 + 32 - 45 : 100 + 32 + 45, 100 + 83 - 45 : 100 + 83 + 45]
    bits = (around >> np.arange(18, dtype=np.uint32)[:, None, None]) & 1
    show = lambda place: mapping.network_maps(mapping.window(indoor_map, mapping.grid_cell(place, 0.1), 90), 30)  # noqa: E731
    maps = np.asarray(jax.jit(show)(position))
    assert maps.shape == (36, 30, 30)
    np.testing.assert_array_equal(maps[:18], bits[:, 30:60, 30:60])
    np.testing.assert_allclose(maps[18:], bits.reshape(18, 30, 3, 30, 3).mean(axis=(2, 4)), rtol=1e-6)
