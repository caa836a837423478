"""Recordings of mapping for the rerun viewer: camera images, points, voxels, the map and the camera's path."""

import functools
import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8
from tqdm import tqdm

from dc2g_jax.grid import CLASS_NAMES
from dc2g_jax.inspection import (
    SO_FAR,
    first_view,
    image_style,
    open_recording,
    send,
    send_images,
    send_track,
    terrain_context,
)
from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics, points
from dc2g_jax.robot.mapping.semantic_map import MapSettings, SemanticMap, check_frame, empty_map, integrate, terrain_map
from dc2g_jax.robot.mapping.sequences import DEPTH_UNITS, ImageSequence, depth_steps, read_frame, read_picture
from dc2g_jax.runtime import InputError, jit

#: Number of steps that are sent together. Until then they are kept in memory.
_CHUNK = 32

#: Total number of points shown at the end, and least number per frame.
_POINTS, _FEWEST_POINTS = 200_000, 200

#: Drawn size of a voxel relative to its true size: the gaps separate neighbors.
_DRAWN = 0.94

_PATH_COLOR, _BACKGROUND = (235, 30, 30), (120, 120, 128)

#: Entities. Images are children of the camera, so that they are shown in the world as well.
_CAMERA, _IMAGE = "world/camera", "world/camera/image"
_PICTURE, _DEPTH, _CLASSES = f"{_IMAGE}/picture", f"{_IMAGE}/depth", f"{_IMAGE}/classes"

_points = jit(points)


class MappedFrame(NamedTuple):
    """A frame and the map after it; arrays on the host.

    Attributes:
      frame: the camera's frame.
      picture: encoded color image (PNG or JPEG), if there is one.
      voxels: the voxel map.
      terrain: the map as seen from above.
    """

    frame: Frame
    picture: bytes | None
    voxels: SemanticMap
    terrain: UInt8[np.ndarray, "h w"]


def record_camera(
    file: Path,
    frames: Iterable[MappedFrame],
    *,
    camera: Intrinsics,
    settings: MapSettings,
    path: Float[np.ndarray, "n 3"],
    name: str,
) -> tuple[UInt8[np.ndarray, "h w"], int]:
    """Record the frames of a sequence and the map after each, while it is mapped.

    Args:
      file: file to write.
      frames: frames that could be mapped, in order.
      camera: intrinsics of the camera.
      settings: settings of the map.
      path: positions of the camera in all frames of the sequence, meters in the world, to frame the first view.
      name: name of the sequence.

    Returns:
      The map seen from above, and the number of frames that could not be mapped.

    Raises:
      InputError: no frame could be mapped, or the file cannot be written.
    """
    pixels_a_point = camera.height * camera.width * len(path) / max(_POINTS, _FEWEST_POINTS * len(path))
    stride = max(1, round(pixels_a_point**0.5))
    stream = open_recording(file, name=name, blueprint=_layout(settings, path))
    _describe(stream, camera, settings)
    waiting = iter(frames)
    poses: list[CameraPose] = []
    try:
        while mapped := list(itertools.islice(waiting, _CHUNK)):
            steps = len(poses) + np.arange(len(mapped))
            poses += [one.frame.pose for one in mapped]
            pictures = {step: one.picture for step, one in zip(steps, mapped, strict=True) if one.picture is not None}
            if pictures:
                send(stream, _PICTURE, np.array(list(pictures)), rr.EncodedImage.columns(blob=list(pictures.values())))
            depth = depth_steps(np.stack([one.frame.depth for one in mapped]).reshape(len(steps), -1))
            send(stream, _DEPTH, steps, rr.DepthImage.columns(buffer=depth.view(np.uint8)))
            send_images(stream, _CLASSES, steps, np.stack([one.frame.classes for one in mapped]))
            _send_points(stream, steps, [one.frame for one in mapped], camera, stride)
            _send_voxels(stream, steps, [one.voxels for one in mapped], settings)
            send_images(stream, "map", steps, np.stack([one.terrain for one in mapped]))
            terrain = mapped[-1].terrain
    finally:  # an interrupted recording keeps what it has
        if poses:
            _send_path(stream, poses, settings.cell_size)
        stream.flush()
        stream.disconnect()
    if not poses:
        raise InputError(f"{name}: something is wrong with all of its {len(path)} frames; see the lines above")
    return terrain, len(path) - len(poses)


