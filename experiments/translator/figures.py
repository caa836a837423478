"""Figures 4 to 6 of the paper: a network's predictions, its metrics during training, and its metrics by house."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dc2g_jax._src.figures.results_figures import PAGE_WIDTH, plain_axes, save_figure
from dc2g_jax._src.figures.training_figures import draw_band
from experiments.translator.metrics import HouseMetrics

#: Colors (of Okabe and Ito; the first three as in the paper: L1, GAN, both), markers and line styles of networks and
#: losses, in the order in which these are given.
_COLORS = ("#009e73", "#cc79a7", "#0072b2", "#d55e00", "#e69f00", "#56b4e9")
_MARKERS = ("o", "^", "s", "D", "v", "P")
_LINES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))

#: Metric -> label, in the order of the paper's Fig. 6.
METRIC_LABELS = {
    "l1": "per-pixel\n$L_1$ error",
    "low_precision": "precision,\nlow cost-to-go",
    "low_recall": "recall,\nlow cost-to-go",
    "traversable_precision": "precision,\ntraversable",
    "traversable_recall": "recall,\ntraversable",
}


class Example(NamedTuple):
    """An image pair with a prediction.

    Attributes:
      name: name of the house.
      image: image of the map.
      predicted: predicted image of its cost-to-go.
      true: true image of its cost-to-go.
    """

    name: str
    image: Float[np.ndarray, "s s 3"]
    predicted: Float[np.ndarray, "s s 3"]
    true: Float[np.ndarray, "s s 3"]


def _plain(axes: Axes, metric: str) -> None:
    """Set up the panel of a metric: an error from 0, or a share from 0 to 1."""
    if metric == "l1":
        axes.set_ylim(bottom=0)
    else:
        axes.set_ylim(-0.03, 1.03)
    plain_axes(axes)


def plot_translations(path: str | Path, full: Sequence[Example], partial: Sequence[Example], caption: str) -> None:
    """Draw Fig. 4: input, prediction and truth, for whole maps on the left and partial maps on the right.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      full: examples with fully observed maps.
      partial: equally many examples with partially observed maps.
      caption: description of network and houses.
    """
    rows = len(full)
    figure = Figure(figsize=(PAGE_WIDTH, 1.15 * rows + 0.9), layout="constrained")
    halves = list(np.ravel(figure.subfigures(1, 2, squeeze=False)))
    for half, title, examples in zip(halves, ("full maps", "partial maps"), (full, partial), strict=True):
        half.suptitle(title, fontsize=9)
        grid = half.subplots(rows, 3, squeeze=False)
        for number, (row, example) in enumerate(zip(grid, examples, strict=True)):
            for axes, picture, name in zip(row, example[1:], ("input", "prediction", "truth"), strict=True):
                axes.imshow(np.clip(picture, 0, 1), interpolation="nearest")
                axes.set(xticks=[], yticks=[])
                axes.set_title("" if number else name, fontsize=9)
            row[0].set_ylabel(example.name, fontsize=7)
    legend = {
        "white": "visible, nearest to the goal",
        "#777777": "farther",
        "black": "farthest, not observed, or cut off",
        "red": "not traversable",
    }
    patches = [Patch(facecolor=color, edgecolor="#333333", label=label) for color, label in legend.items()]
    options = {"ncols": len(patches), "frameon": False, "fontsize": 7.5, "title_fontsize": 7.5}
    figure.legend(handles=patches, title=caption, loc="outside lower center", **options)
    save_figure(figure, path, dpi=300)


def _moving_average(values: Float[np.ndarray, "n"], window: int) -> Float[np.ndarray, "n"]:
    """Mean over the last `window` values, or over all if there are fewer; NaN values are ignored."""
    padded = np.pad(values, (window - 1, 0), constant_values=np.nan)
    means = np.ma.masked_invalid(np.lib.stride_tricks.sliding_window_view(padded, window)).mean(axis=1)
    return np.ma.filled(means, np.nan)


def plot_training(
    path: str | Path, runs: Mapping[str, Sequence[Mapping[int, Mapping[str, Any]]]], caption: str, *, window: int
) -> None:
    """Draw Fig. 5: validation metrics during training, one curve per loss.

    Each run is smoothed by a moving average. Curves are the mean over the runs of a loss that have a value; bands are
    one standard deviation.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      runs: loss -> runs -> step -> metrics; all runs of a loss were validated at the same steps.
      caption: description of networks and data.
      window: number of validations in the moving average.
    """
    metrics = ("l1", "low_precision", "low_recall")
    figure = Figure(figsize=(PAGE_WIDTH, 2.7), layout="constrained")
    panels = figure.subplots(1, len(metrics))
    for axes, metric in zip(panels, metrics, strict=True):
        for (loss, logs), color, line in zip(runs.items(), _COLORS, _LINES, strict=False):
            steps = np.array(sorted(logs[0]))
            curves = [_moving_average(np.array([log[step][metric] for step in steps], float), window) for log in logs]
            draw_band(axes, steps, np.ma.masked_invalid(np.stack(curves)), color=color, linestyle=line, label=loss)
        axes.set_xlabel("training steps", fontsize=8)
        axes.set_title(METRIC_LABELS[metric].replace("\n", " "), fontsize=8.5)
        _plain(axes, metric)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False, fontsize=8)
    figure.supxlabel(textwrap.fill(caption, 115), fontsize=8, color="#555555")
    save_figure(figure, path)


def plot_by_similarity(path: str | Path, networks: Mapping[str, HouseMetrics], caption: str) -> None:
    """Draw Fig. 6: each metric by house over the house's distance from training, with one line per network.

    A share that is nowhere below 1 has no panel. The axes of others begin at their lowest value.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      networks: name -> points.
      caption: description of the houses.
    """
    values = {metric: np.ravel([points.metrics[metric] for points in networks.values()]) for metric in METRIC_LABELS}
    drawn = [metric for metric in METRIC_LABELS if metric == "l1" or np.any(values[metric] < 1)]
    if left_out := [label.replace("\n", " ") for metric, label in METRIC_LABELS.items() if metric not in drawn]:
        caption += f"\nNot drawn, as nowhere below 1: {'; '.join(left_out)}."
    figure = Figure(figsize=(PAGE_WIDTH, 1.2 + 1.6 * len(drawn)), layout="constrained")
    panels = figure.subplots(len(drawn), 1, sharex=True, squeeze=False)[:, 0]
    for axes, metric in zip(panels, drawn, strict=True):
        for number, (name, points) in enumerate(networks.items()):
            color, marker, line = (kinds[number % len(kinds)] for kinds in (_COLORS, _MARKERS, _LINES))
            axes.scatter(
                points.distance, points.metrics[metric], s=22, marker=marker, color=color, alpha=0.75, linewidths=0,
                label=name,
            )  # fmt: skip
            if metric in points.fits:
                slope, intercept = points.fits[metric]
                ends = np.array([min(points.distance), max(points.distance)])
                axes.plot(ends, slope * ends + intercept, color=color, linestyle=line, linewidth=1.5)
        axes.set_ylabel(METRIC_LABELS[metric], fontsize=9)
        _plain(axes, metric)
        if metric != "l1":
            span = max(0.02, 1 - np.nanmin(values[metric]))
            axes.set_ylim(1 - 1.08 * span, 1 + 0.08 * span)
    panels[-1].set_xlabel(
        "distance from the most similar training house (0: same words, 1: no word in common)", fontsize=9
    )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(3, len(labels)), frameon=False)
    figure.supxlabel(caption, fontsize=8, color="#555555")
    save_figure(figure, path)
