"""The figure of an object search, and its animation: moments on the true map, the robot's map and its costs."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt32
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.markers import MarkerStyle
from matplotlib.patches import Patch

from dc2g_jax._src.figures._sheets import DPI, FONT, cell_rim
from dc2g_jax._src.figures._video import Picture
from dc2g_jax._src.figures.animation import write_animation
from dc2g_jax._src.figures.costs import end_of_colors
from dc2g_jax._src.figures.results_figures import PAGE_WIDTH, save_figure
from dc2g_jax.indoor.houses.worlds import IndoorWorld
from dc2g_jax.indoor.maps.classes import NO_OBJECT, OBJECT_CLASSES, OBJECT_COLORS, SEMANTIC_CLASSES
from dc2g_jax.indoor.maps.cost_maps import Cells
from dc2g_jax.indoor.maps.mapping import EXPLORED_CHANNEL, OBSTACLE_CHANNEL
from experiments.support.drive_figures import ROBOT_ARROW

#: Low costs are green and high costs red, as in the paper. Brightness decreases too, so they also differ in grayscale.
_COSTS = LinearSegmentedColormap.from_list("costs", ["#a8e6a1", "#f5e663", "#f4a13a", "#d3411e", "#7d0d12"])

_FLOOR, _WALL, PATH_COLOR, ROBOT_COLOR, TARGET_COLOR, _PLANS = (
    "#d9d9d9",
    "#4d4d57",
    "#0000ff",
    "#e8000b",
    "#d400a8",
    "#0026c8",
)

#: Space beside the panels, and above and below them, inches; margin around the house, meters.
_BESIDE, _AROUND, _MARGIN = 0.55, 1.35, 0.3

#: Pixels of an animation: longer side of a panel, and space above the panels; and pixels per inch.
_ROOM, _TITLES, _SCREEN_DPI = 380, 46, 110

ROWS = ("true map", "robot's map", "cost map")


class SearchMoment(NamedTuple):
    """The state of a search between an observation and the next action.

    Attributes:
      step: control periods since the start.
      doing: current activity in words.
      cells: the robot's map, see `indoor.maps.mapping.IndoorMap`.
      origin: row and column of the map's first cell in the world's grid.
      costs: costs around the robot, meters; infinite where it must not be.
      corner: row and column of the first cell of the costs in the world's grid.
      plans: x and y of the vehicle along each sampled plan of the controller, meters; empty without plans.
    """

    step: int
    doing: str
    cells: UInt32[np.ndarray, "h w"]
    origin: Int[np.ndarray, "2"]
    costs: Float[np.ndarray, "n n"]
    corner: Int[np.ndarray, "2"]
    plans: Float[np.ndarray, "k t 2"]


@dataclasses.dataclass(frozen=True)
class RecordedSearch:
    """A search for an object, with the moments to show.

    Attributes:
      world: the house.
      target: class index of the wanted object.
      track: the robot's track, see `indoor.search.searches.IndoorRobot`, from step 0 on.
      moments: moments of the search in order, at least one.
    """

    world: IndoorWorld
    target: int
    track: Float[np.ndarray, "time 5"]
    moments: Sequence[SearchMoment]

    @property
    def size(self) -> float:
        """Side of a cell, meters."""
        return float(self.world.cell_size)

    @property
    def wanted(self) -> Bool[np.ndarray, "h w"]:
        """Cells of the wanted object."""
        return np.asarray(self.world.classes) == self.target

    @functools.cached_property
    def rim(self) -> Float[np.ndarray, "lines 2 2"]:
        """Lines around the wanted object, one cell away from it: x and y of both ends, meters."""
        around = cv2.dilate(np.pad(self.wanted, 2).astype(np.uint8), np.ones((3, 3))) > 0
        return (np.array(cell_rim(around)) - 1.5) * (self.size, -self.size)

    @functools.cached_property
    def true_map(self) -> UInt8[np.ndarray, "h w 3"]:
        """Colors of the house."""
        return map_image(*(np.asarray(cells) for cells in (self.world.classes, self.world.free, self.world.walls)))

    @functools.cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """Smallest and largest x, then y, of the house with its margin, meters."""
        rows, columns = np.nonzero(np.asarray(self.world.free | self.world.obstacle))
        x, y = (columns.min(), columns.max() + 1), (-rows.max() - 1, -rows.min())
        left, right, bottom, top = (float(edge * self.size) for edge in (*x, *y))
        return left - _MARGIN, right + _MARGIN, bottom - _MARGIN, top + _MARGIN

    @functools.cached_property
    def highest(self) -> float:
        """The cost at the end of the colors, meters: nearly all costs in the panels are lower."""
        left, right, bottom, top = self.extent
        shown = []
        for moment in self.moments:
            y, x = (
                sign * (first + np.arange(len(moment.costs)) + 0.5) * self.size
                for sign, first in zip((-1, 1), moment.corner, strict=True)
            )
            inside = ((y > bottom) & (y < top))[:, None] & (x > left) & (x < right)
            shown.append(moment.costs[inside & np.isfinite(moment.costs)])
        return end_of_colors(shown)


class PredictedMap(NamedTuple):
    """A network's prediction for a robot's local map, and the truth.

    Attributes:
      cells: the robot's map, see `indoor.maps.mapping.IndoorMap`.
      occupied: cells predicted to be occupied.
      truly_occupied: cells that are not free floor.
      cost: predicted cost, meters beyond that of the best cell; infinite where predicted to be occupied.
      true_cost: the same in truth; infinite where the robot does not fit and where no path leads to the goal.
    """

    cells: UInt32[Cells, "n n"]
    occupied: Bool[Cells, "n n"]
    truly_occupied: Bool[Cells, "n n"]
    cost: Float[Cells, "n n"]
    true_cost: Float[Cells, "n n"]


def plot_search(path: str | Path, search: RecordedSearch) -> None:
    """Draw moments of a search (Fig. 5 of the paper on dense cost maps), one per column.

    The rows show the true map with the path so far, the robot's map, and the costs of the controller with its sampled
    plans.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      search: the search, with the moments to show.
    """
    moments, (left, right, bottom, top) = search.moments, search.extent
    panel = (PAGE_WIDTH - _BESIDE) / len(moments)
    height = 3 * min(panel, 2.2) * (top - bottom) / (right - left) + _AROUND
    figure = Figure(figsize=(PAGE_WIDTH, height), layout=ConstrainedLayoutEngine(w_pad=0.02, h_pad=0.02))
    panels = figure.subplots(3, len(moments), squeeze=False, sharex=True, sharey=True)
    for column, moment in zip(panels.T, moments, strict=True):
        column[0].set_title(f"step {moment.step}\n{moment.doing}", fontsize=FONT, pad=3)
        _draw(column, search, moment)
    for axes, name in zip(panels[:, 0], ROWS, strict=True):
        axes.set_ylabel(name, fontsize=FONT)
    _cost_bar(figure, search.highest, panels[2], aspect=45, shrink=0.5)
    figure.legend(
        handles=_legend(np.asarray(search.world.classes), search.target), loc="outside lower center", ncols=7,
        fontsize=FONT, frameon=False, handlelength=1.3, columnspacing=1.3,
    )  # fmt: skip
    save_figure(figure, path, DPI)


def _draw(panels: Iterable[Axes], search: RecordedSearch, moment: SearchMoment) -> None:
    """Draw a moment of a search on three panels, those of `ROWS`."""
    true, own, costs = panels
    track, size, (left, right, bottom, top) = search.track, search.size, search.extent
    x, y, yaw = (float(value) for value in track[moment.step, :3])
    _show(true, search.true_map, (0, 0), size)
    rim = LineCollection(list(search.rim), colors=TARGET_COLOR, linewidths=0.9, capstyle="projecting")
    true.add_collection(rim)
    true.plot(*track[: moment.step + 1, :2].T, color=PATH_COLOR, linewidth=1.3)
    _show(own, robots_map(moment.cells), moment.origin, size)
    _show(costs, cost_image(moment.costs, search.highest), moment.corner, size)
    costs.add_collection(LineCollection(list(moment.plans), colors=_PLANS, linewidths=0.3, alpha=0.35))
    arrow = MarkerStyle(ROBOT_ARROW).rotated(rad=yaw)
    for axes in (true, own, costs):
        axes.plot(x, y, marker=arrow, color=ROBOT_COLOR, markeredgecolor="white", markeredgewidth=0.4, markersize=6.5)
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[])
        axes.spines[:].set(color="#888888", linewidth=0.5)


def search_pictures(search: RecordedSearch, numbers: Iterable[int]) -> Iterator[Picture]:
    """Pictures of some moments of a search: RGB, of equal size, with an even width and height."""
    left, right, bottom, top = search.extent
    scale = _ROOM / max(right - left, top - bottom)
    width, height = (2 * round(length / 2) for length in (3 * scale * (right - left), scale * (top - bottom) + _TITLES))
    figure = Figure(figsize=(width / _SCREEN_DPI, height / _SCREEN_DPI), dpi=_SCREEN_DPI)
    canvas = FigureCanvasAgg(figure)
    for number in numbers:
        moment = search.moments[number]
        figure.clear()
        panels = figure.subplots(1, 3, gridspec_kw={
            "left": 0.01, "right": 0.99, "bottom": 0.01, "top": 1 - _TITLES / height, "wspace": 0.03
        })  # fmt: skip
        _draw(panels, search, moment)
        lines = (f"step {moment.step}: {moment.doing}", f"target: {OBJECT_CLASSES[search.target]}", "")
        for axes, name, line in zip(panels, ROWS, lines, strict=True):
            axes.set_title(f"{name}\n{line}", fontsize=FONT)
        canvas.draw()
        yield np.array(canvas.buffer_rgba())[..., :3]


def animate_search(path: str | Path, search: RecordedSearch) -> None:
    """Write an animation of a search, see `search_pictures`, as `write_animation` does."""
    paint = functools.partial(search_pictures, search)
    write_animation(path, paint, len(search.moments), (ROBOT_COLOR, TARGET_COLOR, PATH_COLOR), 8)


def plot_prediction(path: str | Path, found: PredictedMap, title: str) -> None:
    """Draw a prediction (Fig. 4 of the paper on dense cost maps): map, occupancy and costs, next to the truth.

    Args:
      path: output path without ending; PNG, SVG and PDF are written.
      found: prediction and truth.
      title: of the figure.
    """
    cells, occupied, truly_occupied, cost, true_cost = (np.asarray(leaf) for leaf in found)
    figure = Figure(figsize=(PAGE_WIDTH, 4.0), layout="constrained")
    panels = figure.subplot_mosaic("mop;mct", width_ratios=(2, 1, 1))
    high = float(np.max(true_cost, initial=1.0, where=np.isfinite(true_cost)))
    no_class = np.zeros(cells.shape, np.uint8)
    images = {
        "robot's map": robots_map(cells),
        "predicted occupancy": map_image(no_class, ~occupied, occupied),
        "true occupancy": map_image(no_class, ~truly_occupied, truly_occupied),
        "predicted cost": cost_image(cost, high),
        "true cost": cost_image(true_cost, high),
    }
    for axes, (name, image) in zip(panels.values(), images.items(), strict=True):
        axes.imshow(image, interpolation="nearest")
        axes.set_title(name, fontsize=FONT, pad=3)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color="#888888", linewidth=0.5)
    panels["m"].plot(*(len(no_class) // 2,) * 2, "o", color=ROBOT_COLOR, markersize=4)
    _cost_bar(figure, high, [panels["c"], panels["t"]])
    figure.suptitle(title, fontsize=FONT)
    save_figure(figure, path, DPI)


def cost_image(costs: Float[np.ndarray, "h w"], high: float) -> Float[np.ndarray, "h w 4"]:
    """Colors of costs up to `high`; transparent where infinite."""
    return _COSTS(costs / high) * np.isfinite(costs)[..., None]


def _cost_bar(figure: Figure, high: float, panels: Any, **options: Any) -> None:
    """The scale of costs, below panels."""
    scale = ScalarMappable(Normalize(0, high), _COSTS)
    bar = figure.colorbar(scale, ax=panels, location="bottom", fraction=0.05, pad=0.03, extend="max", **options)
    bar.set_label("cost (m)", fontsize=FONT, labelpad=1)
    bar.ax.tick_params(labelsize=FONT, length=2, pad=1.5)
    bar.outline.set_linewidth(0.5)  # type: ignore[operator]


def robots_map(cells: UInt32[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w 3"]:
    """Colors of a robot's map. A cell with several classes shows the first one, so goals take precedence."""
    bits = (cells[..., None] >> np.arange(EXPLORED_CHANNEL + 1, dtype=np.uint32)) & 1 == 1
    own = bits[..., :SEMANTIC_CLASSES]
    classes = np.where(own.any(axis=-1), own.argmax(axis=-1) + 1, NO_OBJECT)
    return map_image(classes, bits[..., EXPLORED_CHANNEL], bits[..., OBSTACLE_CHANNEL])


