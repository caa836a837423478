"""Figures of episodes: what robots knew and expected on their way (the paper's Fig. 8), and their whole ways."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dc2g_jax.datasets.houses import House
from dc2g_jax.estimation.estimators import world_cost_to_go
from dc2g_jax.evaluation import EpisodeResult
from dc2g_jax.grid.ground import pieces
from dc2g_jax.grid.poses import Pose, make_pose, moved
from dc2g_jax.grid.terrain import CLASS_NAMES, FRONT_DOOR, TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.figures import class_patch, map_image, planner_style, save_figure, whole_pixels
from dc2g_jax.inspection.replay import Frames, actions_from_letters, running_extra_steps
from dc2g_jax.planning.planners import EXPLORE, GAVE_UP, TO_GOAL

#: Inches: the width of a page's two columns, and the largest height of a panel; the space left of the panels, between
#: them, above them for titles, for the colour bars and a line of the legend. And pixels by the inch.
_WIDTH, _TALLEST = 7.16, 2.2
_LEFT, _GAP, _TITLE, _BARS, _LINE = 0.3, 0.06, 0.17, 0.48, 0.15
_DPI = 300

#: Inches that an entry of the legend takes.
_ENTRY = 0.86

_FONT, _SMALL = 7.5, 6.8
_GREY = "#444444"

#: Colours of the cost-to-go, from the goal on, and of the way, from its start on; both ends of each differ in grey.
COST_COLOURS, _WAY_COLOURS = "viridis_r", "plasma"

#: Where there is no cost-to-go to show: not observed, and observed but not traversable.
UNSEEN_COLOUR, BLOCKED_COLOUR = "#ffffff", "#ececf1"

_EDGE: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black"}
_START: dict[str, Any] = {"marker": "o", "color": "white", "markersize": 3.6, "markeredgewidth": 0.8, **_EDGE}
_ROBOT: dict[str, Any] = {"color": "#f0e442", "markersize": 6, "markeredgewidth": 0.7, **_EDGE}
_GOAL: dict[str, Any] = {"marker": "*", "color": "white", "markersize": 5.5, "markeredgewidth": 0.6, **_EDGE}
_SUBGOAL: dict[str, Any] = {"marker": "X", "color": "#ff6ec7", "markersize": 5, "markeredgewidth": 0.6, **_EDGE}
_LINE_STYLE: dict[str, Any] = {"solid_joinstyle": "round", "scalex": False, "scaley": False}
_HEADING_MARKERS = ">v<^"

#: Points that a cell's side has where lines and marks have the sizes above.
_USUAL_CELL = 1.68


class _Sheet(NamedTuple):
    """A figure of panels that all show a map, placed to the pixel so that every cell has the same size.

    Attributes:
      figure: the figure.
      width: of a panel, in inches.
      height: of a panel, in inches.
      rows: rows of panels.
    """

    figure: Figure
    width: float
    height: float
    rows: int

    def panel(self, row: int, column: int, title: str = "") -> Axes:
        """The panel in a row and a column."""
        x = _LEFT + column * (self.width + _GAP)
        y = _TITLE + row * (self.height + _TITLE)
        axes = self._axes(x, y, self.width, self.height)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.set_title(title, fontsize=_FONT, pad=2)
        for spine in axes.spines.values():
            spine.set_color("#888888")
            spine.set_linewidth(0.5)
        return axes

    def bar(self, place: float, colours: ScalarMappable, title: str, **options: Any) -> None:
        """A colour bar below the panels, in the left half of the page (`place` 0) or in the right one (1)."""
        width = float(self.figure.get_figwidth())
        length = min(2.2, 0.38 * width)
        x = (0.25 + 0.5 * place) * width - length / 2
        axes = self._axes(x, self.rows * (self.height + _TITLE) + 0.09, length, 0.08)
        bar = self.figure.colorbar(colours, cax=axes, orientation="horizontal", **options)
        bar.outline.set_linewidth(0.5)  # type: ignore[operator]
        axes.tick_params(labelsize=_SMALL, length=2, width=0.5, pad=1.5)
        axes.set_xlabel(title, fontsize=_SMALL, labelpad=1)

    def _axes(self, x: float, y: float, width: float, height: float) -> Axes:
        """Axes at a place in inches from the upper left corner, moved to whole pixels."""
        x, y = round(x * _DPI) / _DPI, round(y * _DPI) / _DPI
        total_width, total_height = self.figure.get_size_inches()
        rectangle = (x / total_width, 1 - (y + height) / total_height, width / total_width, height / total_height)
        return self.figure.add_axes(rectangle)

    def legend(self, entries: Sequence[Any], columns: int) -> None:
        """What colours and marks mean, at the foot of the page."""
        self.figure.legend(
            handles=list(entries), loc="lower center", bbox_to_anchor=(0.5, 0), borderaxespad=0.1, ncols=columns,
            frameon=False, fontsize=_SMALL, handlelength=1.1, handletextpad=0.5, columnspacing=1.2, labelspacing=0.35,
        )  # fmt: skip


def _sheet(shape: tuple[int, ...], rows: int, columns: int, entries: Sequence[Any]) -> _Sheet:
    """An empty sheet for maps of this shape, with its legend."""
    height, width = shape
    room = (_WIDTH - _LEFT - columns * _GAP) / columns
    scale = whole_pixels(min(room / width, _TALLEST / height), _DPI)
    panel_width, panel_height = scale * width, scale * height
    page_width = max(_LEFT + columns * (panel_width + _GAP), 3.5)
    legend_columns = min(len(entries), int(page_width / _ENTRY))
    foot = _BARS + _LINE * -(-len(entries) // legend_columns)
    page_height = rows * (panel_height + _TITLE) + foot
    pixels = np.ceil(np.array([page_width, page_height]) * _DPI)
    sheet = _Sheet(Figure(figsize=tuple(pixels / _DPI)), panel_width, panel_height, rows)
    sheet.legend(entries, legend_columns)
    return sheet


def _entries(terrain: UInt8[np.ndarray, "h w"], *marks: tuple[str, dict[str, Any]]) -> list[Any]:
    """What the legend says: the classes of a map, the largest first, and marks."""
    cells = np.bincount(terrain.ravel(), minlength=len(CLASS_NAMES))
    classes = [class_patch(index) for index in np.argsort(-cells, kind="stable")[: np.count_nonzero(cells)].tolist()]
    return classes + [Line2D([], [], label=label, **style) for label, style in marks]


_START_MARK, _ROBOT_MARK = ("start", _START), ("robot", {"marker": ">", **_ROBOT})
_GOAL_MARK, _SUBGOAL_MARK = ("goal", _GOAL), ("subgoal", _SUBGOAL)


def _name(axes: Axes, planner: str) -> None:
    """A planner's name beside its row."""
    style = planner_style(planner)
    axes.set_ylabel(style.label.replace(", ", ",\n"), fontsize=_FONT, color=style.colour, fontweight="bold", labelpad=3)


