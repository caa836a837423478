import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import field_of_view
from dc2g_jax._src.grid.terrain import CLASS_NAMES, GRASS, HOUSE, ROAD
from dc2g_jax.robot.mapping import simulator
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, intrinsics, level_camera, points, rays
from dc2g_jax.robot.mapping.scene import TILES, Scene, scene_from_heights, scene_from_terrain
from dc2g_jax.robot.mapping.simulator import CAMERA_RANGE, FIELD_OF_VIEW, picture, render, robot_camera
from tests.oracles.raycast_oracle import Met, nearest_boxes
from tests.support.maps import random_terrain

SMALL = intrinsics(90, 24, 32)
IMAGE_SIZE = (120, 160)
USUAL = intrinsics(FIELD_OF_VIEW, *IMAGE_SIZE)
TILE = 0.5

render = jax.jit(render)


def random_scene(seed: int, share: float) -> tuple[Scene, np.ndarray]:
    """A field of 24 x 30 tiles, this share of them obstacles up to 2.5 m high, and its heights."""
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((24, 30)) < share, rng.uniform(0.1, 2.5, (24, 30)), 0).astype(np.float32)
    classes = rng.integers(0, len(CLASS_NAMES), heights.shape).astype(np.uint8)
    return scene_from_heights(heights.astype(np.float64), classes, TILE), heights


def free_pose(seed: int, heights: np.ndarray, tile_size: float) -> CameraPose:
    """A camera turned any way, in the air above a tile."""
    rng = np.random.default_rng([seed, 1])
    row, column = rng.integers(heights.shape)
    offset = rng.uniform(0.1, 0.9, 2)
    height = heights[row, column] + rng.uniform(0.1, 2.0)
    x, y = (column + offset[0]) * tile_size, -(row + offset[1]) * tile_size
    pose = level_camera(x, y, height, rng.uniform(0, 6.3), rng.normal(0.3, 0.4))
    tilt = Rotation.from_rotvec((0, 0, rng.normal(0, 0.5))).as_matrix()
    return dataclasses.replace(pose, rotation=jnp.asarray(np.asarray(pose.rotation) @ tilt, jnp.float32))


def assert_agrees(scene: Scene, pose: CameraPose, max_range: float) -> int:
    """Check depths and classes against boxes; the number of rays that differ, all of them along edges."""
    heights, tile_size = np.maximum(np.asarray(scene.field, float), 0), float(scene.tile_size)
    frame = render(scene, SMALL, pose, max_range)
    depth, classes = np.asarray(frame.depth).ravel(), np.asarray(frame.classes).ravel()
    directions = np.asarray(rays(SMALL, pose), float).reshape(-1, 3)

    def cast(directions: np.ndarray) -> tuple[Met, np.ndarray]:
        met = nearest_boxes(heights, tile_size, np.asarray(pose.position), directions, max_range)
        return met, np.where(met.time > 0, np.asarray(scene.classes)[met.row, met.column], 0)

    def agrees(met: Met, true: np.ndarray, of: np.ndarray) -> np.ndarray:
        return np.isclose(depth[of], met.time, rtol=1e-5, atol=1e-4) & (classes[of] == true)

    differing = np.flatnonzero(~agrees(*cast(directions), np.arange(len(depth))))
    explained = np.zeros(len(differing), bool)
    for nudge in np.random.default_rng(0).normal(0, 2e-5, (30, 3)) if len(differing) else ():
        # A ray that meets an edge: next to it lies what the simulator says.
        explained |= agrees(*cast(directions[differing] + nudge), differing)
    assert explained.all(), differing[~explained]
    return len(differing)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.4, 1.0])
def test_random_fields_look_as_their_boxes_do(share):
    differing = 0
    for seed in range(6):
        scene, heights = random_scene(seed, share)
        for max_range in (4.0, 100.0):
            differing += assert_agrees(scene, free_pose(seed, heights, TILE), max_range)
    assert differing <= 12 * SMALL.height * SMALL.width // 1000


