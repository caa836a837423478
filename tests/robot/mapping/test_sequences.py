import dataclasses
import io
import math
import os
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES, HOUSE, ROAD
from dc2g_jax.robot.mapping.camera import CameraPose, Frame
from dc2g_jax.robot.mapping.sequences import (
    ImageSequence,
    Shot,
    covered,
    moved,
    read_frame,
    read_picture,
    read_sequence,
    write_sequence,
)
from tests.support.frames import CAMERA, random_frame
from tests.support.refusals import refusal

SHAPE = (CAMERA.height, CAMERA.width)
CAMERA_LINE = "19 23 14.3 8.9 28 18\n"


def frames(sequence: ImageSequence) -> Iterator[Frame]:
    return (read_frame(sequence, moment) for moment in sequence.frames)


def png(pixels: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def poses(*times: float) -> str:
    return "".join(f"{time} {time} -1 1 0 0 0 1\n" for time in times)


@pytest.fixture
def recording(tmp_path):
    """A folder written by hand: times of depth, classes and poses differ, and come in any order."""
    for kind in ("depth", "classes", "rgb"):
        (tmp_path / kind).mkdir()
    for number in range(3):
        steps = np.full(SHAPE, 1000 * number, np.uint16)
        steps[0, 0] = 65535
        (tmp_path / "depth" / f"{number}.png").write_bytes(png(steps))
        (tmp_path / "classes" / f"c {number}.png").write_bytes(png(np.full(SHAPE, number, np.uint8)))
    (tmp_path / "rgb" / "0.jpg").write_bytes(b"anything")
    (tmp_path / "depth.txt").write_text("# depth maps\n1.00 depth/0.png\n\n3.00,depth/2.png\n2.00\tdepth/1.png\n")
    (tmp_path / "classes.txt").write_text("2.01 classes/c 1.png\n0.985 classes/c 0.png\n2.9 classes/c 2.png\n")
    (tmp_path / "rgb.txt").write_text("1.01 rgb/0.jpg\n")
    (tmp_path / "groundtruth.txt").write_text(poses(0.99, 1.002, 1.98, 2.015, 3.0))
    (tmp_path / "camera.txt").write_text(f"# intrinsics\n{CAMERA_LINE}")
    return tmp_path


def test_what_is_nearest_in_time_belongs_together(recording):
    sequence = read_sequence(recording)
    assert [moment.time for moment in sequence.frames] == [1.0, 2.0]
    assert sequence.skipped == 1
    assert [float(moment.pose.position[0]) for moment in sequence.frames] == pytest.approx([1.002, 2.015])
    assert [moment.classes.name for moment in sequence.frames] == ["c 0.png", "c 1.png"]
    assert [read_picture(moment) for moment in sequence.frames] == [b"anything", None]
    assert [float(getattr(sequence.intrinsics, name)) for name in ("focal_x", "focal_y", "center_x", "center_y")] == (
        pytest.approx([19, 23, 14.3, 8.9])
    )
    assert (sequence.intrinsics.width, sequence.intrinsics.height) == (28, 18)


def test_depth_has_5000_steps_a_meter(recording):
    for number, frame in enumerate(frames(read_sequence(recording))):
        assert isinstance(frame.depth, np.ndarray)
        assert frame.depth.dtype == np.float32
        assert frame.depth[0, 0] == pytest.approx(13.107)
        assert np.all(frame.depth[1:] == np.float32(number / 5))
        assert frame.classes.dtype == np.uint8
        assert np.all(frame.classes == number)


def test_written_recordings_come_back(tmp_path):
    rng = np.random.default_rng(0)
    shots = [Shot(random_frame(rng), rng.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)) for _ in range(3)]
    sequence = read_sequence(write_sequence(tmp_path / "new" / "folder", CAMERA, iter(shots)))
    assert sequence.skipped == 0
    assert [moment.time for moment in sequence.frames] == pytest.approx([0, 0.1, 0.2])
    for name in ("focal_x", "focal_y", "center_x", "center_y", "height", "width"):
        assert getattr(sequence.intrinsics, name) == getattr(CAMERA, name)
    for (frame, picture), moment, found in zip(shots, sequence.frames, frames(sequence), strict=True):
        depth = np.asarray(frame.depth)
        writable = np.isfinite(depth) & (depth > 0) & (depth < 13.107)
        assert 0.8 < writable.mean() < 1
        assert np.abs(found.depth - depth)[writable].max() <= 0.5 / 5000 + 1e-6
        assert np.all(found.depth[~writable] == 0)
        np.testing.assert_array_equal(found.classes, frame.classes)
        np.testing.assert_allclose(found.pose.position, frame.pose.position, rtol=1e-6)
        np.testing.assert_allclose(found.pose.rotation, frame.pose.rotation, atol=2e-6)
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(read_picture(moment)))), picture)