def map_image(
    classes: Int[np.ndarray, "h w"] | UInt8[np.ndarray, "h w"], floor: Bool[np.ndarray, "h w"],
    walls: Bool[np.ndarray, "h w"],
) -> UInt8[np.ndarray, "h w 3"]:  # fmt: skip
    """Colors of a map: the color of the class if a cell has one, else dark walls, gray floor, and white elsewhere."""
    floor_color, wall_color = (np.round(255 * np.array(to_rgb(color))).astype(np.uint8) for color in (_FLOOR, _WALL))
    bare = np.where(walls[..., None], wall_color, np.where(floor[..., None], floor_color, OBJECT_COLORS[NO_OBJECT]))
    return np.where((classes != NO_OBJECT)[..., None], OBJECT_COLORS[classes], bare)


def _show(axes: Axes, image: np.ndarray, first: Sequence[int] | Int[np.ndarray, "2"], size: float) -> None:
    """Show an image of cells at their position in the world; `first` is row and column of the first cell."""
    (row, column), (height, width) = (int(number) for number in first), image.shape[:2]
    extent = (column * size, (column + width) * size, -(row + height) * size, -row * size)
    axes.imshow(image, extent=extent, interpolation="nearest")


def _legend(classes: UInt8[np.ndarray, "h w"], target: int) -> list[Any]:
    """The entries of the legend: the classes that occur in the house, lines and marks."""
    found = [int(index) for index in np.unique(classes) if index not in (NO_OBJECT, target)]
    patches = [
        (f"target: {OBJECT_CLASSES[target]}", OBJECT_COLORS[target] / 255, TARGET_COLOR, 1.4),
        *((OBJECT_CLASSES[index], OBJECT_COLORS[index] / 255, "#777777", 0.4) for index in found),
        ("wall, obstacle", _WALL, "#777777", 0.4),
        ("free floor", _FLOOR, "#777777", 0.4),
        ("unexplored", "white", "#777777", 0.4),
    ]
    lines = (("path so far", PATH_COLOR, 1.5), ("sampled plans", _PLANS, 0.5))
    return [
        *(Patch(facecolor=face, edgecolor=edge, linewidth=width, label=name) for name, face, edge, width in patches),
        *(Line2D([], [], color=color, linewidth=width, label=name) for name, color, width in lines),
        Line2D([], [], color=ROBOT_COLOR, marker=MarkerStyle(ROBOT_ARROW), markeredgecolor="white", markeredgewidth=0.4,
               markersize=6.5, linestyle="", label="robot"),
    ]  # fmt: skip
