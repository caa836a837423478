"""A recording of a camera holds its frames, and the map after each."""

from collections.abc import Iterable
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from dc2g_jax._src.grid.terrain import CAR, HOUSE, ROAD
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax.robot import recording as camera_recording
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics
from dc2g_jax.robot.mapping.semantic_map import UNSEEN, MapSettings, SemanticMap
from dc2g_jax.robot.recording import MappedFrame, record_camera
from tests.support.recordings import read

SETTINGS = MapSettings(rows=4, columns=5, cell_size=2.0, levels=3, level_height=0.5, reach=9.0)
CAMERA = Intrinsics(
    focal_x=jnp.float32(3),
    focal_y=jnp.float32(4),
    center_x=jnp.float32(2.5),
    center_y=jnp.float32(1.5),
    height=4,
    width=6,
)
#: The third frame is from the place of the second.
PLACES = np.array([[1, -1, 1], [3, -1, 1], [3, -1, 1], [3, -5, 1]], np.float32)
#: Level and to the east: right is south, down is down, ahead is east.
EASTWARD = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float32)


def mapped(number: int) -> MappedFrame:
    """Depth grows from frame to frame, one pixel has none; each map has one voxel more than the one before."""
    depth = np.full((4, 6), number + 1.0, np.float32)
    depth[0, 0] = 0
    log_odds, votes = np.full(SETTINGS.shape, UNSEEN, np.int8), np.zeros(SETTINGS.shape, np.uint8)
    log_odds[0, 0, : number + 1], votes[0, 0, : number + 1] = 17, ROAD << 4 | 1
    log_odds[2, 3, 4], votes[2, 3, 4] = 34, HOUSE << 4 | 2
    log_odds[1, 1, 1] = -8
    return MappedFrame(
        Frame(depth, np.full((4, 6), CAR, np.uint8), CameraPose(PLACES[number], EASTWARD)),
        picture(number),
        SemanticMap(log_odds, votes),
        np.full((4, 5), number, np.uint8),
    )


def record(file: Path, numbers: Iterable[int], path: np.ndarray = PLACES) -> None:
    record_camera(file, map(mapped, numbers), camera=CAMERA, settings=SETTINGS, path=path, name="yard")


def picture(number: int) -> bytes | None:
    return None if number == 2 else cv2.imencode(".png", np.full((4, 6, 3), number, np.uint8))[1].tobytes()


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """Sent in pieces of three steps."""
    file = tmp_path_factory.mktemp("recordings") / "new" / "camera.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(camera_recording, "_CHUNK", 3)
        record(file, range(4))
    return read(file)


def test_images_are_those_of_the_camera(logged):
    image = "/world/camera/image"
    for number in range(4):
        depth = np.asarray(logged[f"{image}/depth", "DepthImage:buffer"][number][0], np.uint8).view(np.uint16)
        expected = np.full(24, 5000 * (number + 1))
        expected[0] = 0
        np.testing.assert_array_equal(depth, expected)
        classes = np.asarray(logged[f"{image}/classes", "SegmentationImage:buffer"][number][0])
        np.testing.assert_array_equal(classes, np.full(24, CAR))
    assert logged[f"{image}/depth", "DepthImage:meter"][None] == [5000.0]
    pictures = logged[f"{image}/picture", "EncodedImage:blob"]
    assert {step: bytes(blob[0]) for step, blob in pictures.items()} == {step: picture(step) for step in (0, 1, 3)}


def test_the_lens_and_the_pose_put_the_images_into_the_world(logged):
    image = "/world/camera/image"
    (lens,) = logged[image, "Pinhole:image_from_camera"][None]
    assert np.reshape(lens, (3, 3)).T.tolist() == [[3, 0, 2.5], [0, 4, 1.5], [0, 0, 1]]
    assert logged[image, "Pinhole:resolution"][None] == [[6.0, 4.0]]
    for number, place in enumerate(PLACES):
        assert logged["/world/camera", "Transform3D:translation"][number] == [place.tolist()]
        (matrix,) = logged["/world/camera", "Transform3D:mat3x3"][number]
        np.testing.assert_array_equal(np.reshape(matrix, (3, 3)).T, EASTWARD)


def test_points_lie_at_their_depth_and_pixels_without_depth_have_none(logged):
    for number, place in enumerate(PLACES):
        cloud = np.array(logged["/world/points", "Points3D:positions"][number]) - place
        depth = number + 1
        v, u = (part.ravel()[1:] for part in np.mgrid[:4, :6])
        expected = depth * np.stack([np.ones(23), -(u - 2.5) / 3, -(v - 1.5) / 4], axis=1)
        np.testing.assert_allclose(cloud, expected, atol=1e-5)
        assert set(logged["/world/points", "Points3D:class_ids"][number]) == {CAR}


def test_boxes_are_the_occupied_voxels(logged):
    for number in range(4):
        centers = logged["/world/voxels", "Boxes3D:centers"][number]
        classes = logged["/world/voxels", "Boxes3D:class_ids"][number]
        expected = {(2.0 * column + 1, -1.0, 0.0): ROAD for column in range(number + 1)} | {(9.0, -7.0, 1.0): HOUSE}
        assert {tuple(center): index for center, index in zip(centers, classes, strict=True)} == expected
        sizes = np.array(logged["/world/voxels", "Boxes3D:half_sizes"][number])
        assert sizes.shape == (number + 2, 3)
        assert np.all((sizes > [0.9, 0.9, 0.2]) & (sizes <= [1, 1, 0.25]))


def test_the_map_and_the_way_are_seen_from_above(logged):
    for number in range(4):
        cells = logged["/map", "SegmentationImage:buffer"][number][0]
        assert list(cells) == [number] * 20
        x, y, _ = PLACES[number]
        assert logged["/map/robot", "Points2D:positions"][number] == [[x / 2, -y / 2]]
        assert logged["/map/robot/heading", "Arrows2D:vectors"][number][0] == pytest.approx([2.5, 0])
    # A piece a move, also from one batch of steps to the next.
    assert logged["/world/path", "LineStrips3D:strips"] == {1: [PLACES[:2].tolist()], 3: [PLACES[2:].tolist()]}
    assert logged["/map/robot/path", "LineStrips2D:strips"] == {
        1: [[[0.5, 0.5], [1.5, 0.5]]],
        3: [[[1.5, 0.5], [1.5, 2.5]]],
    }


def test_large_images_and_long_ways_are_thinned_out(tmp_path, monkeypatch):
    monkeypatch.setattr(camera_recording, "_POINTS", 12)
    monkeypatch.setattr(camera_recording, "_FEWEST_POINTS", 1)
    file = tmp_path / "camera.rrd"
    record(file, [1], PLACES[:2])
    # Every second row and column, and the first pixel has no depth.
    assert len(read(file)["/world/points", "Points3D:positions"][0]) == 5


def test_files_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        record(tmp_path / "file" / "x.rrd", [0])
