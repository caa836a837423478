"""The figure of a map: its classes, the ground that leads to a goal, and the exact cost-to-go."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from dc2g_jax._src.figures._sheets import cell_rim
from dc2g_jax._src.figures.results_figures import class_patch, present_classes, save_figure
from dc2g_jax._src.files.class_images import Palette
from dc2g_jax._src.grid.ground import connected_to_goal, goals_without_ground, pieces
from dc2g_jax._src.grid.terrain import FIGURE_COLORS, FRONT_DOOR, TRAVERSABLE

_LEADING, _ISLAND, _BLOCKED, _GRAY = "#bfe0f2", "#e69f00", "#5b606b", "#444444"
_MARKER: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black", "markeredgewidth": 0.8, "clip_on": False}
_GOAL: dict[str, Any] = {"marker": "*", "color": "#f0e442", "markersize": 12, **_MARKER}
_LOST_GOAL: dict[str, Any] = {"marker": "X", "color": "white", "markersize": 9, **_MARKER}

#: Number of islands, the largest first, that are labeled with their size.
_LABELED_ISLANDS = 6

#: Aspect ratio from which on panels are stacked vertically.
_WIDE = 2.0

#: Inches: longer side of a panel, beside others and stacked; its least width; space around it; a line of its legend.
_PANEL_SIDE, _WIDE_PANEL_SIDE, _LEAST_WIDTH, _AROUND, _LINE = 4.4, 7.0, 3.7, (0.8, 1.1), 0.19

_LEGEND_COLUMNS = 3


def plot_map(
    path: str | Path,
    title: str,
    terrain: UInt8[np.ndarray, "h w"],
    cost_to_go: Float[np.ndarray, "h w"],
    palette: Palette | None = None,
) -> None:
    """Draw a map's classes, the ground that leads to a goal, and the distance to the goal.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      title: description of the map.
      terrain: class indices.
      cost_to_go: exact cost-to-go; shown on ground that is connected to a goal.
      palette: colors of classes; the figures' colors for classes without one.
    """
    height, width = terrain.shape
    rows, columns = (3, 1) if width > _WIDE * height else (1, 3)
    scale = (_PANEL_SIDE if columns == 3 else _WIDE_PANEL_SIDE) / max(width, height)
    lines = max(-(-len(np.unique(terrain)) // _LEGEND_COLUMNS), 3)
    panel = max(scale * width, _LEAST_WIDTH) + _AROUND[0], scale * height + _AROUND[1] + _LINE * lines
    figure = Figure(figsize=(columns * panel[0], rows * panel[1] + 0.6), layout="constrained")
    figure.suptitle(title, fontsize=12, x=0.02, ha="left")
    panels = figure.subplots(rows, columns).ravel()
    for axes in panels:
        axes.set_anchor("N")
        axes.set_xlabel("column", fontsize=8.5, color=_GRAY)
        axes.set_ylabel("row", fontsize=8.5, color=_GRAY)
        axes.tick_params(labelsize=8, color="#999999", labelcolor=_GRAY)
        axes.spines[:].set_color("#999999")
    _draw_classes(panels[0], terrain, palette)
    _draw_ground(panels[1], terrain)
    _draw_distance(panels[2], terrain, cost_to_go)
    save_figure(figure, path)


def _show(axes: Axes, colors: list[str], numbers: Int[np.ndarray, "h w"] | UInt8[np.ndarray, "h w"]) -> None:
    axes.imshow(np.array([to_rgb(color) for color in colors])[numbers], interpolation="nearest")


def _legend(axes: Axes, handles: list[Any]) -> None:
    axes.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.6, ncols=_LEGEND_COLUMNS,
        frameon=False, fontsize=8.5, handlelength=1.3, columnspacing=1.2,
    )  # fmt: skip


def _draw_classes(axes: Axes, terrain: UInt8[np.ndarray, "h w"], palette: Palette | None) -> None:
    own = {} if palette is None else palette.color_of_class()
    colors = [
        "#{:02x}{:02x}{:02x}".format(*own[index]) if index in own else color
        for index, color in enumerate(FIGURE_COLORS.values())
    ]
    _show(axes, colors, terrain)
    _legend(axes, [class_patch(index, colors[index]) for index in present_classes(terrain)])
    _draw_goals(axes, terrain)
    axes.set_title("what is where", fontsize=10)


def _draw_ground(axes: Axes, terrain: UInt8[np.ndarray, "h w"]) -> None:
    leading = connected_to_goal(terrain)
    islands = TRAVERSABLE[terrain] & ~leading
    _show(axes, [_BLOCKED, _LEADING, _ISLAND], leading + 2 * islands)
    for island in pieces(islands)[:_LABELED_ISLANDS]:
        axes.text(
            island.x, island.y, f"{island.cells:,}", ha="center", va="center", fontsize=8,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )  # fmt: skip
    keys = (
        ("leads to a goal", _LEADING, leading),
        ("leads to none (cells)", _ISLAND, islands),
        ("not traversable", _BLOCKED, ~TRAVERSABLE[terrain]),
    )
    handles: list[Any] = [Patch(facecolor=color, label=label) for label, color, cells in keys if np.any(cells)]
    _legend(axes, handles + _draw_goals(axes, terrain))
    axes.set_title("where a robot can go", fontsize=10)


def _draw_goals(axes: Axes, terrain: UInt8[np.ndarray, "h w"]) -> list[Line2D]:
    """Mark the goals, with one mark per door. Returns their legend entries."""

    def draw(goals: Bool[np.ndarray, "h w"], style: dict[str, Any], label: str) -> list[Line2D]:
        places = pieces(goals)
        return axes.plot([p.x for p in places], [p.y for p in places], label=label, **style) if places else []

    lost = goals_without_ground(terrain)
    return draw((terrain == FRONT_DOOR) & ~lost, _GOAL, "goal") + draw(lost, _LOST_GOAL, "goal out of reach")


def _draw_distance(axes: Axes, terrain: UInt8[np.ndarray, "h w"], cost_to_go: Float[np.ndarray, "h w"]) -> None:
    leading = connected_to_goal(terrain) & ~goals_without_ground(terrain)
    axes.set_facecolor("#e6e6e6")
    axes.set_title("exact cost-to-go", fontsize=10)
    image = axes.imshow(np.where(leading, cost_to_go, np.nan), cmap="viridis_r", vmin=0, interpolation="nearest")
    # In grayscale, ground near a goal looks like unreachable ground: a line separates them.
    axes.add_collection(LineCollection(cell_rim(leading), colors=_GRAY, linewidths=0.5), autolim=False)
    _draw_goals(axes, terrain)
    if not np.any(leading):
        axes.text(0.5, 0.5, "no path to a goal", transform=axes.transAxes, ha="center", va="center", fontsize=10)
        return
    bar = axes.figure.colorbar(image, ax=axes, orientation="horizontal", shrink=0.7, aspect=30, panchor=False)
    bar.outline.set_edgecolor("#999999")
    bar.set_label("cells to the nearest goal", fontsize=8.5, color=_GRAY)
    bar.ax.tick_params(labelsize=8, color="#999999", labelcolor=_GRAY)
