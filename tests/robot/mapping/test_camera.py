import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax.robot.mapping.camera import CameraPose, Frame, intrinsics, level_camera, points, rays
from dc2g_jax.robot.mapping.semantic_map import check_frame
from tests.support.frames import CAMERA, SETTINGS, camera_matrix, random_frame, turned
from tests.support.refusals import refusal


def test_field_of_view_spans_the_image_from_edge_to_edge():
    camera = intrinsics(90.0, 48, 64)
    assert camera.focal_x == camera.focal_y == 32.0
    assert (camera.center_x, camera.center_y) == (31.5, 23.5)
    assert (camera.height, camera.width) == (48, 64)
    narrow = intrinsics(60.0, 10, 100)
    np.testing.assert_allclose(np.degrees(np.arctan(50 / narrow.focal_x)), 30.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("yaw", "forward", "right"),
    [
        (0.0, (1, 0, 0), (0, -1, 0)),
        (np.pi / 2, (0, 1, 0), (1, 0, 0)),
        (np.pi, (-1, 0, 0), (0, 1, 0)),
        (-np.pi / 2, (0, -1, 0), (-1, 0, 0)),
    ],
)
def test_level_camera_looks_along_its_yaw(yaw, forward, right):
    pose = level_camera(1.0, -2.0, 0.5, yaw)
    np.testing.assert_array_equal(pose.position, np.float32([1.0, -2.0, 0.5]))
    np.testing.assert_allclose(pose.rotation, np.transpose([right, (0, 0, -1), forward]), atol=1e-6)


def test_positive_pitch_looks_down():
    pose = level_camera(0.0, 0.0, 1.0, 0.3, np.pi / 6)
    forward = np.array([np.cos(0.3) * np.cos(np.pi / 6), np.sin(0.3) * np.cos(np.pi / 6), -0.5])
    np.testing.assert_allclose(pose.rotation[:, 2], forward, atol=1e-6)
    np.testing.assert_allclose(pose.rotation[2, 0], 0.0, atol=1e-6)  # rows stay level
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(pose.rotation), 1.0, atol=1e-6)


def test_points_of_a_level_camera():
    """Principal point straight ahead, the last column to the right, the last row below."""
    camera = intrinsics(90.0, 5, 7)
    found = points(jnp.full((5, 7), 7.0), camera, level_camera(2.0, -3.0, 1.0, 0.0))
    np.testing.assert_allclose(found[2, 3], [9.0, -3.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(found[2, 6], [9.0, -9.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(found[4, 3], [9.0, -3.0, -3.0], atol=1e-5)


def test_points_project_back_to_their_pixels():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 10, (CAMERA.height, CAMERA.width)).astype(np.float32)
    for _ in range(5):
        rotation, position = turned(rng), rng.uniform(-20, 20, 3)
        pose = CameraPose(jnp.asarray(position, jnp.float32), jnp.asarray(rotation, jnp.float32))
        seen = (np.asarray(points(jnp.asarray(depth), CAMERA, pose)) - position) @ rotation @ camera_matrix(CAMERA).T
        row, column = np.mgrid[: CAMERA.height, : CAMERA.width]
        np.testing.assert_allclose(seen[..., 2], depth, rtol=1e-4)
        np.testing.assert_allclose(seen[..., 0] / seen[..., 2], column, atol=1e-3)
        np.testing.assert_allclose(seen[..., 1] / seen[..., 2], row, atol=1e-3)


def test_depth_times_ray_and_position_make_the_point():
    frame = random_frame(np.random.default_rng(1))
    depth = jnp.abs(jnp.nan_to_num(frame.depth, posinf=1.0, neginf=1.0))
    expected = depth[..., None] * rays(CAMERA, frame.pose) + frame.pose.position
    np.testing.assert_array_equal(points(depth, CAMERA, frame.pose), expected)


def test_no_return_is_the_camera_itself():
    pose = level_camera(2.0, -3.0, 1.0, 0.7, 0.2)
    np.testing.assert_array_equal(
        points(jnp.zeros((18, 28)), CAMERA, pose), np.broadcast_to(pose.position, (18, 28, 3))
    )


def test_many_cameras_are_each_their_own():
    camera = intrinsics(80.0, 6, 8)
    poses = jax.vmap(level_camera)(jnp.arange(3.0), -jnp.arange(3.0), jnp.ones(3), jnp.arange(3.0), jnp.zeros(3))
    depth = jnp.asarray(np.random.default_rng(2).uniform(1, 5, (3, 6, 8)), jnp.float32)
    together = jax.vmap(points, in_axes=(0, None, 0))(depth, camera, poses)
    for index in range(3):
        alone = points(depth[index], camera, level_camera(float(index), -float(index), 1.0, float(index)))
        np.testing.assert_allclose(together[index], alone, atol=1e-5)


def sound_frame() -> Frame:
    shape = (CAMERA.height, CAMERA.width)
    return Frame(jnp.full(shape, 2.0), jnp.full(shape, 3, jnp.uint8), level_camera(2.0, -3.0, 1.0, 0.4, 0.1))


def test_a_sound_frame_is_accepted():
    check_frame(sound_frame(), SETTINGS)


@pytest.mark.parametrize(
    ("position", "mentions"),
    [
        ((-0.1, -3.0, 1.0), ("x -0.1", "0 to 10")),
        ((10.2, -3.0, 1.0), ("x 10.2",)),
        ((2.0, 3.0, 1.0), ("y 3", "-8.5 to 0")),
        ((2.0, -8.6, 1.0), ("y -8.6",)),
        ((2.0, -3.0, 0.0), ("z 0", "ground")),
        ((2.0, np.nan, 1.0), ("y nan",)),
    ],
)
def test_poses_off_the_map_are_refused(position, mentions):
    pose = CameraPose(jnp.asarray(position, jnp.float32), level_camera(0.0, 0.0, 1.0, 0.0).rotation)
    refusal(lambda: check_frame(sound_frame().replace(pose=pose), SETTINGS), *mentions)


def test_classes_that_do_not_exist_are_refused():
    frame = sound_frame()
    wrong = frame.replace(classes=frame.classes.at[3, 4].set(16))
    refusal(lambda: check_frame(wrong, SETTINGS), "classes[3, 4]", 16, "15")
