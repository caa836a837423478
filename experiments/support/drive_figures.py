"""Figures of the drive from camera to door: images, maps, predictions and paths, and the effect of noise."""

from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.path import Path

from dc2g_jax._src.figures._sheets import spread
from dc2g_jax._src.figures.costs import BLOCKED_COLOR, COST_COLORS, UNSEEN_COLOR, cost_image, end_of_colors
from dc2g_jax._src.figures.results_figures import (
    class_patch,
    legend_patch,
    map_image,
    plain_axes,
    present_classes,
    save_figure,
)
from dc2g_jax._src.grid.terrain import CLASS_NAMES, TRAVERSABLE, UNKNOWN
from experiments.driving.fleet import Moment

#: Network -> label, color, line and marker.
_NETWORKS = {
    "clean": ("network trained on clean maps", "#0072b2", "-", "o"),
    "noisy": ("network trained with mapping noise", "#d55e00", "--", "s"),
}

#: The robot, facing along +x.
ROBOT_ARROW = Path([(1, 0), (-0.8, 0.65), (-0.4, 0), (-0.8, -0.65), (1, 0)], closed=True)


def plot_noise(
    path: str | FilePath, levels: Sequence[float], results: Mapping[str, Mapping[str, float]], caption: str
) -> None:
    """Draw extra time and success over the level of noise, with one curve per network.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      levels: levels of noise.
      results: `trained NETWORK, noise LEVEL` and `gridworld, SETTINGS` -> results, as in `experiments.noisy_mapping`.
      caption: description of drives and houses.
    """
    figure = Figure(figsize=(7.5, 3.4), layout="constrained")
    extra_axes, success_axes = figure.subplots(1, 2)
    for network, (label, color, line, marker) in _NETWORKS.items():
        of_levels = [results.get(f"trained {network}, noise {level:g}") for level in levels]
        rows = [row for row in of_levels if row is not None]
        if not rows:
            continue
        style = {"color": color, "linestyle": line, "marker": marker, "markersize": 5, "label": label}
        extra_axes.plot(levels, [row["extra"] for row in rows], **style)
        low, high = ([row[f"extra_{end}"] for row in rows] for end in ("low", "high"))
        extra_axes.fill_between(levels, low, high, color=color, alpha=0.17, linewidth=0)
        success_axes.plot(levels, [100 * row["success"] for row in rows], **style)
    if occluded := results.get("gridworld, occluded"):
        extra_axes.axhline(occluded["extra"], color="#555555", linestyle=":", label="gridworld, with occlusion")
    extra_axes.set_ylabel("extra time (%)")
    extra_axes.set_ylim(bottom=0)
    success_axes.set_ylabel("success (%)")
    success_axes.set_ylim(0, 103)
    for axes in (extra_axes, success_axes):
        axes.set_xlabel("noise (1: as the paper's may have been)")
        plain_axes(axes)
    extra_axes.legend(frameon=False, fontsize=8)
    figure.supxlabel(caption, fontsize=8, color="#555555")
    save_figure(figure, path)


def plot_moments(path: str | FilePath, drive: Sequence[Moment], rows: int, cell_size: float) -> None:
    """Draw moments of a drive (Fig. 9): the camera image, the map, the predicted cost-to-go, and the planned path.

    The map is the robot's own. Its path, its planned path and the robot are drawn at their estimated positions.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      drive: moments of the drive, in order.
      rows: number of moments to show, evenly spaced, including the first and the last.
      cell_size: side of a cell, meters.
    """
    numbers = spread(len(drive) - 1, rows)
    chosen: list[Any] = [drive[number] for number in numbers]
    way = _in_cells([moment.believed.position for moment in drive], cell_size)
    height, width = chosen[0].robot.terrain.shape
    figure = Figure(figsize=(10.5, 2.5 * len(chosen) + 0.9), layout="constrained")
    panels = figure.subplots(len(chosen), 4, squeeze=False, width_ratios=(1.3, 1, 1, 1))
    high = end_of_colors(
        [moment.cost_to_go[TRAVERSABLE[moment.robot.terrain]] for moment in chosen if moment.cost_to_go is not None]
    )
    for row, (number, moment) in enumerate(zip(numbers, chosen, strict=True)):
        view, semantic, expected, planned = panels[row]
        view.imshow(moment.picture, aspect="equal")
        view.set_ylabel(f"{moment.seconds:.0f} s", fontsize=8)
        ground = TRAVERSABLE[moment.robot.terrain]
        seen = moment.robot.terrain != UNKNOWN
        semantic.imshow(map_image(moment.robot.terrain, np.ones_like(seen)), interpolation="nearest")
        if moment.cost_to_go is not None:
            image = cost_image(moment.cost_to_go / high, ground, seen & ~ground)
            expected.imshow(image, interpolation="nearest")
        planned.imshow(map_image(moment.robot.terrain, ground), interpolation="nearest")
        planned.plot(*way[: number + 1].T, color="black", linewidth=1)
        planned.plot(*_in_cells(moment.robot.path.points, cell_size).T, color="#0072b2", linewidth=2)
        arrow = MarkerStyle(ROBOT_ARROW).rotated(rad=float(moment.believed.yaw))
        for axes in (semantic, expected, planned):
            axes.plot(*way[number], marker=arrow, color="black", markeredgecolor="white", markersize=10)
            axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    for axes, name in zip(panels[0], ("camera", "semantic map", "predicted cost-to-go", "planned path"), strict=True):
        axes.set_title(name, fontsize=9)
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
    scale = ScalarMappable(Normalize(0, high), COST_COLORS)
    figure.colorbar(
        scale, ax=panels[:, 2], location="bottom", label="cost-to-go (cells)", shrink=0.9, extend="max", aspect=30
    )
    classes = present_classes(np.stack([moment.robot.terrain for moment in chosen]))
    # The robot's own cell is ground without class until it has been observed.
    entries: list[Any] = [class_patch(index) for index in classes if CLASS_NAMES[index] != "traversable"]
    entries += [legend_patch("nothing predicted", UNSEEN_COLOR), legend_patch("not traversable", BLOCKED_COLOR)]
    for label, color in (("driven", "black"), ("planned", "#0072b2")):
        entries.append(Line2D([], [], color=color, linewidth=2, label=label))
    figure.legend(handles=entries, loc="outside lower center", ncols=8, fontsize=7, frameon=False)
    save_figure(figure, path)


def _in_cells(positions: Any, cell_size: float) -> Float[np.ndarray, "n 2"]:
    """Coordinates of positions on the image of a map, in cells."""
    return np.asarray(positions, float)[:, :2] * (1, -1) / cell_size - 0.5
