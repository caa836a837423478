"""Figures of episodes: maps and predictions at several moments (the paper's Fig. 8), and whole paths."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_hex
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dc2g_jax._src.figures._sheets import DPI, FONT, Sheet, cell_rim, empty_sheet, spread
from dc2g_jax._src.figures.costs import (
    BLOCKED_COLOR,
    COST_COLORS,
    cost_image,
    cost_shares,
    exact_cost_to_go,
    highest_cost,
    predicts,
)
from dc2g_jax._src.figures.replay import Frames, actions_from_letters, running_extra_steps
from dc2g_jax._src.figures.results_figures import (
    class_patch,
    legend_patch,
    map_image,
    planner_style,
    present_classes,
    save_figure,
)
from dc2g_jax._src.grid import gridworld
from dc2g_jax._src.grid.ground import pieces
from dc2g_jax._src.grid.poses import Pose, make_pose
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, TO_GOAL
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.rollout import NO_ACTION

_GRAY = "#444444"

#: Color map of paths, from the start on; its ends differ in grayscale.
_WAY_COLORS = "plasma"

#: Colors of marks: start and goal, robot, subgoal.
MARK_COLOR, ROBOT_COLOR, SUBGOAL_COLOR = "#ffffff", "#f0e442", "#ff6ec7"

# Marks lie over lines and frames and are not cut off at the edge of a map. The mark of a reached goal is larger than
# the robot that covers it.
_EDGE: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "black", "clip_on": False, "zorder": 3}
_START: dict[str, Any] = {"marker": "o", "color": MARK_COLOR, "markersize": 3.6, "markeredgewidth": 0.8, **_EDGE}
_ROBOT: dict[str, Any] = {"color": ROBOT_COLOR, "markersize": 6, "markeredgewidth": 0.7, **_EDGE}
_GOAL: dict[str, Any] = {"marker": "*", "color": MARK_COLOR, "markersize": 5.5, "markeredgewidth": 0.6, **_EDGE}
_REACHED: dict[str, Any] = _GOAL | {"markersize": 13}
_SUBGOAL: dict[str, Any] = {"marker": "X", "color": SUBGOAL_COLOR, "markersize": 5, "markeredgewidth": 0.6, **_EDGE}
_LINE_STYLE: dict[str, Any] = {"solid_joinstyle": "round", "scalex": False, "scaley": False}
_VIEW_COLOR = "#e69f00"
_HEADING_MARKERS = ">v<^"

#: Side of a cell, in points, for which the sizes of lines and marks above are meant.
_USUAL_CELL = 1.68


#: Name in legends -> style of a mark.
_MARKS = {"start": _START, "robot": {"marker": ">", **_ROBOT}, "subgoal": _SUBGOAL, "goal": _GOAL}


def _entries(terrain: UInt8[np.ndarray, "h w"], *marks: str) -> list[Any]:
    classes = [class_patch(index) for index in present_classes(terrain)]
    return classes + [Line2D([], [], label=mark, **_MARKS[mark]) for mark in marks]


def legend_entries(terrain: UInt8[np.ndarray, "h w"], *, costs: bool, view: bool = False) -> list[Any]:
    """Entries of the legend of maps that are seen in part, of costs, and of the field of view."""
    entries = _entries(terrain, *_MARKS)
    hidden = map_image(np.full((1, 1), present_classes(terrain)[0], np.uint8), np.zeros((1, 1), bool))[0, 0]
    entries.append(legend_patch("not seen yet", to_hex(hidden)))
    if costs:
        entries.append(legend_patch("not traversable", BLOCKED_COLOR))
    if view:
        entries.append(Patch(facecolor="white", edgecolor=_VIEW_COLOR, label="in view"))
    return entries


def goal_marks(terrain: UInt8[np.ndarray, "h w"], robot: tuple[int, int]) -> tuple[list[tuple[int, int]], bool]:
    """Columns and rows of the goals' marks, one per door. The door on which the robot stands, if any, comes last.

    Args:
      terrain: the map.
      robot: column and row of the robot. The mark of a reached door is placed there.

    Returns:
      The places, and whether the robot has reached the last one.
    """
    places = [(door.x, door.y) for door in pieces(terrain == FRONT_DOOR)]
    x, y = robot
    if terrain[y, x] != FRONT_DOOR:
        return places, False
    places.remove(min(places, key=lambda place: (place[0] - x) ** 2 + (place[1] - y) ** 2))
    return [*places, robot], True


def _scaled(axes: Axes, style: Mapping[str, Any]) -> dict[str, Any]:
    """The style of lines and marks, scaled to the size of a cell of the image in a panel."""
    points = axes.bbox.width * 72 / axes.figure.dpi / axes.images[0].get_size()[1]
    scale = float(np.clip(points / _USUAL_CELL, 0.6, 1.3))
    return {name: value * scale if name in ("linewidth", "markersize") else value for name, value in style.items()}


def _draw_map(
    axes: Axes, terrain: UInt8[np.ndarray, "h w"], seen: Bool[np.ndarray, "h w"], robot: tuple[int, int]
) -> None:
    """Draw the terrain, pale where not observed, and the goals."""
    axes.imshow(map_image(terrain, seen), interpolation="nearest", aspect="auto")
    axes.add_collection(LineCollection(cell_rim(seen), colors=_GRAY, linewidths=0.5), autolim=False)
    places, reached = goal_marks(terrain, robot)
    for number, (x, y) in enumerate(places, start=1):
        axes.plot([x], [y], **_scaled(axes, _REACHED if reached and number == len(places) else _GOAL))


def draw_view(axes: Axes, house: House, frames: Frames, frame: int, *, in_view: bool = False) -> None:
    """Draw the map as seen before an action, and the outline of what is in view."""
    _draw_map(axes, house.terrain, frames.seen[frame], (int(frames.pose.x[frame]), int(frames.pose.y[frame])))
    if in_view:
        rim = cell_rim(frames.field_of_view[frame])
        axes.add_collection(LineCollection(rim, colors=_VIEW_COLOR, linewidths=1.0), autolim=False)


def draw_robot(axes: Axes, frames: Frames, frame: int) -> None:
    """Draw the path so far, its start, the subgoal of the plan, and the robot."""
    x, y = frames.pose.x[: frame + 1], frames.pose.y[: frame + 1]
    for color, thickness in (("white", 2.2), ("black", 1.1)):
        axes.plot(x, y, color=color, **_scaled(axes, {"linewidth": thickness, **_LINE_STYLE}))
    axes.plot(x[:1], y[:1], **_scaled(axes, _START))
    if frames.mode[frame] == EXPLORE and frame < len(frames) - 1:
        rows, columns = np.nonzero(frames.subgoals[frame].any(axis=0))
        axes.plot(columns[:1], rows[:1], **_scaled(axes, _SUBGOAL))
    marker = _HEADING_MARKERS[frames.pose.heading[frame]]
    axes.plot(x[-1:], y[-1:], marker=marker, **_scaled(axes, _ROBOT))


def _draw_path(axes: Axes, house: House, way: Pose) -> None:
    """Draw the whole map and a path on it, colored from start to end."""
    _draw_map(axes, house.terrain, np.ones(house.terrain.shape, bool), (int(way.x[-1]), int(way.y[-1])))
    points = np.stack([way.x, way.y], axis=-1).astype(float)
    segments = np.stack([points[:-1], points[1:]], axis=1)
    for color, thickness in (("white", 3.0), ("black", 2.2)):
        axes.plot(*points.T, color=color, **_scaled(axes, {"linewidth": thickness, **_LINE_STYLE}))
    colors = colormaps[_WAY_COLORS](np.linspace(0, 1, len(segments)))
    style = _scaled(axes, {"linewidth": 1.3, "capstyle": "round"})
    axes.add_collection(LineCollection(list(segments), colors=colors, **style), autolim=False)
    axes.plot(way.x[:1], way.y[:1], **_scaled(axes, _START))
    marker = _HEADING_MARKERS[way.heading[-1]]
    axes.plot(way.x[-1:], way.y[-1:], marker=marker, **_scaled(axes, _ROBOT))


def _path_bar(sheet: Sheet, place: float) -> None:
    colors = ScalarMappable(Normalize(0, 1), _WAY_COLORS)
    sheet.bar(place, colors, "path", ticks=[0, 1], format=lambda value, _: ("start", "end")[int(value)])


def _draw_cost(axes: Axes, share: Float[np.ndarray, "h w"], shown: np.ndarray, blocked: np.ndarray) -> None:
    """Draw costs-to-go, relative to the cost at the end of the colors, and blocked ground in gray."""
    axes.imshow(cost_image(share, shown, blocked), interpolation="nearest", aspect="auto")
    # In grayscale, costs near the goal look like blocked ground: a line separates them.
    rims = cell_rim(shown + 2 * blocked)
    axes.add_collection(LineCollection(rims, colors=_GRAY, linewidths=0.5), autolim=False)


def outcome(frames: Frames) -> str:
    """The outcome of an episode, in words."""
    if frames.to_goal[-1] == 0:
        return "at the goal"
    return "gave up" if frames.mode[-1] == GAVE_UP else "step limit"


def moments(frames: Frames, count: int) -> list[int]:
    """Steps to show of an episode: evenly spaced from its start to the first plan to the goal, and its end.

    They are evenly spaced throughout if the planner knew of the goal at once or never.
    """
    last = len(frames) - 1
    known = np.flatnonzero(frames.mode == TO_GOAL)
    return spread(last, count, int(known[0]) if known.size and 0 < known[0] < last else None)


def _titles(frames: Frames, chosen: Sequence[int]) -> list[str]:
    titles = []
    for frame in chosen[:-1]:
        first = frames.mode[frame] == TO_GOAL and frame > 0 and frames.mode[frame - 1] != TO_GOAL
        titles.append(f"step {frame}{': goal seen' if first else ''}")
    extra = running_extra_steps(frames)[-1]
    whole = f"extra steps: {extra:.0f} %" if np.isfinite(extra) else "whole map"
    return [*titles, f"step {chosen[-1]}: {outcome(frames)}", whole]


def plot_episode(
    path: str | Path, house: House, frames_by_planner: Mapping[str, Frames], columns: int | None = None
) -> list[Path]:
    """Draw planners from one start, as in Fig. 8: observed maps, predictions, and paths on the whole map.

    Each planner has a row: the observed map at several moments over the pale hidden map, then its path on the whole
    map. A planner that predicts the cost-to-go has a second row: its predictions, then the exact cost-to-go.

    Args:
      path: output path without ending.
      house: the house.
      frames_by_planner: planner name -> its replayed episode, all from one start.
      columns: number of moments of each episode, see `moments`; `None` to choose it by the shape of the map.

    Returns:
      The files written: PNG, SVG and PDF.
    """
    height, width = house.terrain.shape
    count = columns or (4 if width <= 1.6 * height else 3 if width <= 2.6 * height else 2)
    estimates = sum(frames.cost_to_go is not None for frames in frames_by_planner.values())
    entries = legend_entries(house.terrain, costs=bool(estimates))
    titles = {planner: _titles(frames, moments(frames, count)) for planner, frames in frames_by_planner.items()}
    rows = len(frames_by_planner) + estimates
    sheet = empty_sheet((height, width), rows, count + 1, entries, [title for row in titles.values() for title in row])
    if estimates:
        exact = exact_cost_to_go(house)
        high = highest_cost(house, frames_by_planner, exact)
        sheet.bar(0, ScalarMappable(Normalize(0, high), COST_COLORS), "cost-to-go (cells)", extend="max")
    _path_bar(sheet, 1 if estimates else 0.5)
    row = 0
    for planner, frames in frames_by_planner.items():
        chosen = moments(frames, count)
        first = [sheet.panel(row, column, title) for column, title in enumerate(titles[planner][:-1])]
        style = planner_style(planner)
        name = style.label.replace(", ", ",\n")
        first[0].set_ylabel(name, fontsize=FONT, color=style.color, fontweight="bold", labelpad=3)
        for axes, frame in zip(first, chosen, strict=True):
            draw_view(axes, house, frames, frame)
            draw_robot(axes, frames, frame)
        _draw_path(sheet.panel(row, count, titles[planner][-1]), house, frames.pose)
        row += 1
        if frames.cost_to_go is not None:
            below = [sheet.panel(row, column) for column in range(len(chosen))]
            unit = "" if frames.in_cells else "\n(relative)"
            below[0].set_ylabel(f"predicted\ncost-to-go{unit}", fontsize=FONT, labelpad=3)
            for axes, frame in zip(below, chosen, strict=True):
                draw_costs(axes, house, frames, frame, high)
                draw_robot(axes, frames, frame)
            ground = TRAVERSABLE[house.terrain]
            _draw_cost(sheet.panel(row, count, "exact"), exact / high, ground & np.isfinite(exact), ~ground)
            row += 1
    return save_figure(sheet.figure, path, dpi=DPI)


def draw_costs(axes: Axes, house: House, frames: Frames, frame: int, high: float) -> None:
    """Draw the costs-to-go that a planner predicted before an action, on observed ground."""
    ground, seen, share = TRAVERSABLE[house.terrain], frames.seen[frame], cost_shares(frames, high)[frame]
    _draw_cost(axes, share, seen & ground, seen & ~ground)
    if not predicts(share):
        ground = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}  # or the map's outlines cross the words
        axes.text(
            0.5, 0.97, "no prediction", ha="center", va="top", transform=axes.transAxes, fontsize=FONT, bbox=ground
        )


def poses_along(result: EpisodeResult, house: House) -> Pose:
    """The poses before each action of an episode and after the last: `[t]`, as NumPy arrays."""
    world, start = World.from_terrain(house.terrain), make_pose(result.x, result.y, result.heading)
    actions = jnp.append(actions_from_letters(result.actions), NO_ACTION).astype(jnp.int32)
    _, poses = jax.lax.scan(lambda pose, action: (gridworld.move(world, pose, action), pose), start, actions)
    return jax.device_get(poses)


def plot_trajectories(path: str | Path, house: House, result_by_planner: Mapping[str, EpisodeResult]) -> list[Path]:
    """Draw the paths of planners on the whole map, three in a row, colored from start to end.

    Args:
      path: output path without ending.
      house: the house.
      result_by_planner: planner name -> its episode.

    Returns:
      The files written: PNG, SVG and PDF.
    """
    columns = min(3, len(result_by_planner))
    rows = -(-len(result_by_planner) // columns)
    titles = {}
    for planner, result in result_by_planner.items():
        if result.extra is None:
            extra = ", no door in reach"
        else:
            extra = "" if planner == "oracle" else f" ({result.extra:+.0f} %)"
        titles[planner] = f"{planner_style(planner).label}: {result.steps} steps{extra}"
    entries = _entries(house.terrain, "start", "robot", "goal")
    sheet = empty_sheet(house.terrain.shape, rows, columns, entries, list(titles.values()))
    for number, (planner, result) in enumerate(result_by_planner.items()):
        axes = sheet.panel(*divmod(number, columns), titles[planner], planner_style(planner).color)
        _draw_path(axes, house, poses_along(result, house))
    _path_bar(sheet, 0.5)
    return save_figure(sheet.figure, path, dpi=DPI)
