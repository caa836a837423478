"""Figures of training: validation curves for each kind of run, and learning curves of agents."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dc2g_jax._src.figures.results_figures import PAGE_WIDTH, plain_axes, save_figure
from dc2g_jax._src.training.sweeps import Sweep

_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = ("o", "^", "s", "D", "v", "P", "X")
_LINES = ("-", "--", "-.", ":")


def draw_band(axes: Axes, steps: Int[np.ndarray, "n"], curves: Float[np.ndarray, "runs n"], **style: Any) -> None:
    """Draw the mean of several runs as a curve, with one standard deviation as a band.

    Args:
      axes: axes to draw on.
      steps: training steps.
      curves: one row per run.
      style: matplotlib's properties of the curve.
    """
    mean, deviation = curves.mean(axis=0), curves.std(axis=0)
    (line,) = axes.plot(steps, mean, linewidth=1.7, **style)
    axes.fill_between(steps, mean - deviation, mean + deviation, color=line.get_color(), alpha=0.17, linewidth=0)


def plot_sweep(sweep: Sweep, path: str | Path) -> list[Path]:
    """Draw a sweep: validation errors over training steps, and extra steps of planners with the networks.

    Each kind of run has a curve, the mean over its seeds, with a band of one standard deviation. A second panel shows
    the extra steps of each run as a point, with the mean of each kind.

    Args:
      sweep: the result of `sweep`.
      path: output path without ending; PNG, SVG and PDF are written.

    Returns:
      The files written.
    """
    kinds, episodes = sweep.kinds(), "mean_extra" in sweep.table[0]
    figure = Figure(figsize=(PAGE_WIDTH, 3.4 + 0.17 * len(kinds)), layout="constrained")
    errors, *planner = figure.subplots(1, 1 + episodes, squeeze=False, width_ratios=(1.5, 1)[: 1 + episodes])[0]
    for number, (kind, runs) in enumerate(kinds.items()):
        color, marker = _COLORS[number % len(_COLORS)], _MARKERS[number % len(_MARKERS)]
        style = {"color": color, "marker": marker, "linestyle": _LINES[number % len(_LINES)]}
        draw_band(errors, sweep.steps, sweep.curves[runs], markersize=4, label=kind, **style)
        for axes in planner:
            extra = [sweep.table[run]["mean_extra"] for run in runs]
            axes.plot(extra, [number] * len(extra), marker, color=color, markersize=5, alpha=0.7)
            axes.vlines(float(np.mean(extra)), number - 0.35, number + 0.35, color=color, linewidth=2)
    errors.set_xlim(0, None)
    errors.set_xlabel("training steps", fontsize=9)
    errors.set_ylabel("validation error (cells)", fontsize=9)
    for axes in planner:
        axes.set_ylim(len(kinds) - 0.4, -0.6)
        axes.set_yticks([])
        axes.set_xlabel("extra steps in validation houses (%)\nlines: means", fontsize=9)
    for axes in (errors, *planner):
        plain_axes(axes)
    figure.legend(loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    figure.supxlabel(sweep.data, fontsize=8, color="#555555")
    return save_figure(figure, path)


def save_learning_curve(
    path: str | Path,
    steps: Int[np.ndarray, "n"],
    episode_steps: Float[np.ndarray, "n"],
    success: Float[np.ndarray, "n"],
) -> list[Path]:
    """Write how an agent learns to reach the goal sooner, as a table and as a figure.

    Args:
      path: output path without ending.
      steps: steps that the agent has learned from.
      episode_steps: mean steps of the episodes that ended around then; NaN where too few did.
      success: share of these episodes that reached the goal; NaN where too few ended.

    Returns:
      The files written: the table as CSV, and the figure.
    """
    table = Path(f"{path}.csv")
    rows = np.column_stack([steps, episode_steps, success])
    np.savetxt(table, rows, ("%d", "%.3f", "%.4f"), ",", header="steps,steps_per_episode,success", comments="")
    figure = Figure(figsize=(PAGE_WIDTH, 2.4), layout="constrained")
    curves = {"steps per episode": (episode_steps, None), "success (%)": (100 * success, 100)}
    for axes, (name, (curve, top)) in zip(figure.subplots(1, 2), curves.items(), strict=True):
        axes.plot(steps, curve, color=_COLORS[0], linewidth=1.7)
        axes.set_xlim(0, None)
        axes.set_ylim(0, top)
        axes.set_xlabel("steps learned from", fontsize=9)
        axes.set_ylabel(name, fontsize=9)
        plain_axes(axes)
    return [table, *save_figure(figure, path)]
