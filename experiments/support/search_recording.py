"""Recordings of object searches for the rerun viewer."""

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dc2g_jax._src.viewer import legend
from dc2g_jax._src.viewer.columns import SO_FAR, first_view, open_recording, send_curve, send_track
from dc2g_jax.indoor.maps.classes import OBJECT_CLASSES
from experiments.support.search_figures import ROWS, RecordedSearch, cost_image, robots_map

#: Entities of the three maps.
_MAPS = ("true_map", "robots_map", "costs")


def record_search(path: str | Path, name: str, search: RecordedSearch) -> None:
    """Write a rerun file (`.rrd`) of a search: maps at each decision, in cells of the house, and the path.

    Raises:
      InputError: the file cannot be written.
    """
    size, moments, high = search.size, search.moments, search.highest
    left, right, bottom, top = (edge / size for edge in search.extent)
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
    stream.log("true_map", rr.Image(search.true_map), static=True)
    rows, columns = np.nonzero(search.wanted)
    stream.log("true_map/target", rr.Points2D(
        np.stack([columns, rows], axis=-1) + 0.5, radii=0.4, colors=legend.SUBGOAL_COLOR,
        labels=[OBJECT_CLASSES[search.target]] * len(rows), show_labels=False,
    ), static=True)  # fmt: skip
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
    driven = search.track[: moments[-1].step + 1]
    here = (driven[:, :2] / (size, -size)).astype(np.float32)
    yaw = driven[:, 2]
    send_track(stream, "robot", here, 6.0 * np.stack([np.cos(yaw), -np.sin(yaw)], axis=-1), 2.0)
    lowest = np.full(len(driven), np.nan)
    for moment in moments:
        lowest[moment.step] = np.min(moment.costs, initial=np.inf, where=np.isfinite(moment.costs))
    send_curve(stream, "lowest_cost", lowest)
    stream.flush()
    stream.disconnect()
