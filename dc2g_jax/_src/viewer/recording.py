"""Recordings of episodes for the rerun viewer.

The viewer reads files of its own version and of the previous one only, so results are also kept elsewhere.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float
from PIL import ImageColor

from dc2g_jax._src.figures.costs import exact_cost_to_go, predicts, score_colors
from dc2g_jax._src.figures.episode_figures import outcome
from dc2g_jax._src.figures.replay import Frames, actions_from_letters, running_extra_steps
from dc2g_jax._src.figures.results_figures import planner_styles
from dc2g_jax._src.grid.poses import FORWARD
from dc2g_jax._src.grid.terrain import FRONT_DOOR, TRAVERSABLE
from dc2g_jax._src.planning.decisions import HEADING_NAMES
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES, TO_GOAL
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.viewer import legend
from dc2g_jax._src.viewer.columns import (
    SO_FAR,
    centers,
    curve_style,
    first_view,
    image_style,
    open_recording,
    send,
    send_cells,
    send_curve,
    send_images,
    send_lines,
    send_track,
)
from dc2g_jax._src.viewer.legend import CostScale


def _send_maps(stream: rr.RecordingStream, entity: str, frames: Frames, scale: CostScale) -> None:
    images = [
        ("map", legend.terrain_context(), 0, frames.terrain),
        ("map/reachable", legend.layer_context(*legend.REACHABLE_LAYER), 1, frames.reachable),
        ("map/field_of_view", legend.layer_context(*legend.FIELD_OF_VIEW_LAYER), 2, frames.field_of_view),
        ("map/frontier", legend.layer_context(*legend.FRONTIER_LAYER), 3, frames.frontier),
    ]
    if frames.cost_to_go is not None:
        known = frames.seen & TRAVERSABLE[frames.terrain]
        scale = scale if frames.in_cells else legend.RELATIVE
        costs = scale.classes(frames.cost_to_go, known)
        costs[known & ~predicts(frames.cost_to_go)[:, None, None]] = legend.NO_PREDICTION
        images.append(("cost_to_go", scale.context(), 0, costs))
    for name, context, order, classes in images:
        image_style(stream, f"{entity}/{name}", context, order)
        send_images(stream, f"{entity}/{name}", np.arange(len(frames)), classes.astype(np.uint8, copy=False))


def _send_candidates(stream: rr.RecordingStream, entity: str, score: Float[np.ndarray, "t h w"]) -> None:
    """Send the candidates of the planner with their scores, colored by rank within a step."""
    frame, row, column = np.nonzero(~np.isnan(score))
    finite = np.where(np.isfinite(score), score, np.nan)
    lowest, highest = (of_all.reduce(finite, axis=(1, 2), keepdims=True).ravel() for of_all in (np.fmin, np.fmax))
    scores = score[frame, row, column]
    rank = (scores - lowest[frame]) / np.maximum(highest - lowest, 1e-6)[frame]
    counts = np.bincount(frame, minlength=len(score))
    stream.log(entity, rr.Points2D.from_fields(radii=0.3, draw_order=20), static=True)
    dots = rr.Points2D.columns(positions=centers(column, row), colors=score_colors(rank)).partition(counts)
    values = rr.AnyValues.columns(score=scores).partition(counts)
    send(stream, entity, np.arange(len(score)), [*dots, *values])


def _send_plan(stream: rr.RecordingStream, entity: str, frames: Frames) -> None:
    exploring = (frames.mode == EXPLORE)[:, None, None]
    expanding = rr.Points2D.from_fields(radii=0.18, colors=legend.EXPANDING_COLOR, draw_order=20)
    send_cells(stream, f"{entity}/frontier_expanding", frames.candidates.any(axis=1) & exploring, expanding)
    _send_candidates(stream, f"{entity}/candidates", frames.score)
    line = rr.LineStrips2D.from_fields(radii=0.16, colors=legend.SUBGOAL_COLOR, draw_order=40)
    send_lines(stream, f"{entity}/path", [_cells_of(path) for path in frames.path], line)
    subgoals = frames.subgoals.any(axis=1) & (frames.mode != GAVE_UP)[:, None, None]
    disc = rr.Points2D.from_fields(radii=0.55, colors=legend.SUBGOAL_COLOR, draw_order=50)
    send_cells(stream, f"{entity}/subgoals", subgoals, disc)


def _cells_of(path: np.ndarray) -> Float[np.ndarray, "cells 2"]:
    """Centers of the cells of a plan, without repetition where the robot turns in place."""
    moves = np.any(np.diff(path[:, :2], axis=0), axis=1)
    cells = path[np.concatenate([np.ones(min(len(path), 1), bool), moves])]
    return centers(cells[:, 0], cells[:, 1])


def _status(frames: Frames) -> list[str]:
    """One line per step: its number, the extra steps so far, and the plan."""
    extra = running_extra_steps(frames)
    last = len(frames) - 1
    counts = np.sum(~np.isnan(frames.score), axis=(1, 2)).tolist()
    least = np.fmin.reduce(frames.score, axis=(1, 2), keepdims=True).ravel().tolist()
    lines = []
    for step, (mode, length) in enumerate(zip(frames.mode.tolist(), frames.length.tolist(), strict=True)):
        plan = {
            EXPLORE: f"explore: subgoal in {length}, score {least[step]:.1f}, best of {counts[step]}",
            TO_GOAL: f"to goal: door in {length}",
            GAVE_UP: "gave up",
        }[mode]
        cost = f" · {extra[step]:+.0f} % extra" if np.isfinite(extra[step]) else ""
        what = outcome(frames) if step == last else plan
        lines.append(f"**step {step}** of {last}{cost} · {what}")
    return lines


def _send_mode(stream: rr.RecordingStream, entity: str, label: str, result: EpisodeResult, frames: Frames) -> None:
    """Send a line of text whenever the plan mode changes, and the outcome at the end."""
    changes = np.flatnonzero(np.diff(frames.mode, prepend=-1)).tolist()
    lines = [(step, MODE_NAMES[frames.mode[step]]) for step in changes]
    others = int(np.sum(frames.action[:-1] != actions_from_letters(result.actions)))
    if others:
        # The network differs from the episode's, or the device does, whose rounding may decide a near tie differently.
        lines.append((0, f"plans shown are made anew, and {others} of their actions are not those taken"))
    lines.append((len(frames) - 1, outcome(frames)))
    steps = np.array([step for step, _ in lines])
    send(stream, entity, steps, rr.TextLog.columns(text=[f"{label}: {words}" for _, words in lines]))


def _send_episode(
    stream: rr.RecordingStream,
    label: str,
    result: EpisodeResult,
    frames: Frames,
    scale: CostScale,
    color: tuple[int, ...],
) -> None:
    entity = rr.new_entity_path([label])
    _send_maps(stream, entity, frames, scale)
    _send_plan(stream, f"{entity}/plan", frames)
    pose = frames.pose
    ahead = 2.5 * np.asarray(FORWARD, np.float32)[pose.heading]
    send_track(stream, f"{entity}/robot", centers(np.asarray(pose.x), np.asarray(pose.y)), ahead, 0.8)
    status = _status(frames)
    texts = rr.TextDocument.columns(text=status, media_type=["text/markdown"] * len(status))
    send(stream, f"{entity}/status", np.arange(len(frames)), texts)
    _send_mode(stream, f"{entity}/mode", label, result, frames)
    left = np.where(frames.to_goal >= 0, frames.to_goal, np.nan)
    for name, values in (("extra_steps", running_extra_steps(frames)), ("steps_to_goal", left)):
        curve_style(stream, f"{entity}/{name}", label, color)
        send_curve(stream, f"{entity}/{name}", values)


def _send_house(stream: rr.RecordingStream, house: House, exact: np.ndarray, scale: CostScale, about: str) -> None:
    """Send the whole map, its exact cost-to-go and goals, the legend, and a line about the episodes."""

    def image(classes: np.ndarray) -> rr.SegmentationImage:
        return rr.SegmentationImage(classes, opacity=1.0)

    stream.log("hidden/map", legend.terrain_context(), image(house.terrain), static=True)
    everywhere = np.ones(house.terrain.shape, bool)
    stream.log("hidden/cost_to_go", scale.context(), image(scale.classes(exact, everywhere)), static=True)
    rows, columns = np.nonzero(house.terrain == FRONT_DOOR)
    labels = ["goal"] * len(rows)
    goals = rr.Points2D(centers(columns, rows), radii=0.35, colors=legend.GOAL_COLOR, labels=labels, show_labels=False)
    stream.log("hidden/goals", goals, static=True)
    texts = {"legend": legend.episode_legend(house.terrain, scale), "hidden/about": about}
    for entity, words in texts.items():
        stream.log(entity, rr.TextDocument(words, media_type="text/markdown"), static=True)


def _layout(shape: tuple[int, ...], estimates: Mapping[str, bool]) -> rrb.Blueprint:
    """The first view: the true map, then one column per planner; legend, curves and plan modes on the right."""
    height, width = shape
    bounds = rrb.VisualBounds2D(x_range=[-0.5, width + 0.5], y_range=[-0.5, height + 0.5])
    entities = {label: rr.new_entity_path([label]) for label in estimates}

    def grid_view(name: str, contents: Sequence[str], robot: str | None = None) -> rrb.Spatial2DView:
        overrides: dict[Any, Any] = {} if robot is None else {f"{robot}/path": SO_FAR}
        return rrb.Spatial2DView(origin="/", contents=contents, name=name, visual_bounds=bounds, overrides=overrides)

    def column(above: rrb.View, below: rrb.View, words: rrb.View) -> rrb.Vertical:
        return rrb.Vertical(above, below, words, row_shares=[6, 6, 1.4])

    def of_planner(label: str) -> rrb.Vertical:
        entity = entities[label]
        robot, plan = f"{entity}/robot", f"{entity}/plan"
        cost, whose = (f"{entity}/cost_to_go", "estimated") if estimates[label] else ("/hidden/cost_to_go", "exact")
        on_both = [f"{plan}/path", f"{plan}/subgoals", f"{robot}/**"]
        return column(
            grid_view(f"{label}: observed map", [f"{entity}/map/**", f"{plan}/frontier_expanding", *on_both], robot),
            grid_view(f"{label}: {whose} cost-to-go", [cost, f"{plan}/candidates", *on_both], robot),
            rrb.TextDocumentView(origin=f"{entity}/status", name=label),
        )

    def of_all(name: str) -> list[str]:
        return [f"{entity}/{name}" for entity in entities.values()]

    hidden = column(
        grid_view("hidden map", ["/hidden/map", "/hidden/goals"]),
        grid_view("exact cost-to-go", ["/hidden/cost_to_go", "/hidden/goals"]),
        rrb.TextDocumentView(origin="/hidden/about", name="house"),
    )

    def curves(entity: str, name: str, legend: rrb.Corner2D) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin="/", contents=of_all(entity), name=name, plot_legend=rrb.PlotLegend(corner=legend)
        )

    aside = rrb.Vertical(
        rrb.TextDocumentView(origin="/legend", name="legend"),
        curves("extra_steps", "extra steps so far (%)", rrb.Corner2D.LeftTop),
        curves("steps_to_goal", "steps left on the whole map", rrb.Corner2D.RightTop),
        rrb.TextLogView(origin="/", contents=of_all("mode"), name="plan mode"),
        row_shares=[6.4, 2.8, 2.8, 2.2],
    )
    columns = [hidden, *(of_planner(label) for label in estimates)]
    return first_view(rrb.Horizontal(*columns, aside, column_shares=[4.0] * len(columns) + [3.2]), fps=10.0)


def _check(house: House, results: Mapping[str, EpisodeResult]) -> EpisodeResult:
    """The first result. Checks that all results have the same start in this house.

    Raises:
      ValueError: there is no result, or the results have different starts or houses.
    """
    if not results:
        raise ValueError("no episode to record; give the result of at least one planner")
    first = next(iter(results.values()))
    start = (first.house, first.x, first.y, first.heading)
    for label, result in results.items():
        if result.house != house.name:
            raise ValueError(f"{label}: an episode in {result.house}, not in {house.name}")
        if (result.house, result.x, result.y, result.heading) != start:
            raise ValueError(f"{label}: another start than the first planner's; a recording is of one start")
    return first


def record_episode(
    path: str | Path,
    *,
    house: House,
    result_by_planner: Mapping[str, EpisodeResult],
    frames_by_planner: Mapping[str, Frames],
) -> Path:
    """Write a rerun file (`.rrd`) of one start, with one or more planners side by side (as in the paper's Fig. 8).

    Open it with `rerun FILE`. Writing needs no viewer, window or network and does not affect other recordings.

    Args:
      path: file to write; its folder is created.
      house: house of the episodes.
      result_by_planner: label of each planner -> its episode. All have the same start.
      frames_by_planner: label of each planner -> its episode as `inspection.replay_result` replays it.

    Returns:
      The path.

    Raises:
      InputError: the file cannot be written.
      ValueError: there is no episode, or the episodes have different starts or houses.
    """
    first = _check(house, result_by_planner)
    exact = exact_cost_to_go(house)
    scale = CostScale.of(exact)
    path, place = Path(path), f"({first.x}, {first.y}) facing {HEADING_NAMES[first.heading]}"
    estimates = {label: frames_by_planner[label].cost_to_go is not None for label in result_by_planner}
    blueprint = _layout(house.terrain.shape, estimates)
    stream = open_recording(path, name=f"{house.name} from {place}", blueprint=blueprint)
    oracle = "no door can be reached" if first.oracle_steps is None else f"the oracle takes {first.oracle_steps} steps"
    about = f"**{house.name}** from {place}; {oracle}"
    _send_house(stream, house, exact, scale, about)
    styles = planner_styles(result_by_planner)
    for label, result in result_by_planner.items():
        _send_episode(stream, label, result, frames_by_planner[label], scale, ImageColor.getrgb(styles[label].color))
    stream.flush()
    stream.disconnect()
    return path