@pytest.mark.parametrize("seed", range(3))
def test_random_maps_look_as_their_boxes_do(seed):
    scene = scene_from_terrain(random_terrain(seed, (5, 6), 0.6, doors=3))
    heights = np.maximum(np.asarray(scene.field), 0)
    assert assert_agrees(scene, free_pose(seed, heights, 0.2), 100.0) <= SMALL.height * SMALL.width // 1000


@pytest.mark.parametrize("yaw", np.arange(8) * np.pi / 4)
def test_cameras_along_rows_columns_and_diagonals(yaw):
    scene, heights = random_scene(3, 0.3)
    row, column = np.argwhere(heights[8:16, 8:16] == 0)[0] + 8
    for corner in (0.0, 0.5):
        position = jnp.array([(column + corner) * TILE, -(row + corner) * TILE, 2.6])
        assert assert_agrees(scene, level_camera(*position, yaw, 0.3), 50.0) <= SMALL.height * SMALL.width // 100


def test_faces_are_those_of_the_boxes():
    scene, heights = random_scene(5, 0.3)
    pose = free_pose(5, heights, TILE)
    directions = rays(SMALL, pose)
    hits = simulator.cast_all(scene, pose, directions, 100.0)
    met = nearest_boxes(heights, TILE, np.asarray(pose.position), np.asarray(directions, float).reshape(-1, 3), 100.0)
    face = np.where(met.time > 0, met.face, 0)
    differing = np.where(np.asarray(hits.distance).ravel() > 0, np.asarray(hits.face).ravel(), 0) != face
    assert set(face) == {0, 1, 2}
    assert differing.mean() < 0.005


@pytest.mark.parametrize("max_range", [2.0, 6.0])
def test_depths_are_positive_and_end_with_the_range(max_range):
    for seed in range(4):
        scene, heights = random_scene(seed, 0.1)
        pose = free_pose(seed, heights, TILE)
        depth = np.asarray(render(scene, SMALL, pose, max_range).depth)
        far = np.asarray(render(scene, SMALL, pose, 1e3).depth)
        distance = depth * np.linalg.norm(rays(SMALL, pose), axis=-1)
        assert depth.min() >= 0
        assert 0 < distance.max() <= max_range * (1 + 1e-5)
        # What is within the range is what is seen without it.
        np.testing.assert_array_equal(depth[depth > 0], far[depth > 0])
        beyond = (far * np.linalg.norm(rays(SMALL, pose), axis=-1))[depth == 0]
        assert np.all((beyond == 0) | (beyond >= max_range * (1 - 1e-5)))


