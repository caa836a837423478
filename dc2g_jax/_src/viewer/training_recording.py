"""Recordings of training for the rerun viewer: curves, and predictions for a few fixed maps."""

import contextlib
import functools
import itertools
import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Array, Float, UInt8
from PIL import Image, ImageDraw

from dc2g_jax._src.estimation import compact_unet
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.grid.terrain import FIGURE_RGB
from dc2g_jax._src.planning.planners import Frontier
from dc2g_jax._src.planning.rules import complete_rules
from dc2g_jax._src.readers.houses import HouseDataset, stack_worlds
from dc2g_jax._src.readers.starts import sample_starts, usable_houses
from dc2g_jax._src.rollouts.evaluation import episodes_from
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit
from dc2g_jax._src.training.cost_to_go import TrainingConfig
from dc2g_jax._src.training.cost_to_go_data import training_set
from dc2g_jax._src.training.masks import Masks, collect_masks
from dc2g_jax._src.training.pairs import Pair, make_pair
from dc2g_jax._src.viewer import legend
from dc2g_jax._src.viewer.columns import TIMELINE, curve_style, first_view, image_style, open_recording
from dc2g_jax._src.viewer.legend import CostScale

#: Number of maps in a recording, and in pictures for a tracker.
_MAPS_SHOWN = 6

#: Gap between two maps side by side, columns.
_GAP = 2

#: Side of a cell in pictures, and height of the names of rows, pixels.
_PIXELS_A_CELL, _CAPTION = 3, 18

#: Range of the field of view of the robots whose maps are shown, cells.
_SENSING_RANGE = 8

#: Least number of steps between two predictions.
_STEPS_PER_PREDICTION = 100

#: Entities of the maps from top to bottom, with their names.
_ROWS = {
    "known": "observed parts of validation houses, always the same",
    "predicted": "predicted cost-to-go",
    "exact": "exact cost-to-go",
    "difference": "predicted less exact: blue too low, red too high",
}

#: Entities of the curves from top to bottom, with their names and shares of the height.
_CURVES = {
    "loss": ("loss", 2),
    "learning_rate": ("learning rate", 2),
    "error": ("mean error on the maps shown (cells)", 2),
    "validation/error": ("mean error on validation pairs (cells)", 2),
    "validation/mean": ("validation episodes: mean extra steps (%)", 3),
}


@jit
def _expected_cost(network: NetworkCostToGo, terrain: UInt8[Array, "n h w"]) -> Float[Array, "n h w"]:
    return jnp.mean(compact_unet.apply(network.architecture, network.weights, terrain), axis=-1)


