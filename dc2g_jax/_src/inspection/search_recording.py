"""Recordings of object searches for the rerun viewer."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from dc2g_jax._src.inspection import _legend
from dc2g_jax._src.inspection.columns import SO_FAR, first_view, open_recording, send, send_curve
from dc2g_jax._src.inspection.search_figures import (
    ROWS,
    SearchMoment,
    cost_image,
    extent_of,
    highest_of,
    map_image,
    robots_map,
)
from dc2g_jax._src.search_indoors.houses.worlds import IndoorWorld
from dc2g_jax._src.search_indoors.maps.classes import OBJECT_CLASSES

#: Entities of the three maps.
_MAPS = ("true_map", "robots_map", "costs")


def record_search(
    path: str | Path,
    name: str,
    world: IndoorWorld,
    target: int,
    track: Float[np.ndarray, "time 5"],
    moments: Sequence[SearchMoment],
) -> Path:
    """Write a rerun file (`.rrd`) of a search: maps at each decision, in cells of the house, and the path.

    Args:
      path: file to write; its folder is created.
      name: name of the recording.
      world: the house.
      target: class index of the wanted object.
      track: the robot's track, see `search_indoors.search.agent.IndoorRobot`, from step 0 on.
      moments: moments of the search in order, at least one.

    Returns:
      The path.

    Raises:
      InputError: the file cannot be written.
    """
    size, classes = float(world.cell_size), np.asarray(world.classes)
    extent = extent_of(np.asarray(world.free | world.obstacle), size)
    left, right, bottom, top = (edge / size for edge in extent)
    bounds = rrb.VisualBounds2D(x_range=[left, right], y_range=[-top, -bottom])
    views = [
        rrb.Spatial2DView(
            origin="/",
            contents=[f"/{entity}/**", "/robot/**"],
            name=row,
            visual_bounds=bounds,
            overrides={"/robot/path": SO_FAR},
        )
        for entity, row in zip(_MAPS, ROWS, strict=True)
    ]
    words = rrb.Vertical(
        rrb.TextLogView(origin="/doing", name="doing"),
        rrb.TimeSeriesView(origin="/lowest_cost", name="lowest cost around the robot (m)"),
    )
    stream = open_recording(Path(path), name=name, blueprint=first_view(rrb.Horizontal(*views, words), fps=20.0))
    true = map_image(classes, np.asarray(world.free), np.asarray(world.walls))
    stream.log("true_map", rr.Image(true), static=True)
    rows, columns = np.nonzero(classes == target)
    stream.log("true_map/target", rr.Points2D(
        np.stack([columns, rows], axis=-1) + 0.5, radii=0.4, colors=_legend.SUBGOAL_COLOR,
        labels=[OBJECT_CLASSES[target]] * len(rows), show_labels=False,
    ), static=True)  # fmt: skip
    high = highest_of(moments, extent, size)
    for moment in moments:
        stream.set_time("step", sequence=moment.step)
        costs = (255 * cost_image(moment.costs, high)).astype(np.uint8)
        for entity, image, first in (
            ("robots_map", robots_map(moment.cells), moment.origin),
            ("costs", costs, moment.corner),
        ):
            row, column = (float(number) for number in first)
            stream.log(entity, rr.Transform3D(translation=[column, row, 0.0]), rr.Image(image))
        stream.log("doing", rr.TextLog(moment.doing))
    driven = track[: moments[-1].step + 1]
    here = (driven[:, :2] / (size, -size)).astype(np.float32)
    steps, yaw = np.arange(len(driven)), driven[:, 2]
    stream.log("robot", rr.Points2D.from_fields(radii=2.0, colors=_legend.ROBOT_COLOR, draw_order=60), static=True)
    ahead = rr.Arrows2D.from_fields(radii=0.6, colors=_legend.ROBOT_COLOR, draw_order=61)
    stream.log("robot/heading", ahead, static=True)
    line = rr.LineStrips2D.from_fields(radii=0.4, colors=_legend.TRAJECTORY_COLOR, draw_order=30)
    stream.log("robot/path", line, static=True)
    send(stream, "robot", steps, rr.Points2D.columns(positions=here))
    vectors = 6.0 * np.stack([np.cos(yaw), -np.sin(yaw)], axis=-1)
    send(stream, "robot/heading", steps, rr.Arrows2D.columns(origins=here, vectors=vectors))
    if len(here) > 1:
        pieces = np.stack([here[:-1], here[1:]], axis=1)
        send(stream, "robot/path", steps[1:], rr.LineStrips2D.columns(strips=pieces))
    lowest = np.full(len(driven), np.nan)
    for moment in moments:
        lowest[moment.step] = np.min(moment.costs, initial=np.inf, where=np.isfinite(moment.costs))
    send_curve(stream, "lowest_cost", lowest)
    stream.flush()
    stream.disconnect()
    return Path(path)
