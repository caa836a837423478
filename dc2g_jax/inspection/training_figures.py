"""Figures of training: how validation went, a curve for each kind of run."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dc2g_jax.inspection.figures import save_figure

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_LINES = ("-", "--", "-.", ":")


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
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    axes = figure.subplots()
    for number, (kind, logs) in enumerate(runs.items()):
        colour, line = _COLOURS[number % len(_COLOURS)], _LINES[number // len(_COLOURS) % len(_LINES)]
        steps = np.array(sorted(logs[0]))
        curves = np.array([[log[step] for step in steps] for log in logs])
        mean, deviation = curves.mean(axis=0), curves.std(axis=0)
        axes.plot(steps, mean, color=colour, linestyle=line, marker="o", markersize=3, linewidth=1.6, label=kind)
        axes.fill_between(steps, mean - deviation, mean + deviation, color=colour, alpha=0.15, linewidth=0)
    axes.set_xlabel("training steps")
    axes.set_ylabel("validation error (cells)")
    axes.grid(True, color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    figure.supxlabel(caption, fontsize=8, color="#555555")
    return save_figure(figure, path)