def _describe(stream: rr.RecordingStream, camera: Intrinsics, settings: MapSettings) -> None:
    """Send static data: colors, frames of reference, the camera, and styles."""
    style = functools.partial(stream.log, static=True)
    style("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    style("world", terrain_context())
    pinhole = rr.Pinhole(
        focal_length=[camera.focal_x, camera.focal_y],
        principal_point=[camera.center_x, camera.center_y],
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=2 * settings.cell_size,
    )
    style(_IMAGE, pinhole)
    steps = rr.components.ImageFormat(width=camera.width, height=camera.height, channel_datatype=rr.ChannelDatatype.U16)
    reach = [0, DEPTH_UNITS * settings.reach]
    style(_DEPTH, rr.DepthImage.from_fields(format=steps, meter=DEPTH_UNITS, colormap="Turbo", depth_range=reach))
    style("world/points", rr.Points3D.from_fields(radii=-2.0))
    style("world/voxels", rr.Boxes3D.from_fields(fill_mode="solid"))
    style("world/path", rr.LineStrips3D.from_fields(radii=-2.5, colors=_PATH_COLOR))
    for image in (_CLASSES, "map", "legend"):
        image_style(stream, image, terrain_context(), 0)
    classes = np.arange(len(CLASS_NAMES), dtype=np.uint8)
    style("legend", rr.SegmentationImage(classes[:, None]))
    places = np.stack([0 * classes + 0.5, classes + 0.3], axis=1)
    names = [name.replace("_", " ") for name in ("not observed", *CLASS_NAMES[1:])]
    style("legend/names", rr.Points2D(places, radii=0.0, colors=(255, 255, 255), labels=names, show_labels=True))


def _send_points(
    stream: rr.RecordingStream, steps: np.ndarray, frames: list[Frame], camera: Intrinsics, stride: int
) -> None:
    """Send the points of each frame in the world, evenly subsampled."""
    every = np.s_[::stride, ::stride]
    clouds, classes = [], []
    for frame in frames:
        kept = np.asarray(frame.depth)[every] > 0
        clouds.append(np.asarray(_points(frame.depth, camera, frame.pose))[every][kept])
        classes.append(np.asarray(frame.classes)[every][kept])
    cloud = rr.Points3D.columns(positions=np.concatenate(clouds), class_ids=np.concatenate(classes))
    send(stream, "world/points", steps, cloud.partition([len(cloud) for cloud in clouds]))


def _send_voxels(stream: rr.RecordingStream, steps: np.ndarray, maps: list[SemanticMap], settings: MapSettings) -> None:
    """Send the occupied voxels as boxes in the colors of their classes."""
    cell, level_height = settings.cell_size, settings.level_height
    centers, classes = [], []
    for voxels in jax.tree.map(jnp.asarray, maps):
        level, row, column = np.nonzero(np.asarray(voxels.occupied))
        middles = [(column + 0.5) * cell, -(row + 0.5) * cell, level * level_height]
        centers.append(np.stack(middles, axis=1).astype(np.float32))
        classes.append(np.asarray(voxels.classes)[level, row, column])
    counts = [len(center) for center in centers]
    sizes = np.tile(_DRAWN / 2 * np.array([cell, cell, level_height], np.float32), (sum(counts), 1))
    boxes = rr.Boxes3D.columns(centers=np.concatenate(centers), half_sizes=sizes, class_ids=np.concatenate(classes))
    send(stream, "world/voxels", steps, boxes.partition(counts))


def _send_path(stream: rr.RecordingStream, poses: Sequence[CameraPose], cell_size: float) -> None:
    """Send the camera's poses and path: one segment of the path per step, which the viewer accumulates."""
    here, turns = (np.stack(parts) for parts in zip(*((one.position, one.rotation) for one in poses), strict=True))
    send(stream, _CAMERA, np.arange(len(here)), rr.Transform3D.columns(translation=here, mat3x3=turns.reshape(-1, 9)))
    moves = 1 + np.flatnonzero(np.any(np.diff(here, axis=0), axis=1))
    if len(moves):
        pieces = np.stack([here[moves - 1], here[moves]], axis=1)
        send(stream, "world/path", moves, rr.LineStrips3D.columns(strips=pieces))
    on_map = (here[:, :2] * (1, -1) / cell_size).astype(np.float32)
    send_track(stream, "map/robot", on_map, turns[:, :2, 2] * (2.5, -2.5), 0.8)


def _layout(settings: MapSettings, path: Float[np.ndarray, "n 3"]) -> rrb.Blueprint:
    """The first view: the camera's images on the left, voxels in the middle, map, points and legend on the right."""
    low, high = path.min(axis=0), path.max(axis=0)
    x, y, _ = (low + high) / 2
    size = float(max(high - low)) + settings.reach
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=[x, y - 0.9 * size, size], look_target=[x, y, 0], eye_up=[0, 0, 1]
    )

    def world(name: str, contents: list[str], so_far: list[str]) -> rrb.Spatial3DView:
        return rrb.Spatial3DView(
            origin="/world",
            contents=["/world/path", f"/{_CAMERA}", f"/{_IMAGE}", *contents],
            name=name,
            eye_controls=eye,
            background=_BACKGROUND,
            line_grid=False,
            overrides=dict.fromkeys(("world/path", *so_far), SO_FAR),
        )

    images = [
        rrb.Spatial2DView(origin=f"/{_IMAGE}", contents=[f"/{entity}"], name=name)
        for entity, name in ((_PICTURE, "camera"), (_DEPTH, "depth"), (_CLASSES, "classes of the pixels"))
    ]
    bounds = rrb.VisualBounds2D(x_range=[-0.5, settings.columns + 0.5], y_range=[-0.5, settings.rows + 0.5])
    names = rrb.VisualBounds2D(x_range=[-0.5, 1.5], y_range=[-0.3, len(CLASS_NAMES) + 0.3])
    seen_from_above = rrb.Spatial2DView(
        origin="/map", name="map as seen from above", visual_bounds=bounds, overrides={"map/robot/path": SO_FAR}
    )
    return first_view(
        rrb.Horizontal(
            rrb.Vertical(*images),
            world("voxels", ["/world/voxels", f"/{_PICTURE}"], []),
            rrb.Vertical(
                seen_from_above,
                world("points so far, depth of this frame", ["/world/points", f"/{_DEPTH}"], ["world/points"]),
            ),
            rrb.Spatial2DView(origin="/legend", name="legend", visual_bounds=names),
            column_shares=[2.2, 5, 3.4, 1.2],
        ),
        fps=10.0,
    )