def _rim(seen: Bool[np.ndarray, "h w"]) -> list[Any]:
    """The edges between cells that have been seen and cells that have not, each as its two ends."""
    y, x = np.nonzero(seen[:, 1:] != seen[:, :-1])
    upright = np.stack([np.stack([x + 0.5, y - 0.5], -1), np.stack([x + 0.5, y + 0.5], -1)], 1)
    y, x = np.nonzero(seen[1:] != seen[:-1])
    level = np.stack([np.stack([x - 0.5, y + 0.5], -1), np.stack([x + 0.5, y + 0.5], -1)], 1)
    return list(np.concatenate([upright, level]))


def _scaled(axes: Axes, cells: int, style: Mapping[str, Any]) -> dict[str, Any]:
    """Lines and marks for a panel so many cells wide: thinner and smaller where cells are small, and the other way."""
    points = axes.bbox.width * 72 / axes.figure.dpi / cells
    scale = float(np.clip(points / _USUAL_CELL, 0.6, 1.3))
    return {name: value * scale if name in ("linewidth", "markersize") else value for name, value in style.items()}


def _draw_map(axes: Axes, terrain: UInt8[np.ndarray, "h w"], seen: Bool[np.ndarray, "h w"]) -> None:
    """Terrain, pale where not seen, and the goals: one mark a door."""
    axes.imshow(map_image(terrain, seen), interpolation="nearest", aspect="auto")
    axes.add_collection(LineCollection(_rim(seen), colors=_GREY, linewidths=0.5), autolim=False)
    doors = pieces(terrain == FRONT_DOOR)
    axes.plot([door.x for door in doors], [door.y for door in doors], **_scaled(axes, terrain.shape[1], _GOAL))


def _draw_robot(axes: Axes, frames: Frames, frame: int) -> None:
    """The way so far, its start, the subgoal of the plan, and the robot."""
    x, y, width = frames.pose.x[: frame + 1], frames.pose.y[: frame + 1], frames.seen.shape[2]
    for color, thickness in (("white", 2.2), ("black", 1.1)):
        axes.plot(x, y, color=color, **_scaled(axes, width, {"linewidth": thickness, **_LINE_STYLE}))
    axes.plot(x[:1], y[:1], **_scaled(axes, width, _START))
    if frames.mode[frame] == EXPLORE and frame < len(frames) - 1:
        rows, columns = np.nonzero(frames.subgoals[frame].any(axis=0))
        axes.plot(columns[:1], rows[:1], **_scaled(axes, width, _SUBGOAL))
    marker = _HEADING_MARKERS[frames.pose.heading[frame]]
    axes.plot(x[-1:], y[-1:], marker=marker, **_scaled(axes, width, _ROBOT))


