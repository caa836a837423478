"""Recordings of depth images with classes and poses, in the folder format of the TUM RGB-D benchmark.

From the benchmark (Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012):

- `depth.txt` and `rgb.txt` have one line per image: its time in seconds, and its file relative to the folder. `#`
  begins a comment. Color images are optional here; they are only displayed.
- A depth image is a 16-bit grayscale PNG with 5000 units per meter along the optical axis, 0 for pixels without
  return. The largest depth is 13.107 m. Depth and color images are pixel-aligned.
- `groundtruth.txt` has one line per pose: time, tx ty tz in meters, qx qy qz qw. A pose maps points in the camera frame
  (x right, y down, z forward) to the world.
- Each list has its own times. Entries are matched to the nearest in time, at most 0.02 s apart.

Additions:

- `classes.txt` lists class images as `depth.txt` lists depth images, pixel-aligned with them. A class image is an 8-bit
  grayscale PNG with the class indices of `grid.CLASS_NAMES`, 0 without label. If the folder has a palette,
  `labels_colors.csv`, class images are color images in its colors instead.
- `camera.txt` has one line with the intrinsics: focal_x focal_y center_x center_y width height. Images have no
  distortion.
- The world has z up and its ground at z = 0, as in `mapping.camera`; `moved` shifts another world there.
"""

import bisect
import dataclasses
import math
import operator
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8, UInt16
from scipy.spatial.transform import Rotation

from dc2g_jax.files import (
    MOST_PIXELS,
    PALETTE_FILE,
    TEXT,
    Palette,
    finite_number,
    read_bytes,
    read_class_image,
    read_palette,
    read_png,
    read_text,
    write_png,
)
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics, check_shapes
from dc2g_jax.robot.mapping.semantic_map import MapSettings
from dc2g_jax.runtime import InputError, check_number

#: Units of a depth image per meter.
DEPTH_UNITS = 5000.0

#: Largest time difference between images and poses of one moment, seconds, as in the benchmark's own tools.
_TOLERANCE = 0.02

#: Files of a folder.
DEPTH_LIST, CLASS_LIST, PICTURE_LIST = "depth.txt", "classes.txt", "rgb.txt"
POSE_LIST, CAMERA_FILE = "groundtruth.txt", "camera.txt"

#: Largest coordinate of a camera, meters: single precision holds it to one meter.
_FARTHEST = 1e7

#: A shorter quaternion is rejected as zero.
_SHORTEST = 1e-6

#: Most cells of a map that covers a recording.
MOST_CELLS = 2**24