@functools.lru_cache(maxsize=1)
def maps_to_watch(dataset: HouseDataset) -> Pair:
    """Partial maps of the dataset's validation houses by exploring robots, the same in every run.

    Raises:
      InputError: there are no such maps.
    """
    houses = usable_houses(dataset, "val")
    rules = complete_rules(_SENSING_RANGE)
    starts = sample_starts(houses, -(-_MAPS_SHOWN // len(houses)), seed=0)
    masks = collect_masks(
        Frontier(rules=rules),
        stack_worlds(houses),
        *episodes_from(starts, {house.name: number for number, house in enumerate(houses)}),
        sensing=rules.sensing,
        per_episode=4,
        seed=0,
    )
    if not len(masks.world):
        raise InputError(
            f"{dataset.name}: robots see a door of its validation houses at once; train without --record and --track"
        )
    chosen = np.linspace(0, len(masks.world) - 1, _MAPS_SHOWN).round().astype(int)
    data = training_set(houses, len(houses), Masks(masks.boards[chosen], masks.world[chosen]))
    return jax.vmap(lambda index: make_pair(data, index, jnp.int32(0), edge_weight=1.0))(jnp.arange(_MAPS_SHOWN))


def next_file(folder: Path) -> Path:
    """The file for the recording of a new or resumed run: `training-001.rrd`, then `training-002.rrd`, and so on."""
    files = (folder / f"training-{number:03d}.rrd" for number in itertools.count(1))
    return next(file for file in files if not file.exists())


def _side_by_side(images: UInt8[np.ndarray, "n h w *rgb"], gap: int = 0) -> UInt8[np.ndarray, "h all *rgb"]:
    """Images in a row, with gaps of this value."""
    padded = np.pad(images, [(0, 0), (0, 0), (0, _GAP), (0, 0)][: images.ndim], constant_values=gap)
    return np.concatenate(list(padded), axis=1)[:, :-_GAP]


def _layout(shape: tuple[int, int], steps: int) -> rrb.Blueprint:
    """The first view: curves on the left, maps on the right.

    Args:
      shape: rows and columns of maps side by side.
      steps: optimizer steps in all.
    """
    bounds = rrb.VisualBounds2D(x_range=[-0.5, shape[1] + 0.5], y_range=[-0.5, shape[0] + 0.5])
    maps = [rrb.Spatial2DView(origin=f"/maps/{row}", name=name, visual_bounds=bounds) for row, name in _ROWS.items()]
    ends = (rr.TimeRangeBoundary.absolute(seq=step) for step in (0, steps))
    whole = rrb.archetypes.TimeAxis(view_range=rr.TimeRange(*ends))
    legend_at = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    curves = [
        rrb.TimeSeriesView(origin=f"/{curve}", name=name, axis_x=whole, plot_legend=legend_at)
        for curve, (name, _) in _CURVES.items()
    ]
    return first_view(
        rrb.Horizontal(
            rrb.Vertical(*curves, row_shares=[share for _, share in _CURVES.values()]),
            rrb.Vertical(*maps),
            column_shares=[2, 3.6],
        ),
        play_state="following",
    )


def prediction_picture(network: NetworkCostToGo, maps: Pair) -> UInt8[np.ndarray, "h w 3"]:
    """Observed maps, and below them the predicted and the exact cost-to-go, in the colors of the recording.

    Each of the three has its name above it.
    """
    exact, counts = np.asarray(maps.target), np.asarray(maps.weight) > 0
    scale = CostScale.of(exact)
    costs = np.stack(
        [scale.classes(np.asarray(cost), counts) for cost in (_expected_cost(network, maps.terrain), exact)]
    )
    tiles = np.concatenate([FIGURE_RGB[np.asarray(maps.terrain)][None], scale.colors()[costs]])
    parts = []
    for name, row in zip(_ROWS.values(), tiles, strict=False):
        pixels = _side_by_side(row, gap=255).repeat(_PIXELS_A_CELL, axis=0).repeat(_PIXELS_A_CELL, axis=1)
        caption = Image.new("RGB", (pixels.shape[1], _CAPTION), "white")
        ImageDraw.Draw(caption).text((2, 2), name, fill="black", font_size=_CAPTION - 6)
        parts += [np.asarray(caption), pixels]
    return np.concatenate(parts)


class TrainingRecording:
    """A recording that grows while a network trains. It reads the network only and does not affect training.

    Logged data reach the file within moments and stay readable if the process is killed. The files of one folder form
    one recording, so the viewer joins the parts of an interrupted run: `rerun FOLDER/training-*.rrd`.

    Args:
      folder: folder of the run.
      config: configuration of the run.
      maps: a few fixed pairs on which to show predictions.
      file: file to write; `None` for no file.
      viewer: address of a running viewer, as in `rerun --help`; `None` for no viewer.

    Raises:
      InputError: the file cannot be written or the address is invalid.
    """

    def __init__(self, folder: Path, config: TrainingConfig, maps: Pair, *, file: Path | None, viewer: str | None):
        self._architecture = config.architecture
        self._predicted: int | None = None
        self._terrain = jnp.asarray(maps.terrain)
        self._exact = np.asarray(maps.target)
        self._counts = np.asarray(maps.weight) > 0
        self._scale = CostScale.of(self._exact)
        terrain = _side_by_side(np.asarray(maps.terrain))
        self._stream = open_recording(
            file,
            viewer,
            name=f"training of {folder.name}",
            blueprint=_layout(terrain.shape, config.steps),
            recording=str(uuid.uuid5(uuid.NAMESPACE_URL, folder.resolve().as_uri())),
        )
        self._curves: list[str] = []
        styles = (legend.terrain_context(), self._scale.context(), self._scale.context(), legend.difference_context())
        count, height, width = maps.terrain.shape
        corners = np.stack([np.arange(count) * (width + _GAP), np.zeros(count)], axis=1)
        frames = rr.Boxes2D(mins=corners, sizes=[[width, height]] * count, colors=legend.FRAME_COLOR, radii=0.3)
        for row, context in zip(_ROWS, styles, strict=True):
            image_style(self._stream, f"maps/{row}", context, 0)
            self._stream.log(f"maps/{row}/frames", frames, static=True)
        exact = self._scale.classes(self._exact, self._counts)
        for row, image in (("known", terrain), ("exact", _side_by_side(exact))):
            self._stream.log(f"maps/{row}", rr.SegmentationImage(image), static=True)

    def look(self, step: int, figures: Mapping[str, float], weights: Any) -> None:
        """Add a point to the curves and, now and then, predictions for the maps.

        Args:
          step: optimizer steps taken.
          figures: loss and learning rate; empty before the first step.
          weights: current weights of the network.
        """
        self._add(step, figures)
        if not figures or self._predicted is None or step >= self._predicted + _STEPS_PER_PREDICTION:
            self._predict(step, weights)

    def validate(self, step: int, figures: Mapping[str, float], weights: Any) -> None:
        """Add the results of a validation, and predictions for the maps.

        Args:
          step: optimizer steps taken.
          figures: name -> value.
          weights: current weights of the network.
        """
        kinds = {name: "error" if name == "error" else "median" if "median" in name else "mean" for name in figures}
        self._add(step, {f"validation/{kinds[name]}/{name}": value for name, value in figures.items()})
        if self._predicted != step:
            self._predict(step, weights)

    def _predict(self, step: int, weights: Any) -> None:
        """Add predictions for the maps."""
        self._predicted = step
        predicted = np.asarray(_expected_cost(NetworkCostToGo(weights, self._architecture), self._terrain))
        difference = np.where(self._counts, predicted - np.where(self._counts, self._exact, 0), 0)
        self._add(step, {"error": float(np.sum(np.abs(difference)) / np.sum(self._counts))})
        predictions = {
            "predicted": self._scale.classes(predicted, self._counts),
            "difference": legend.difference_classes(difference, self._counts),
        }
        for row, classes in predictions.items():
            self._stream.log(f"maps/{row}", rr.SegmentationImage(_side_by_side(classes)))

    def _add(self, step: int, values: Mapping[str, float]) -> None:
        """Add a point to each of the curves, entity -> value."""
        self._stream.set_time(TIMELINE, sequence=step)
        for curve, value in values.items():
            if curve not in self._curves:
                group, _, name = curve.rpartition("/")
                number = sum(other.rpartition("/")[0] == group for other in self._curves)
                self._curves.append(curve)
                color = legend.CURVE_COLORS[number % len(legend.CURVE_COLORS)]
                curve_style(self._stream, curve, name.replace("_", " "), color)
            self._stream.log(curve, rr.Scalars(value))

    def close(self) -> None:
        """Write the remaining data."""
        with contextlib.suppress(RuntimeError):  # the viewer has been closed
            self._stream.flush(timeout_sec=5)
        self._stream.disconnect()