def test_a_writer_that_stops_leaves_what_it_has_written(tmp_path):
    frame = random_frame(np.random.default_rng(1))

    def shots():
        yield Shot(frame)
        yield Shot(frame)
        raise RuntimeError("the battery is empty")

    with pytest.raises(RuntimeError):
        write_sequence(tmp_path / "out", CAMERA, shots())
    sequence = read_sequence(tmp_path / "out")
    assert len(sequence.frames) == 2
    assert read_picture(sequence.frames[0]) is None
    refusal(lambda: write_sequence(tmp_path / "out", CAMERA, []), tmp_path / "out", "not an empty folder")


def test_images_of_another_camera_are_not_written(tmp_path):
    frame = random_frame(np.random.default_rng(1))
    other = dataclasses.replace(frame, classes=frame.classes[1:])
    refusal(lambda: write_sequence(tmp_path / "out", CAMERA, [Shot(frame), Shot(other)]), "classes has shape")
    assert len(read_sequence(tmp_path / "out").frames) == 1


def test_colors_are_classes_by_the_palette(recording):
    rows = [f"{name},{','.join(map(str, color))}" for name, color in zip(CLASS_NAMES, CLASS_COLORS, strict=True)]
    (recording / "labels_colors.csv").write_text("\n".join(["class,r,g,b", *rows]))
    classes = np.where(np.arange(CAMERA.width) < 9, HOUSE, ROAD) * np.ones(SHAPE, int)
    for number in range(2):
        (recording / "classes" / f"c {number}.png").write_bytes(png(CLASS_COLORS[classes]))
    for frame in frames(read_sequence(recording)):
        np.testing.assert_array_equal(frame.classes, classes)
    (recording / "classes" / "c 0.png").write_bytes(png(np.full((*SHAPE, 3), 7, np.uint8)))
    refusal(lambda: next(frames(read_sequence(recording))), "c 0.png", "(7, 7, 7)")


@pytest.mark.parametrize(
    ("file", "text", "mentions"),
    [
        ("groundtruth.txt", poses(1.0) + "2 1 2 3 0 0 0\n", ("line 2", "7 values, not 8", "qw")),
        ("groundtruth.txt", "# time\n" + poses(1.0) + "2 1 2 3 0 0 0 0\n", ("line 3", "quaternion", "length 0")),
        ("groundtruth.txt", "1 1 2 x 0 0 0 1\n", ("line 1", "'x'")),
        ("groundtruth.txt", "1 1 2 1e308 0 0 0 1\n", ("line 1 has 1e+308", "give meters")),
        ("groundtruth.txt", "1 1 2 3 0 0 0 -1e200\n", ("line 1 has -1e+200",)),
        ("groundtruth.txt", "1 1 2 nan 0 0 0 1\n", ("line 1", "nan")),
        ("groundtruth.txt", poses(7.0), ("none of its 3 depth images", "0.02 s")),
        ("groundtruth.txt", "", ("none of its 3 depth images",)),
        ("depth.txt", "1.0\n", ("line 1", "1 values, not 2")),
        ("classes.txt", "soon classes/0.png\n", ("line 1", "'soon'")),
        ("camera.txt", "", ("has 0 lines", "focal_x")),
        ("camera.txt", "19 23 14 9 28.5 18\n", ("width 28.5", "whole")),
        ("camera.txt", "0 23 14 9 28 18\n", ("focal_x 0", "above 0")),
        ("camera.txt", "19 23 14 9 1e300 18\n", ("width", "pixels")),
        ("camera.txt", "1e308 23 14 9 28 18\n", ("focal_x 1e+308", "at most")),
        ("camera.txt", "19 23 14 9 28 " + "9" * 5000, ("line 1 inf", "give a number")),
        ("camera.txt", b"\xff\xfe", ("byte 0xff at offset 0", "UTF-8")),
    ],
)
def test_lists_that_say_nothing_are_refused(recording, file, text, mentions):
    (recording / file).write_bytes(text if isinstance(text, bytes) else text.encode())
    where = () if mentions[0].startswith("none of") else (recording / file,)
    refusal(lambda: read_sequence(recording), *where, *mentions)


def test_a_path_that_no_map_covers_is_refused(recording):
    (recording / "groundtruth.txt").write_text("1 0 0 1 0 0 0 1\n2 1e6 -1e6 1 0 0 0 1\n")
    refusal(lambda: covered(read_sequence(recording), 0.5, 3.0), "a map of 20000", "cells of 0.5 m", "groundtruth.txt")


def test_lists_may_name_what_is_no_file(recording):
    os.mkfifo(recording / "pipe.png")
    for name, mention in (("pipe.png", "a device or a pipe"), ("nu\0l.png", "not the name of a file"), (".", "folder")):
        (recording / "depth.txt").write_text(f"1.0 {name}\n")
        refusal(lambda: next(frames(read_sequence(recording))), recording, mention)