_LIST_FIELDS = ("time", "file")
_POSE_FIELDS = ("time", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_CAMERA_FIELDS = ("focal_x", "focal_y", "center_x", "center_y", "width", "height")

#: The time of a line that has been read.
_TIME = operator.itemgetter(0)


class _FrameFiles(NamedTuple):
    """The files of a depth image, and of the class image, color image and pose nearest to its time, in seconds."""

    time: float
    depth: Path
    classes: Path
    picture: Path | None
    pose: CameraPose


@dataclasses.dataclass(frozen=True)
class ImageSequence:
    """A recording whose images have not been read yet.

    Attributes:
      intrinsics: intrinsics of the camera.
      frames: the files and pose of each frame, in temporal order.
      skipped: number of depth images without a class image or pose near them in time.
      palette: palette of the class images; `None` where they hold class indices.
    """

    intrinsics: Intrinsics
    frames: tuple[_FrameFiles, ...]
    skipped: int
    palette: Palette | None


class Shot(NamedTuple):
    """A frame to write, with an optional color image."""

    frame: Frame
    picture: UInt8[np.ndarray, "h w 3"] | None = None


def read_sequence(folder: str | Path) -> ImageSequence:
    """Read the lists of a recording and match their entries by time.

    Raises:
      InputError: a list or `camera.txt` is missing or invalid, or no depth image has both a class image and a pose near
        it in time.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a recording that has {DEPTH_LIST} in it")
    intrinsics = _read_camera(folder / CAMERA_FILE)
    depth, classes = (_read_list(folder / name) for name in (DEPTH_LIST, CLASS_LIST))
    pictures = _read_list(folder / PICTURE_LIST) if (folder / PICTURE_LIST).exists() else []
    poses = _read_poses(folder / POSE_LIST)
    frames = []
    for time, file in depth:
        class_file, picture, pose = (_nearest(listed, time) for listed in (classes, pictures, poses))
        if class_file is not None and pose is not None:
            frames.append(_FrameFiles(time, file, class_file, picture, pose))
    if not frames:
        raise InputError(
            f"{folder}: none of its {len(depth)} depth images has a class image and a pose within {_TOLERANCE:g} "
            f"s; compare the times in {DEPTH_LIST}, {CLASS_LIST} and {POSE_LIST}"
        )
    palette = read_palette(folder / PALETTE_FILE) if (folder / PALETTE_FILE).exists() else None
    return ImageSequence(intrinsics, tuple(frames), len(depth) - len(frames), palette)


def read_frame(sequence: ImageSequence, files: _FrameFiles) -> Frame:
    """Read the depth and class images of a frame; NumPy arrays on the host.

    Raises:
      InputError: an image is missing or damaged, or has the wrong size or kind.
    """
    size = sequence.intrinsics.width, sequence.intrinsics.height
    of_depth = f"depth in 5000 steps a meter of {CAMERA_FILE}'s size"
    steps = np.array(read_png(files.depth, ("16-bit grayscale",), of_depth, size=size))
    if sequence.palette is None:
        indices = f"class indices of {CAMERA_FILE}'s size, or lay a palette {PALETTE_FILE} beside them"
        classes: Any = np.array(read_png(files.classes, ("8-bit grayscale",), indices, size=size))
    else:
        classes = read_class_image(files.classes, sequence.palette, size=size)
    depth: Any = steps.astype(np.float32) / np.float32(DEPTH_UNITS)
    return Frame(depth=depth, classes=classes, pose=files.pose)


def read_picture(files: _FrameFiles) -> bytes | None:
    """The encoded bytes of a frame's color image; `None` if it has none.

    Raises:
      InputError: the file cannot be read.
    """
    if files.picture is None:
        return None
    return read_bytes(files.picture, "put the image there, or repair the list", at_most=TEXT)


def moved(sequence: ImageSequence, offset: Float[np.ndarray, "3"]) -> ImageSequence:
    """The recording in a world with another origin.

    Args:
      sequence: the recording.
      offset: offset to add to the camera's positions, x, y and z in meters.
    """
    shift = offset.astype(np.float32)
    frames = tuple(
        files._replace(pose=dataclasses.replace(files.pose, position=files.pose.position + shift))
        for files in sequence.frames
    )
    return dataclasses.replace(sequence, frames=frames)


def covered(sequence: ImageSequence, cell_size: float, reach: float) -> tuple[ImageSequence, MapSettings]:
    """A map that covers everything within reach of the camera's path, and the recording in the frame of that map.

    Args:
      sequence: a recording anywhere in the plane; its ground must be at z = 0.
      cell_size: side of a cell, meters.
      reach: reach of the camera, meters.

    Returns:
      The recording, moved by whole cells, and the settings.

    Raises:
      InputError: the map would have more than 16,777,216 cells.
    """
    ways = np.stack([files.pose.position[:2] for files in sequence.frames]).astype(np.float64)
    low = np.floor((ways.min(axis=0) - reach) / cell_size)
    high = np.ceil((ways.max(axis=0) + reach) / cell_size)
    columns, rows = (high - low).astype(int).tolist()
    if rows * columns > MOST_CELLS:
        size = f"{columns} x {rows} cells of {cell_size:g} m"
        raise InputError(f"the path needs a map of {size}, over {MOST_CELLS}; give larger cells, or repair {POSE_LIST}")
    offset = cell_size * np.array([-low[0], -high[1], 0.0])
    return moved(sequence, offset), MapSettings(rows=rows, columns=columns, cell_size=cell_size, reach=reach)


def write_sequence(folder: str | Path, intrinsics: Intrinsics, shots: Iterable[Shot]) -> Path:
    """Write a recording of ten shots a second that `read_sequence` reads. Depth is stored to within 0.1 mm.

    Shots are consumed one by one. If writing is interrupted, the recording so far stays readable.

    Args:
      folder: folder to write to; new or empty.
      intrinsics: intrinsics of the camera.
      shots: shots in temporal order. Depth that 16 bits cannot hold (13.107 m and more, or not finite) becomes 0.

    Returns:
      The folder.

    Raises:
      InputError: the folder is not empty or cannot be made, or a shot's images do not have the camera's size.
    """
    folder = Path(folder)
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: is not an empty folder; give a new one")
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); give a folder of yours") from None
    numbers = [getattr(intrinsics, name) for name in _CAMERA_FIELDS]
    (folder / CAMERA_FILE).write_text(f"# {' '.join(_CAMERA_FIELDS)}\n{' '.join(f'{n:.9g}' for n in numbers)}\n")
    for number, shot in enumerate(shots):
        check_shapes(shot.frame, intrinsics)
        for name, line in _write_shot(folder, f"{number / 10:.6f}", shot).items():
            header = f"# {' '.join(_POSE_FIELDS if name == POSE_LIST else _LIST_FIELDS)}\n"
            with (folder / name).open("a") as file:
                file.write(f"{line}\n" if file.tell() else f"{header}{line}\n")
    return folder


def depth_steps(depth: Float[np.ndarray, "h w"]) -> UInt16[np.ndarray, "h w"]:
    """Depth in meters as units of a depth image; 0 for pixels without return and for depths it cannot represent."""
    steps = np.rint(depth.astype(np.float64) * DEPTH_UNITS)
    return np.where((steps > 0) & (steps <= np.iinfo(np.uint16).max), steps, 0).astype(np.uint16)


def _write_shot(folder: Path, time: str, shot: Shot) -> dict[str, str]:
    """Write the images of a shot. Returns its line in each list."""
    images = {DEPTH_LIST: depth_steps(np.asarray(shot.frame.depth)), CLASS_LIST: np.asarray(shot.frame.classes)}
    if shot.picture is not None:
        images[PICTURE_LIST] = np.asarray(shot.picture)
    lines = {}
    for name, image in images.items():
        kind = name.removesuffix(".txt")
        (folder / kind).mkdir(exist_ok=True)
        write_png(folder / kind / f"{time}.png", image)
        lines[name] = f"{time} {kind}/{time}.png"
    turn = Rotation.from_matrix(np.asarray(shot.frame.pose.rotation)).as_quat(canonical=True)
    numbers = [*np.asarray(shot.frame.pose.position).tolist(), *turn.tolist()]
    lines[POSE_LIST] = f"{time} {' '.join(f'{number:.9g}' for number in numbers)}"
    return lines


def _nearest(listed: list[tuple[float, Any]], time: float) -> Any:
    """What a list in temporal order has nearest to a time; `None` if that is too far away."""
    after = bisect.bisect_left(listed, time, key=_TIME)
    near = listed[max(after - 1, 0) : after + 1]
    when, thing = min(near, key=lambda entry: abs(entry[0] - time), default=(math.inf, None))
    # Times are decimal fractions, and their differences are not exact.
    return thing if abs(when - time) <= _TOLERANCE + 1e-9 else None


def _read_list(path: Path) -> list[tuple[float, Path]]:
    files = ((_numbers(path, line, [time])[0], path.parent / file) for line, (time, file) in _lines(path))
    return sorted(files, key=_TIME)


def _read_poses(path: Path) -> list[tuple[float, CameraPose]]:
    poses = []
    for line, words in _lines(path, _POSE_FIELDS):
        time, *numbers = _numbers(path, line, words)
        if max(map(abs, numbers)) > _FARTHEST:
            raise InputError(f"{path}: line {line} has {max(numbers, key=abs):g}; give meters, at most {_FARTHEST:g}")
        if not _SHORTEST < (length := float(np.linalg.norm(numbers[3:]))) < np.inf:
            raise InputError(f"{path}: line {line} has a quaternion of length {length:g}; give one of length 1")
        position: Any = np.array(numbers[:3], np.float32)
        turn: Any = Rotation.from_quat(numbers[3:]).as_matrix().astype(np.float32)
        poses.append((time, CameraPose(position=position, rotation=turn)))
    return sorted(poses, key=_TIME)


def _read_camera(path: Path) -> Intrinsics:
    lines = list(_lines(path, _CAMERA_FIELDS))
    if len(lines) != 1:
        raise InputError(f"{path}: has {len(lines)} lines; give one: {' '.join(_CAMERA_FIELDS)}")
    values = dict(zip(_CAMERA_FIELDS, _numbers(path, *lines[0]), strict=True))
    for name, value in values.items():
        if name in ("width", "height"):
            number = int(value) if value.is_integer() else value
            check_number(f"{path}: {name}", number, whole=True, least=1, most=MOST_PIXELS, hint="pixels")
        else:
            above = -MOST_PIXELS if name.startswith("center") else 0
            check_number(f"{path}: {name}", value, above=above, most=MOST_PIXELS, hint="pixels")
    lenses: dict[str, Any] = {name: jnp.float32(values[name]) for name in _CAMERA_FIELDS[:4]}
    return Intrinsics(**lenses, height=int(values["height"]), width=int(values["width"]))


def _lines(path: Path, fields: tuple[str, ...] = _LIST_FIELDS) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and words of the lines that are neither blank nor comments; commas and tabs are blanks."""
    text = read_text(path, f"write it, with lines of {' '.join(fields)}", at_most=TEXT)
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.replace(",", " ").strip()
        if not bare or bare.startswith("#"):
            continue
        # File names may contain blanks.
        words = bare.split(maxsplit=1) if fields == _LIST_FIELDS else bare.split()
        if len(words) != len(fields):
            raise InputError(
                f"{path}: line {number} has {len(words)} values, not {len(fields)}; write {' '.join(fields)}"
            )
        yield number, words


def _numbers(path: Path, line: int, words: list[str]) -> list[float]:
    return [finite_number(f"{path}: line {line}", word, "repair the line") for word in words]