def _draw_way(axes: Axes, house: House, way: Pose) -> None:
    """The whole map and a way on it, coloured from its start to its end."""
    _draw_map(axes, house.terrain, np.ones(house.terrain.shape, bool))
    points = np.stack([way.x, way.y], axis=-1).astype(float)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    width = house.terrain.shape[1]
    for color, thickness in (("white", 3.0), ("black", 2.2)):
        axes.plot(*points.T, color=color, **_scaled(axes, width, {"linewidth": thickness, **_LINE_STYLE}))
    colors = colormaps[_WAY_COLOURS](np.linspace(0, 1, len(segments)))
    style = _scaled(axes, width, {"linewidth": 1.3, "capstyle": "round"})
    axes.add_collection(LineCollection(list(segments), colors=colors, **style), autolim=False)
    axes.plot(way.x[:1], way.y[:1], **_scaled(axes, width, _START))
    marker = _HEADING_MARKERS[way.heading[-1]]
    axes.plot(way.x[-1:], way.y[-1:], marker=marker, **_scaled(axes, width, _ROBOT))


def _way_bar(sheet: _Sheet, place: float) -> None:
    colours = ScalarMappable(Normalize(0, 1), _WAY_COLOURS)
    sheet.bar(place, colours, "the way", ticks=[0, 1], format=lambda value, _: ("start", "end")[int(value)])


def _draw_cost(axes: Axes, cost: Float[np.ndarray, "h w"], shown: np.ndarray, blocked: np.ndarray, high: float) -> None:
    """Costs-to-go where they are shown; blocked ground and the rest in greys."""
    colours = colormaps[COST_COLOURS](np.clip(np.where(shown, cost, 0) / high, 0, 1))[..., :3]
    image = np.where(shown[..., None], colours, np.array(to_rgb(UNSEEN_COLOUR)))
    image = np.where(blocked[..., None], np.array(to_rgb(BLOCKED_COLOUR)), image)
    axes.imshow(image, interpolation="nearest", aspect="auto")
    axes.add_collection(LineCollection(_rim(shown | blocked), colors=_GREY, linewidths=0.5), autolim=False)


def outcome(frames: Frames) -> str:
    """What came of an episode."""
    if frames.to_goal[-1] == 0:
        return "at the goal"
    return "gave up" if frames.mode[-1] == GAVE_UP else "step limit"


def moments(frames: Frames, count: int) -> list[int]:
    """Steps that tell an episode: its start, then evenly spaced up to the first plan to the goal, and its end.

    Evenly spaced throughout where the planner knew of the goal at once or never.
    """
    last = len(frames) - 1
    known = np.flatnonzero(frames.mode == TO_GOAL)
    if known.size and 0 < known[0] < last:
        chosen = np.append(np.linspace(0, known[0], count - 1), last)
    else:
        chosen = np.linspace(0, last, count)
    return np.unique(chosen.round().astype(int)).tolist()


def _moment_title(frames: Frames, frame: int) -> str:
    if frame == len(frames) - 1:
        return f"step {frame}: {outcome(frames)}"
    first = frames.mode[frame] == TO_GOAL and frame > 0 and frames.mode[frame - 1] != TO_GOAL
    return f"step {frame}{': goal seen' if first else ''}"


def _cost_scale(house: House, frames_by_planner: Mapping[str, Frames], exact: Float[np.ndarray, "h w"]) -> float:
    """The cost at the end of the colours: nearly all that is shown of what robots had observed lies below."""
    shown = []
    for frames in frames_by_planner.values():
        if frames.cost_to_go is not None:
            ground = frames.seen[-1] & TRAVERSABLE[house.terrain] & np.isfinite(exact)
            shown += [exact[ground], frames.cost_to_go[-1][ground], frames.cost_to_go[0][ground & frames.seen[0]]]
    costs = np.concatenate(shown)
    return max(float(np.percentile(costs, 99)), 1.0) if costs.size else 1.0


