"""Figures of training: how validation went, a curve for each kind of run."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dc2g_jax.inspection.figures import PAGE_WIDTH, plain_axes, save_figure

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = ("o", "^", "s", "D", "v", "P", "X")
_LINES = ("-", "--", "-.", ":")


def draw_band(axes: Axes, steps: Int[np.ndarray, "n"], curves: Float[np.ndarray, "runs n"], **style: Any) -> None:
    """The mean of several runs as a curve, one standard deviation as a band.

    Args:
      axes: where to draw.
      steps: training steps.
      curves: a row a run.
      style: of the curve, as matplotlib has it.
    """
    mean, deviation = curves.mean(axis=0), curves.std(axis=0)
    (line,) = axes.plot(steps, mean, linewidth=1.7, **style)
    axes.fill_between(steps, mean - deviation, mean + deviation, color=line.get_color(), alpha=0.17, linewidth=0)


def plot_sweep(path: str | Path, runs: Mapping[str, Sequence[Mapping[int, float]]], caption: str) -> list[Path]:
    """Draw validation errors over training steps: a curve for each kind of run, the mean over its seeds.

    Bands are one standard deviation over seeds.

    Args:
      path: where to write, without an ending.
      runs: kind -> runs -> step -> error in cells; all runs of a kind were validated at the same steps.
      caption: what was validated on what.

    Returns:
      The files written: PNG and SVG.
    """
    figure = Figure(figsize=(PAGE_WIDTH, 4.4), layout="constrained")
    axes = figure.subplots()
    for number, (kind, logs) in enumerate(runs.items()):
        place = number % len(_COLOURS)
        style = {"color": _COLOURS[place], "marker": _MARKERS[place], "linestyle": _LINES[number % len(_LINES)]}
        steps = np.array(sorted(logs[0]))
        curves = np.array([[log[step] for step in steps] for log in logs])
        draw_band(axes, steps, curves, markersize=4, label=kind, **style)
    axes.set_xlabel("training steps")
    axes.set_ylabel("validation error (cells)")
    plain_axes(axes)
    axes.legend(frameon=False, fontsize=8)
    figure.supxlabel(caption, fontsize=8, color="#555555")
    return save_figure(figure, path)