def test_nothing_taller_stands_before_what_is_seen():
    scene = scene_from_terrain(random_terrain(11, (9, 9), 0.7, doors=2))
    heights = np.maximum(np.asarray(scene.field), 0)
    seen = 0
    for x, y in np.argwhere(heights[TILES // 2 :: TILES, TILES // 2 :: TILES].T == 0)[::6]:
        pose = robot_camera(make_pose(x, y, (x + y) % 4))
        frame = render(scene, SMALL, pose)
        depth, directions = np.asarray(frame.depth, float), np.asarray(rays(SMALL, pose), float)
        share = np.linspace(0, 1, 400, endpoint=False)[:, None, None]
        way = np.asarray(pose.position) + (share * depth)[..., None] * directions
        row, column = (np.clip((sign * way[..., axis] / 0.2).astype(int), 0, 44) for sign, axis in ((-1, 1), (1, 0)))
        assert np.all(way[..., 2] >= heights[row, column] - 1e-3)
        seen += np.count_nonzero(depth)
    assert seen > 1000


def test_flat_ground_lies_where_its_ray_ends():
    classes = np.random.default_rng(0).integers(1, 16, (40, 40)).astype(np.uint8)
    scene = scene_from_heights(np.zeros((40, 40)), classes, TILE)
    pose = level_camera(10.2, -9.9, 1.3, 0.4, 0.5)
    frame = render(scene, SMALL, pose, 100.0)
    directions = np.asarray(rays(SMALL, pose), float)
    with np.errstate(divide="ignore"):
        depth = np.where(directions[..., 2] < 0, -1.3 / directions[..., 2], 0)
    point = np.asarray(pose.position) + depth[..., None] * directions
    inside = (depth > 0) & (np.abs(point[..., 0] - 10) < 10) & (np.abs(point[..., 1] + 10) < 10)
    np.testing.assert_allclose(frame.depth, np.where(inside, depth, 0), rtol=1e-5)
    row, column = (np.where(inside, sign * point[..., axis] / TILE, 0).astype(int) for sign, axis in ((-1, 1), (1, 0)))
    assert np.mean(np.asarray(frame.classes) != np.where(inside, classes[row, column], 0)) < 0.005
    assert 0 < inside.mean() < 1


def test_a_house_hides_what_is_behind_it():
    terrain = np.full((11, 11), GRASS, np.uint8)
    terrain[0:4] = ROAD
    pose = robot_camera(make_pose(5, 9, 3))
    assert np.any(np.asarray(render(scene_from_terrain(terrain), SMALL, pose, 100.0).classes) == ROAD)
    terrain[5] = HOUSE
    classes = np.asarray(render(scene_from_terrain(terrain), SMALL, pose, 100.0).classes)
    assert not np.any(classes == ROAD)
    assert np.any(classes == HOUSE)


@pytest.mark.parametrize(
    ("x", "y", "z"), [(2.6, -2.6, 0.4), (1.0, -1.0, -0.1), (-0.1, -2, 1), (2, 0.1, 1), (5.1, -2, 1), (2, -5.1, 1)]
)
def test_a_camera_in_a_wall_below_the_ground_or_off_the_map_sees_nothing(x, y, z):
    heights = np.zeros((10, 10))
    heights[5, 5] = 1.0
    scene = scene_from_heights(heights, np.full((10, 10), GRASS, np.uint8), TILE)
    for yaw in range(4):
        frame = render(scene, SMALL, level_camera(x, y, z, yaw, 0.3), 100.0)
        assert not np.any(frame.depth)
        assert not np.any(frame.classes)


def test_a_camera_that_is_nowhere_sees_nothing():
    scene, _ = random_scene(0, 0.1)
    frame = render(scene, SMALL, level_camera(jnp.nan, -2.0, 1.0, 0.0, 0.3), 100.0)
    assert not np.any(frame.depth)


def test_unknown_ground_has_a_depth_but_no_label():
    scene = scene_from_terrain(np.zeros((9, 9), np.uint8))
    frame = render(scene, SMALL, robot_camera(make_pose(4, 8, 3)))
    assert np.mean(np.asarray(frame.depth) > 0) > 0.3
    assert not np.any(frame.classes)


@pytest.mark.parametrize("heading", range(4))
def test_a_robot_sees_the_cell_ahead_of_it(heading):
    dx, dy = ((1, 0), (0, 1), (-1, 0), (0, -1))[heading]
    terrain = np.full((9, 9), GRASS, np.uint8)
    terrain[4 + dy, 3 + dx] = ROAD
    frame = render(scene_from_terrain(terrain), USUAL, robot_camera(make_pose(3, 4, heading)))
    rows, columns = np.nonzero(np.asarray(frame.classes) == ROAD)
    # It lies right below the middle of the picture.
    assert rows.max() == USUAL.height - 1
    assert rows.min() > USUAL.height / 2
    assert columns.mean() == pytest.approx((USUAL.width - 1) / 2, abs=0.5)


def test_the_usual_camera_sees_every_cell_in_view_up_to_8_cells_away():
    frame = render(scene_from_terrain(np.full((21, 21), GRASS, np.uint8)), USUAL, robot_camera(make_pose(10, 10, 0)))
    point = np.asarray(points(frame.depth, USUAL, frame.pose))[np.asarray(frame.depth) > 0]
    cells = set(zip(*np.floor(point[:, :2] * (1, -1)).astype(int).T.tolist(), strict=True))
    wanted = {(10 + dx, 10 + dy) for dx, dy in field_of_view(8).offsets[0]}
    assert wanted - cells == {(10, 10)}
    assert max(np.hypot(x - 10, y - 10) for x, y in cells) < CAMERA_RANGE + 0.75


def test_everything_that_is_seen_lies_within_its_own_cell():
    """So that a map made of what is seen can equal the map that the scene was made of."""
    terrain = random_terrain(5, (12, 12), 0.8, doors=4)
    scene, wrong, pixels = scene_from_terrain(terrain), 0, 0
    free = np.argwhere(np.asarray(scene.field)[TILES // 2 :: TILES, TILES // 2 :: TILES] <= 0)
    for row, column in free[::9]:
        for heading in range(4):
            frame = render(scene, SMALL, robot_camera(make_pose(column, row, heading)))
            point, seen = np.asarray(points(frame.depth, SMALL, frame.pose)), np.asarray(frame.depth) > 0
            cell = np.floor(point[seen][:, :2] * (1, -1)).astype(int)
            differs = terrain[np.clip(cell[:, 1], 0, 11), np.clip(cell[:, 0], 0, 11)] != np.asarray(frame.classes)[seen]
            # Walls stand inside their cells; only on flat ground may rounding carry a point over a border.
            assert np.all(np.abs(point[seen][differs, 2]) < 1e-3)
            wrong, pixels = wrong + differs.sum(), pixels + seen.sum()
    assert wrong <= pixels // 2000


def test_many_robots_see_what_each_sees_alone(street):
    scene = scene_from_terrain(street)
    poses = [robot_camera(make_pose(x, y, heading)) for x, y, heading in ((0, 4, 0), (9, 5, 2), (2, 6, 3), (7, 2, 1))]
    many = jax.vmap(lambda pose: simulator.render(scene, SMALL, pose))(jax.tree.map(lambda *p: jnp.stack(p), *poses))
    for index, pose in enumerate(poses):
        one: Frame = render(scene, SMALL, pose)
        np.testing.assert_allclose(many.depth[index], one.depth, rtol=1e-6)
        np.testing.assert_array_equal(many.classes[index], one.classes)
        np.testing.assert_array_equal(many.pose.position[index], pose.position)


def test_robots_in_scenes_of_their_own(street):
    terrains = [street, street[::-1].copy(), street[:, ::-1].copy()]
    scenes = [scene_from_terrain(terrain) for terrain in terrains]
    pose = robot_camera(make_pose(4, 4, 1))
    many = jax.vmap(lambda scene: simulator.render(scene, SMALL, pose))(jax.tree.map(lambda *s: jnp.stack(s), *scenes))
    for index, scene in enumerate(scenes):
        np.testing.assert_array_equal(many.classes[index], render(scene, SMALL, pose).classes)


def test_a_door_is_seen_from_the_street_as_one(street):
    """The mat alone would be three pixels high."""
    frame = render(scene_from_terrain(street), USUAL, robot_camera(make_pose(2, 6, 3)))
    door = np.asarray(frame.classes) == CLASS_NAMES.index("front_door")
    rows, _ = np.nonzero(door)
    assert np.ptp(rows) > 20


def test_a_picture_shows_sky_walls_and_roof():
    terrain = np.full((16, 16), GRASS, np.uint8)
    terrain[2:7, 3:13] = HOUSE
    view = np.asarray(picture(scene_from_terrain(terrain), USUAL, robot_camera(make_pose(8, 15, 3)))).astype(int)
    assert view.shape == (*IMAGE_SIZE, 3)
    red, green, blue = view[:, IMAGE_SIZE[1] // 2].T
    is_sky, is_grass, is_roof, is_wall = blue > red, green > np.maximum(red, blue), red > 1.3 * green, red > blue
    order = [np.flatnonzero(part) for part in (is_sky, is_roof, is_wall & ~is_roof & ~is_grass, is_grass)]
    assert all(len(part) for part in order)
    # From top to bottom, each after the other.
    assert all(above.max() < below.min() for above, below in itertools.pairwise(order))
