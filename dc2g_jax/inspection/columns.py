"""Whole columns for a rerun recording: one call for all steps of an image, a set of cells, lines or a curve.

A call costs some 40 us whatever it sends, so nothing is sent step by step.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, Int, UInt8

from dc2g_jax.errors import InputError

#: Name of the timeline: actions of a robot, or steps of an optimizer.
TIMELINE = "step"

#: Address of a viewer on this machine that was started with `rerun`.
VIEWER = "rerun+http://127.0.0.1:9876/proxy"


def viewer_sink(address: str) -> rr.GrpcSink:
    """A connection to a running viewer.

    Raises:
      InputError: if this is no address of one. Whether a viewer runs there shows later.
    """
    try:
        return rr.GrpcSink(address)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"{address}: is no address of a viewer ({error}); give {VIEWER}, or what it says") from None


def open_recording(
    file: Path | None, viewer: str | None = None, *, name: str, blueprint: rrb.Blueprint, recording: str | None = None
) -> rr.RecordingStream:
    """A recording that is written to a file, sent to a viewer, or both; apart from all others of the process.

    Args:
      file: to write; its folder is made. Not written where `None`.
      viewer: address of a running viewer; not sent where `None`.
      name: what the viewer calls the recording.
      blueprint: the first view.
      recording: what tells it from others; files with the same are parts of one recording. A new one where `None`.

    Raises:
      InputError: if the file cannot be written or the address is none.
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


def send(stream: rr.RecordingStream, entity: str, steps: Int[np.ndarray, "t"], columns: Any) -> None:
    """One row of each column for every given step."""
    stream.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, sequence=steps)], columns=columns)


def image_style(stream: rr.RecordingStream, entity: str, context: rr.AnnotationContext, draw_order: float) -> None:
    """Names and colors of class images, which are drawn cell by cell, without smoothing."""
    stream.log(entity, context, rr.SegmentationImage.from_fields(opacity=1.0, draw_order=draw_order), static=True)


def send_images(
    stream: rr.RecordingStream, entity: str, steps: Int[np.ndarray, "t"], classes: UInt8[np.ndarray, "t h w"]
) -> None:
    """Class images, one a step."""
    frames, height, width = classes.shape
    form = rr.components.ImageFormat(width=width, height=height, channel_datatype=rr.ChannelDatatype.U8)
    stream.log(entity, rr.SegmentationImage.from_fields(format=form), static=True)
    pixels = np.ascontiguousarray(classes).reshape(frames, height * width)
    send(stream, entity, steps, rr.SegmentationImage.columns(buffer=pixels))


def centers(x: Int[np.ndarray, "n"], y: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 2"]:
    """Middles of cells in the viewer's coordinates, in which cell (0, 0) reaches from 0 to 1."""
    return np.stack([x, y], axis=-1).astype(np.float32) + 0.5


def send_cells(stream: rr.RecordingStream, entity: str, cells: Bool[np.ndarray, "t h w"], style: Any) -> None:
    """Dots in the middle of cells, any number a step."""
    frame, row, column = np.nonzero(cells)
    counts = np.bincount(frame, minlength=len(cells))
    stream.log(entity, style, static=True)
    dots = rr.Points2D.columns(positions=centers(column, row)).partition(lengths=counts)
    send(stream, entity, np.arange(len(cells)), dots)


def send_lines(stream: rr.RecordingStream, entity: str, lines: Sequence[Float[np.ndarray, "_ 2"]], style: Any) -> None:
    """A line a step, through two points at least, and none at a step with fewer."""
    drawn = [line for line in lines if len(line) > 1]
    stream.log(entity, style, static=True)
    if drawn:
        counts = np.array([len(line) > 1 for line in lines], int)
        send(
            stream,
            entity,
            np.arange(len(lines)),
            rr.LineStrips2D.columns(strips=drawn).partition(lengths=counts),
        )


def curve_style(stream: rr.RecordingStream, entity: str, name: str, color: tuple[int, ...]) -> None:
    """Name and color of a curve."""
    stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=2.0), static=True)


def send_curve(stream: rr.RecordingStream, entity: str, values: Float[np.ndarray, "t"]) -> None:
    """A number a step, where it is finite."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size:
        send(stream, entity, known, rr.Scalars.columns(scalars=values[known].astype(np.float64)))