@pytest.mark.parametrize("file", ["depth.txt", "classes.txt", "groundtruth.txt", "camera.txt"])
def test_lists_that_are_missing_are_named(recording, file):
    (recording / file).unlink()
    refusal(lambda: read_sequence(recording), recording / file, "no such file", "write it")
    refusal(lambda: read_sequence(recording / "nowhere"), recording / "nowhere", "no such folder")


@pytest.mark.parametrize(
    ("file", "data", "mentions"),
    [
        ("depth/0.png", png(np.zeros(SHAPE, np.uint8)), ("8-bit grayscale", "16-bit grayscale")),
        ("depth/0.png", png(np.zeros((*SHAPE, 3), np.uint8)), ("8-bit RGB", "16-bit grayscale")),
        (
            "classes/c 0.png",
            png(np.zeros(SHAPE, np.uint16)),
            ("16-bit grayscale", "8-bit grayscale", "labels_colors.csv"),
        ),
        ("depth/0.png", png(np.zeros((18, 27), np.uint16)), ("27 x 18", "28 x 18", "camera.txt")),
        ("classes/c 0.png", png(np.zeros((17, 28), np.uint8)), ("28 x 17", "28 x 18")),
        ("depth/0.png", png(np.arange(504, dtype=np.uint16).reshape(SHAPE))[:-60], ("truncated PNG",)),
        ("depth/0.png", b"", ("not an intact PNG",)),
        ("depth/0.png", None, ("no such file",)),
    ],
)
def test_images_of_no_use_are_refused_when_they_are_read(recording, file, data, mentions):
    (recording / file).unlink()
    if data is not None:
        (recording / file).write_bytes(data)
    sequence = read_sequence(recording)
    refusal(lambda: next(frames(sequence)), recording / file, *mentions)
    assert np.all(read_frame(sequence, sequence.frames[1]).classes == 1)


def test_the_map_covers_all_within_reach_of_the_way(tmp_path):
    rng = np.random.default_rng(2)
    for cell_size, reach in ((0.5, 3.1), (1.0, 4.0)):
        frame = random_frame(rng)
        places = rng.uniform([-30, 5, 0.5], [-10, 40, 2], (6, 3)).astype(np.float32)
        shots = [Shot(frame.replace(pose=CameraPose(jnp.asarray(place), frame.pose.rotation))) for place in places]
        sequence = read_sequence(write_sequence(tmp_path / str(reach), CAMERA, shots))
        on_map, settings = covered(sequence, cell_size, reach)
        now = np.stack([moment.pose.position for moment in on_map.frames])
        cells = (now - places)[:, :2] / cell_size
        np.testing.assert_allclose(cells, np.broadcast_to(np.rint(cells[0]), cells.shape), atol=1e-4)
        np.testing.assert_array_equal(now[:, 2], places[:, 2])
        room = [now[:, 0].min(), settings.columns * cell_size - now[:, 0].max()]
        room += [-now[:, 1].max(), settings.rows * cell_size + now[:, 1].min()]
        assert all(reach - 1e-4 <= side <= reach + cell_size + 1e-4 for side in room)
        np.testing.assert_allclose(
            moved(sequence, np.array([1.0, 2.0, 3.0])).frames[0].pose.position, places[0] + (1, 2, 3), rtol=1e-5
        )


def test_poses_turn_by_an_angle_about_an_axis(recording):
    """Quaternions of any length, x, y, z, w."""
    rng = np.random.default_rng(3)
    axes = [*rng.normal(size=(20, 3)), *np.eye(3), *np.eye(3)]
    angles = [*rng.uniform(-3, 3, 20), *[np.pi] * 3, *[0.0] * 3]
    for axis, angle in zip(axes, angles, strict=True):
        x, y, z = unit = axis / np.linalg.norm(axis)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross  # Rodrigues
        quaternion = -2.5 * np.array([*math.sin(angle / 2) * unit, math.cos(angle / 2)])
        (recording / "groundtruth.txt").write_text(f"1 0 0 1 {' '.join(map(str, quaternion))}\n")
        np.testing.assert_allclose(read_sequence(recording).frames[0].pose.rotation, turn, atol=1e-6)
    for wrong in ("0 0 0 0", "1e-9 0 0 0", "1e200 1e200 1e200 0"):
        (recording / "groundtruth.txt").write_text(f"1 0 0 1 {wrong}\n")
        refusal(lambda: read_sequence(recording), "groundtruth.txt", "line 1")


def test_frames_of_a_recording_are_those_of_its_camera(recording):
    frame = next(frames(read_sequence(recording)))
    assert isinstance(frame, Frame)
    assert frame.depth.shape == frame.classes.shape == SHAPE
    np.testing.assert_array_equal(frame.pose.rotation, np.eye(3))
