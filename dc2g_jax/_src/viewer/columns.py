"""Columns of a rerun recording: one call sends all steps of an image, a set of cells, lines or a curve.

A call takes about 40 us however much it sends, so data are not sent step by step.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, Int, UInt8

from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.viewer.legend import ROBOT_COLOR, TRAJECTORY_COLOR

#: Name of the timeline: actions of a robot, or steps of an optimizer.
TIMELINE = "step"

#: The part of a path up to the moment shown.
SO_FAR = rrb.VisibleTimeRanges(
    timeline=TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
)

#: Address of a viewer on this machine that was started with `rerun`.
_VIEWER = "rerun+http://127.0.0.1:9876/proxy"


def viewer_sink(address: str) -> rr.GrpcSink:
    """A connection to a running viewer.

    Raises:
      InputError: the address is invalid. This does not check that a viewer runs there.
    """
    try:
        return rr.GrpcSink(address)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{address}: is no address of a viewer ({error}); give {_VIEWER}, or what it says") from None


def open_recording(
    file: Path | None, viewer: str | None = None, *, name: str, blueprint: rrb.Blueprint, recording: str | None = None
) -> rr.RecordingStream:
    """A recording that is written to a file, sent to a viewer, or both. It is independent of other recordings.

    Args:
      file: file to write, whose folder is created; `None` for no file.
      viewer: address of a running viewer; `None` for no viewer.
      name: name of the recording in the viewer.
      blueprint: the first view.
      recording: identifier; files with the same identifier are parts of one recording. `None` for a new one.

    Raises:
      InputError: the file cannot be written, or the address is invalid.
    """
    stream = rr.RecordingStream("dc2g_jax", recording_id=recording)
    sinks: list[Any] = [] if viewer is None else [viewer_sink(viewer)]
    try:
        if file is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
            sinks.append(rr.FileSink(file))
        stream.set_sinks(*sinks, default_blueprint=blueprint)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{file}: cannot be written ({error}); name a file in a folder of yours") from None
    stream.send_recording_name(name)
    return stream


def first_view(contents: rrb.Horizontal, **playback: Any) -> rrb.Blueprint:
    """The view in which a recording of steps opens, with the viewer's own panels collapsed.

    Args:
      contents: views of the data.
      **playback: options of `rerun.blueprint.TimePanel`.
    """
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE, **playback)
    return rrb.Blueprint(contents, time, auto_views=False, collapse_panels=True)


def send(stream: rr.RecordingStream, entity: str, steps: Int[np.ndarray, "t"], columns: Any) -> None:
    """Send one row of each column for every given step."""
    stream.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, sequence=steps)], columns=columns)


def image_style(stream: rr.RecordingStream, entity: str, context: rr.AnnotationContext, draw_order: float) -> None:
    """Set names and colors of class images, which are drawn cell by cell, without smoothing."""
    stream.log(entity, context, rr.SegmentationImage.from_fields(opacity=1.0, draw_order=draw_order), static=True)


def send_images(
    stream: rr.RecordingStream, entity: str, steps: Int[np.ndarray, "t"], classes: UInt8[np.ndarray, "t h w"]
) -> None:
    """Send class images, one per step."""
    frames, height, width = classes.shape
    form = rr.components.ImageFormat(width=width, height=height, channel_datatype=rr.ChannelDatatype.U8)
    stream.log(entity, rr.SegmentationImage.from_fields(format=form), static=True)
    pixels = np.ascontiguousarray(classes).reshape(frames, height * width)
    send(stream, entity, steps, rr.SegmentationImage.columns(buffer=pixels))


def centers(x: Int[np.ndarray, "n"], y: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 2"]:
    """Centers of cells in the viewer's coordinates, in which cell (0, 0) extends from 0 to 1."""
    return np.stack([x, y], axis=-1).astype(np.float32) + 0.5


def send_cells(stream: rr.RecordingStream, entity: str, cells: Bool[np.ndarray, "t h w"], style: Any) -> None:
    """Send dots at the centers of cells, any number per step."""
    frame, row, column = np.nonzero(cells)
    counts = np.bincount(frame, minlength=len(cells))
    stream.log(entity, style, static=True)
    dots = rr.Points2D.columns(positions=centers(column, row)).partition(lengths=counts)
    send(stream, entity, np.arange(len(cells)), dots)


def send_lines(stream: rr.RecordingStream, entity: str, lines: Sequence[Float[np.ndarray, "_ 2"]], style: Any) -> None:
    """Send one line per step. A step with fewer than two points has no line."""
    drawn = [line for line in lines if len(line) > 1]
    stream.log(entity, style, static=True)
    if drawn:
        counts = np.array([len(line) > 1 for line in lines], int)
        send(stream, entity, np.arange(len(lines)), rr.LineStrips2D.columns(strips=drawn).partition(lengths=counts))


def curve_style(stream: rr.RecordingStream, entity: str, name: str, color: tuple[int, ...]) -> None:
    """Set name and color of a curve."""
    stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=2.0), static=True)


def send_curve(stream: rr.RecordingStream, entity: str, values: Float[np.ndarray, "t"]) -> None:
    """Send the finite values of a curve, one per step."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size:
        send(stream, entity, known, rr.Scalars.columns(scalars=values[known].astype(np.float64)))


def send_track(
    stream: rr.RecordingStream,
    entity: str,
    here: Float[np.ndarray, "t 2"],
    ahead: Float[np.ndarray, "t 2"],
    size: float,
) -> None:
    """Send a robot's position, heading and path: one segment of the path per step, which the viewer accumulates.

    Args:
      stream: the recording.
      entity: the robot; `heading` and `path` lie below it.
      here: its place at each step.
      ahead: the arrow of its heading.
      size: radius of its disc; arrow and path are as much thinner everywhere.
    """
    steps = np.arange(len(here))
    stream.log(entity, rr.Points2D.from_fields(radii=size, colors=ROBOT_COLOR, draw_order=60), static=True)
    arrow = rr.Arrows2D.from_fields(radii=0.3 * size, colors=ROBOT_COLOR, draw_order=61)
    stream.log(f"{entity}/heading", arrow, static=True)
    line = rr.LineStrips2D.from_fields(radii=0.2 * size, colors=TRAJECTORY_COLOR, draw_order=30)
    stream.log(f"{entity}/path", line, static=True)
    send(stream, entity, steps, rr.Points2D.columns(positions=here))
    send(stream, f"{entity}/heading", steps, rr.Arrows2D.columns(origins=here, vectors=ahead))
    moves = 1 + np.flatnonzero(np.any(np.diff(here, axis=0), axis=1))
    if len(moves):
        pieces = np.stack([here[moves - 1], here[moves]], axis=1)
        send(stream, f"{entity}/path", moves, rr.LineStrips2D.columns(strips=pieces))
