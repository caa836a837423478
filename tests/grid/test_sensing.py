"""What a robot sees, against the rule cell by cell and the authors' own kernels."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dc2g_jax._src.grid import bitboard, gridworld, poses, sensing
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.world import World
from tests.oracles import numpy_gridworld as oracle
from tests.support import maps

each_shape = pytest.mark.parametrize("shape", maps.SHAPES, ids="{0[0]}x{0[1]}".format)


@functools.cache
def visible(shape: tuple[int, int], radius: int):
    kernel = sensing.field_of_view(radius)

    def run(x, y, heading):
        nothing = bitboard.pack(jnp.zeros((*shape, *x.shape), bool))
        return bitboard.unpack(kernel.visible(make_pose(x, y, heading), nothing, shape[1]), shape[1])

    return jax.jit(run)


@pytest.mark.parametrize("radius", [1, 5])
@each_shape
def test_visible_from_every_pose(shape, radius):
    y, x, heading = (part.ravel() for part in np.indices((*shape, 4)))
    result = np.asarray(visible(shape, radius)(x, y, heading))
    for index in range(len(x)):
        pose = (int(x[index]), int(y[index]), int(heading[index]))
        np.testing.assert_array_equal(result[..., index], oracle.visible(pose, radius, shape), err_msg=str(pose))


@pytest.mark.parametrize(("shape", "radius"), [((40, 65), 33), ((3, 70), 64), ((70, 2), 40), ((1, 1), 8)])
def test_visible_from_corners_with_a_field_of_view_wider_than_a_word(shape, radius):
    height, width = shape
    corners = [(x, y, heading) for x in (0, width - 1) for y in (0, height - 1) for heading in range(4)]
    result = np.asarray(visible(shape, radius)(*np.array(corners).T))
    for seen, pose in zip(np.moveaxis(result, -1, 0), corners, strict=True):
        np.testing.assert_array_equal(seen, oracle.visible(pose, radius, shape), err_msg=str(pose))


@functools.cache
def posing(shape: tuple[int, int]):
    """Poses that see, for a field of view and for an expanding kernel, and how many cells."""

    def run(cells):
        board = bitboard.pack(cells)
        kernels = (sensing.field_of_view(4), sensing.field_of_view(8), sensing.expanding_kernel(5))
        seeing = [poses.unpack(kernel.poses_that_see(board, jnp.zeros_like(board)), shape[1]) for kernel in kernels]
        return seeing, [kernel.count_seen(board, jnp.zeros_like(board), shape[1]) for kernel in kernels]

    return jax.jit(run)


@functools.cache
def occluded(shape: tuple[int, int]):
    """What is seen from every pose, and the poses that see a target, and how many, where some cells are opaque."""
    kernel = sensing.line_of_sight(6)
    y, x, heading = (part.ravel() for part in np.indices((*shape, 4)))

    def run(opaque, targets):
        board = bitboard.pack(opaque)
        every = jax.vmap(lambda x, y, heading: kernel.visible(make_pose(x, y, heading), board, shape[1]))
        seen = jax.vmap(lambda one: bitboard.unpack(one, shape[1]))(every(x, y, heading))
        targets = bitboard.pack(targets)
        counts = kernel.count_seen(targets, board, shape[1])
        return seen, poses.unpack(kernel.poses_that_see(targets, board), shape[1]), counts

    return jax.jit(run), list(zip(x.tolist(), y.tolist(), heading.tolist(), strict=True))


@pytest.mark.parametrize("shape", [(9, 31), (7, 33)], ids="{0[0]}x{0[1]}".format)
@given(seed=maps.seeds, density=st.sampled_from([0.0, 0.1, 0.4, 1.0]))
@settings(max_examples=5)
def test_opaque_cells_hide_what_is_behind_them(shape, seed, density):
    opaque, targets = maps.random_cells(seed, shape, density), maps.random_cells(seed + 1, shape, 0.05)
    run, every_pose = occluded(shape)
    seen, seeing, counts = (np.asarray(result) for result in run(opaque, targets))
    for pose, cells in zip(every_pose, seen, strict=True):
        np.testing.assert_array_equal(cells, oracle.visible_past(opaque, pose, 6), err_msg=str(pose))
        assert seeing[pose[2], pose[1], pose[0]] == np.any(cells & targets)
        assert counts[pose[2], pose[1], pose[0]] == np.sum(cells & targets)


@functools.cache
def angles() -> list[tuple[int, float]]:
    """Ranges and angles, 300 random ones, the first with cells on the edge of the field of view."""
    rng = np.random.default_rng(0)
    chosen = [360, 1, 180, 270, 359.9, *rng.uniform(1, 360, 295).tolist()]
    return list(zip(rng.integers(1, 10, len(chosen)).tolist(), chosen, strict=True))


def test_fields_of_view_of_any_angle_follow_the_rule():
    for radius, degrees in angles():
        for heading, offsets in enumerate(sensing.field_of_view(radius, degrees).offsets):
            assert set(offsets) == set(oracle.sensing_offsets(radius, heading, degrees)), (radius, degrees)


@pytest.mark.parametrize("examples", [12, pytest.param(300, marks=pytest.mark.slow)])
@pytest.mark.parametrize("view", [sensing.field_of_view, sensing.line_of_sight])
def test_what_is_seen_at_any_angle(view, examples):
    shape = height, width = 9, 33
    for seed, (radius, degrees) in enumerate(angles()[:examples]):
        kernel, rng = view(radius, degrees), np.random.default_rng(seed)
        opaque, targets = rng.random(shape) < 0.2, rng.random(shape) < 0.1
        walls, boards = (bitboard.pack(jnp.asarray(cells)) for cells in (opaque, targets))
        x, y, heading = rng.integers(0, [[width], [height], [4]], (3, 8))
        seen = kernel.visible(make_pose(x, y, heading), jnp.stack([walls] * 8, axis=-1), width)
        seen = np.moveaxis(np.asarray(bitboard.unpack(seen, width)), -1, 0)
        # These take a second to compile: 27 of 300.
        whole = (seed % (4 if seed < 12 else 12) == 0) * [kernel]
        seeing = [poses.unpack(one.poses_that_see(boards, walls), width) for one in whole]
        counts = [one.count_seen(boards, walls, width) for one in whole]
        for number, pose in enumerate(zip(x.tolist(), y.tolist(), heading.tolist(), strict=True)):
            if view is sensing.field_of_view:
                expected = oracle.visible(pose, radius, shape, degrees)
            else:
                expected = oracle.visible_past(opaque, pose, radius, degrees)
            np.testing.assert_array_equal(seen[number], expected, err_msg=f"{pose} {radius} {degrees}")
            count = np.sum(expected & targets)
            assert [one[pose[2], pose[1], pose[0]] for one in (*seeing, *counts)] == len(whole) * [count > 0, count]


def test_batches_see_what_each_of_them_sees():
    kernel, height, width = sensing.line_of_sight(6), 9, 33
    robots = [maps.random_pose(seed, np.ones((height, width), bool)) for seed in range(6)]
    opaque = np.stack([maps.random_cells(seed, (height, width), 0.2) for seed in range(6)])
    boards = bitboard.pack(jnp.moveaxis(jnp.asarray(opaque), 0, -1).reshape(height, width, 2, 3))
    pose = jax.tree.map(lambda part: part.reshape(2, 3), make_pose(*np.array(robots).T))
    seen = np.asarray(bitboard.unpack(kernel.visible(pose, boards, width), width)).reshape(height, width, 6)
    for number, robot in enumerate(robots):
        np.testing.assert_array_equal(seen[..., number], oracle.visible_past(opaque[number], robot, 6))


def test_a_wall_hides_a_street():
    picture = maps.drawn("""
        RRRRRRRRR
        RRR#RRRRR
        RRRRRRRRR
    """)
    belief = gridworld.reset(World.from_terrain(picture), make_pose(0, 1, 0), sensing.line_of_sight(8))
    hidden = np.argwhere(np.asarray(belief.terrain)[1] == 0).ravel()
    assert hidden.tolist() == [4, 5, 6, 7, 8]
    assert np.asarray(belief.terrain)[1, 3] == maps.drawn("#")[0, 0]


@each_shape
@given(seed=maps.seeds, density=maps.densities)
@settings(max_examples=20)
def test_poses_that_see(shape, seed, density):
    targets = maps.random_cells(seed, shape, density)
    offset_rules = (
        functools.partial(oracle.sensing_offsets, 4),
        functools.partial(oracle.sensing_offsets, 8),
        functools.partial(oracle.expanding_offsets, 5),
    )
    for seeing, counts, offsets in zip(*posing(shape)(targets), offset_rules, strict=True):
        for heading in range(4):
            sources = [oracle._sources(targets, [offset]) for offset in offsets(heading)]
            np.testing.assert_array_equal(counts[heading], np.sum(sources, axis=0))
            np.testing.assert_array_equal(seeing[heading], np.any(sources, axis=0))


@pytest.mark.parametrize("radius", range(1, 13))
def test_fields_of_view_follow_the_rule(radius):
    kernel = sensing.field_of_view(radius)
    assert kernel.radius == radius
    for heading in range(4):
        assert set(kernel.offsets[heading]) == set(oracle.sensing_offsets(radius, heading))


@pytest.mark.parametrize("radius", range(2, 13))
def test_expanding_kernels_follow_the_rule(radius):
    kernel = sensing.expanding_kernel(radius)
    for heading in range(4):
        assert set(kernel.offsets[heading]) == set(oracle.expanding_offsets(radius, heading))


@pytest.mark.parametrize(("radius", "cells"), [(8, 45), (5, 18)])
def test_cells_in_a_field_of_view(radius, cells):
    assert [len(offsets) for offsets in sensing.field_of_view(radius).offsets] == [cells] * 4


@pytest.mark.parametrize("name", ["sensing_5", "sensing_8", "expanding_4", "expanding_5", "expanding_8"])
def test_kernels_are_those_of_the_authors(shared, name):
    kind, radius = name.split("_")
    with np.load(shared / "golden" / "kernels.npz") as kernels:
        recorded = kernels[name]
    if kind == "sensing":
        np.testing.assert_array_equal(sensing.field_of_view(int(radius)).as_array(), recorded)
    else:
        # Recorded as offsets from the frontier cell to the robot.
        kernel = sensing.expanding_kernel(int(radius))
        np.testing.assert_array_equal(kernel.as_array()[:, ::-1, ::-1], recorded)


def test_kernels_are_equal_values():
    kernel = sensing.field_of_view(5)
    copy = sensing.field_of_view.__wrapped__(5)
    np.testing.assert_array_equal(copy.as_array(), kernel.as_array())
    assert copy == kernel
    assert hash(copy) == hash(kernel)


@pytest.mark.parametrize(
    ("make", "radius"), [(sensing.field_of_view, 0), (sensing.field_of_view, -1), (sensing.expanding_kernel, 1)]
)
def test_a_range_of_nothing_is_refused(make, radius):
    with pytest.raises(ValueError, match=rf"range {radius}: give a whole number of at least"):
        make(radius)