def plot_episode(
    path: str | Path, house: House, frames_by_planner: Mapping[str, Frames], columns: int | None = None
) -> list[Path]:
    """Draw planners from one start, as in Fig. 8: what each knew, what it expected, and its way on the whole map.

    A row a planner: the observed map at several moments over the pale hidden one, and last its way on the whole map.
    Below it, for planners that make an estimate, the cost-to-go they expected, and last the exact one.

    Args:
      path: where to write, without an ending.
      house: the house.
      frames_by_planner: planner name -> its replayed episode, all from one start.
      columns: moments shown of each episode, see `moments`; by the shape of the map where `None`.

    Returns:
      The files written: PNG and SVG.
    """
    height, width = house.terrain.shape
    count = columns or (4 if width <= 1.6 * height else 3 if width <= 2.6 * height else 2)
    estimates = sum(frames.cost_to_go is not None for frames in frames_by_planner.values())
    entries = _entries(house.terrain, _START_MARK, _ROBOT_MARK, _SUBGOAL_MARK, _GOAL_MARK)
    sheet = _sheet((height, width), len(frames_by_planner) + estimates, count + 1, entries)
    if estimates:
        exact = np.asarray(jax.jit(world_cost_to_go)(world_from_terrain(house.terrain)))
        high = _cost_scale(house, frames_by_planner, exact)
        sheet.bar(0, ScalarMappable(Normalize(0, high), COST_COLOURS), "cost-to-go (cells)", extend="max")
    _way_bar(sheet, 1 if estimates else 0.5)
    row = 0
    for planner, frames in frames_by_planner.items():
        chosen = moments(frames, count)
        first = [sheet.panel(row, column, _moment_title(frames, frame)) for column, frame in enumerate(chosen)]
        _name(first[0], planner)
        for axes, frame in zip(first, chosen, strict=True):
            _draw_map(axes, house.terrain, frames.seen[frame])
            _draw_robot(axes, frames, frame)
        extra = running_extra_steps(frames)[-1]
        title = f"{extra:.0f} % extra steps" if np.isfinite(extra) else "whole map"
        _draw_way(sheet.panel(row, count, title), house, frames.pose)
        row += 1
        if frames.cost_to_go is not None:
            _draw_costs([sheet.panel(row, column) for column in range(len(chosen))], house, frames, chosen, high)
            ground = TRAVERSABLE[house.terrain]
            _draw_cost(sheet.panel(row, count, "exact"), exact, ground & np.isfinite(exact), ~ground, high)
            row += 1
    return save_figure(sheet.figure, path, dpi=_DPI)


def _draw_costs(panels: Sequence[Axes], house: House, frames: Frames, chosen: Sequence[int], high: float) -> None:
    """What a planner expected at the chosen moments, on the ground that it had seen."""
    panels[0].set_ylabel("predicted\ncost-to-go", fontsize=_FONT, labelpad=3)
    ground = TRAVERSABLE[house.terrain]
    assert frames.cost_to_go is not None
    for axes, frame in zip(panels, chosen, strict=True):
        seen = frames.seen[frame]
        _draw_cost(axes, frames.cost_to_go[frame], seen & ground, seen & ~ground, high)
        _draw_robot(axes, frames, frame)


def poses_along(result: EpisodeResult, house: House) -> Pose:
    """Where the robot was before each action of an episode, and after the last: `[t]`, as NumPy arrays."""
    height, width = house.terrain.shape

    def move(pose: Pose, action: jax.Array) -> tuple[Pose, Pose]:
        after = moved(pose, action, height, width)
        return after, after

    start = make_pose(result.x, result.y, result.heading)
    _, after = jax.lax.scan(move, start, jnp.asarray(actions_from_letters(result.actions), jnp.int32))
    return jax.tree.map(lambda first, rest: np.concatenate([np.asarray(first)[None], np.asarray(rest)]), start, after)


def plot_trajectories(
    path: str | Path, house: House, result_by_planner: Mapping[str, EpisodeResult], columns: int = 3
) -> list[Path]:
    """Draw the ways of planners on the whole map, coloured from start to end, side by side.

    Args:
      path: where to write, without an ending.
      house: the house.
      result_by_planner: planner name -> its episode.
      columns: panels in a row.

    Returns:
      The files written: PNG and SVG.
    """
    columns = min(columns, len(result_by_planner))
    rows = -(-len(result_by_planner) // columns)
    sheet = _sheet(house.terrain.shape, rows, columns, _entries(house.terrain, _START_MARK, _ROBOT_MARK, _GOAL_MARK))
    for number, (planner, result) in enumerate(result_by_planner.items()):
        axes = sheet.panel(*divmod(number, columns))
        style = planner_style(planner)
        extra = "" if planner == "oracle" else f" ({result.extra:+.0f} %)"
        axes.set_title(f"{style.label}: {result.steps} steps{extra}", fontsize=_FONT, pad=2, color=style.colour)
        _draw_way(axes, house, poses_along(result, house))
    _way_bar(sheet, 0.5)
    return save_figure(sheet.figure, path, dpi=_DPI)