def record_mapping(
    file: Path, sequence: ImageSequence, settings: MapSettings, name: str
) -> tuple[UInt8[np.ndarray, "h w"], int]:
    """Map all frames of a sequence and record them. Invalid frames are skipped, with a line on the standard error.

    Args:
      file: file to write.
      sequence: the sequence.
      settings: settings of the map.
      name: name of the sequence.

    Returns:
      The map seen from above, and the number of invalid frames.

    Raises:
      InputError: all frames are invalid, or the file cannot be written.
    """
    take, read = jit(integrate, static_argnums=3), jit(terrain_map, static_argnums=1)

    def mapped() -> Iterator[MappedFrame]:
        voxels = empty_map(settings)
        for files in tqdm(sequence.frames, desc="mapping", unit="frame", file=sys.stderr):
            frame = read_frame(sequence, files)
            try:
                check_frame(frame, settings)
            except InputError as error:
                tqdm.write(f"left out {files.depth}: {error}", file=sys.stderr)
                continue
            voxels = take(voxels, frame, sequence.intrinsics, settings)
            terrain, after = jax.device_get((read(voxels, settings), voxels))
            yield MappedFrame(frame, read_picture(files), after, terrain)

    path = np.stack([files.pose.position for files in sequence.frames])
    return record_camera(file, mapped(), camera=sequence.intrinsics, settings=settings, path=path, name=name)
