"""Recordings of episodes for the rerun viewer.

A recording is for looking at: the viewer reads files of its own version and the one before. Results live elsewhere.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Bool, Float, UInt8
from matplotlib import colormaps

from dc2g_jax.datasets.houses import House
from dc2g_jax.errors import InputError
from dc2g_jax.estimation.estimators import Estimator, world_cost_to_go
from dc2g_jax.evaluation import EpisodeResult
from dc2g_jax.grid.poses import FORWARD, Pose
from dc2g_jax.grid.terrain import CLASS_COLORS, CLASS_NAMES, FRONT_DOOR, TRAVERSABLE
from dc2g_jax.grid.world import world_from_terrain
from dc2g_jax.inspection.replay import Frames, actions_from_letters, replay_result, running_extra_steps
from dc2g_jax.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES, TO_GOAL
from dc2g_jax.planning.rules import Rules

#: Name of the timeline: actions taken since the start.
TIMELINE = "step"

_exact_cost_to_go = jax.jit(world_cost_to_go)


# ---------------------------------------------------------------------------------------------- colours and words

#: Overlay -> colour, RGBA. The legend below names them.
_REACHABLE_COLOR = (0, 255, 255, 45)
_FIELD_OF_VIEW_COLOR = (255, 255, 255, 80)
_CANDIDATE_COLOR = (255, 150, 0)
_SUBGOAL_COLOR = (255, 0, 255)
_TRAJECTORY_COLOR = (255, 255, 255)
_ROBOT_COLOR = (255, 60, 60)
_GOAL_COLOR = (255, 0, 0)

#: Colours of the planners' curves, in turn.
_CURVE_COLORS = ((255, 150, 0), (0, 200, 255), (120, 220, 90), (220, 120, 255), (255, 235, 59), (255, 90, 90))

#: Class index -> its colour in words.
_COLOR_WORDS = (
    "black", "dark red", "green", "olive", "dark blue", "purple", "teal", "grey", "dark brown", "red", "leaf green",
    "ochre", "indigo", "pink", "grey-green", "white",
)  # fmt: skip

#: Cost-to-go is drawn in classes, so that the viewer names the value under the pointer: not shown, no way, then costs.
_NOT_SHOWN, _NO_WAY, _FIRST_COST, _LAST_COST = 0, 1, 2, 255
_NO_WAY_COLOR = (70, 70, 70)

_LEGEND = """\
**On the maps**

- black: not yet observed
- white veil: field of view
- cyan veil: reachable
- orange dots: cells to explore from (frontier-expanding), while exploring
- magenta dots: subgoal of the plan
- white line: the way so far
- red dot and arrow: robot and heading
- below them: the step, the plan with its length in actions, extra steps so far
- red squares on the hidden map: goal

**Cost-to-go**

- from bright yellow at the goal over green and blue to dark purple, {farthest} cells away
- grey: no way to the goal; black: not observed
- an estimate is shown where the robot has seen traversable ground

**Terrain**

{classes}

Point at a cell to read its class or cost.
"""


def _terrain_context() -> rr.AnnotationContext:
    """Names and colours of the terrain classes."""
    colors = [tuple(int(value) for value in color) for color in CLASS_COLORS]
    names = ("not observed", *CLASS_NAMES[1:])
    return rr.AnnotationContext(list(zip(range(len(names)), names, colors, strict=True)))


def _veil_context(name: str, color: tuple[int, ...]) -> rr.AnnotationContext:
    """Class 1 in a see-through colour, class 0 not drawn at all."""
    return rr.AnnotationContext([(0, "", (0, 0, 0, 0)), (1, name, color)])


class _CostScale(NamedTuple):
    """How costs-to-go become classes of an image.

    Attributes:
      farthest: largest exact cost of the house, in cells; where the colours end.
      cells: cells of cost in one class.
    """

    farthest: float
    cells: int

    @classmethod
    def of(cls, exact: Float[np.ndarray, "h w"]) -> "_CostScale":
        """The scale of a house, with a quarter of the classes left for estimates beyond the exact values."""
        farthest = float(np.max(exact, where=np.isfinite(exact), initial=1.0))
        return cls(farthest, int(np.ceil(farthest / (0.75 * (_LAST_COST - _FIRST_COST)))))

    def classes(
        self, cost: Float[np.ndarray, "*t h w"], shown: Bool[np.ndarray, "*t h w"]
    ) -> UInt8[np.ndarray, "*t h w"]:
        """Class indices of an image of costs."""
        finite = np.isfinite(cost)
        level = np.rint(np.where(finite, cost, 0) / self.cells) + _FIRST_COST
        level = np.where(finite, np.clip(level, _FIRST_COST, _LAST_COST), _NO_WAY)
        return np.where(shown, level, _NOT_SHOWN).astype(np.uint8)

    def context(self) -> rr.AnnotationContext:
        """Names and colours of the classes."""
        costs = self.cells * np.arange(_LAST_COST - _FIRST_COST + 1)
        colors = (255 * colormaps["viridis_r"](np.clip(costs / self.farthest, 0, 1))[:, :3]).astype(int)
        known = [
            (_FIRST_COST + index, f"{cost} cells to go", tuple(color))
            for index, (cost, color) in enumerate(zip(costs.tolist(), colors.tolist(), strict=True))
        ]
        return rr.AnnotationContext(
            [(_NOT_SHOWN, "not observed", (0, 0, 0)), (_NO_WAY, "no way", _NO_WAY_COLOR), *known]
        )


def _legend(house: House, scale: _CostScale) -> str:
    """The words that go with the colours, for the classes that occur in the house."""
    classes = "\n".join(
        f"- {_COLOR_WORDS[index]}: {CLASS_NAMES[index]}{' (the goal)' if index == FRONT_DOOR else ''}"
        for index in np.unique(house.terrain).tolist()
        if index
    )
    return f"## {house.name}\n\n" + _LEGEND.format(farthest=round(scale.farthest), classes=classes)


# ------------------------------------------------------------------------------------------------- what is logged


def _send(stream: rr.RecordingStream, entity: str, steps: np.ndarray, columns: Any) -> None:
    """One column of values for the given steps."""
    stream.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, sequence=steps)], columns=columns)


def _send_images(
    stream: rr.RecordingStream,
    entity: str,
    classes: np.ndarray,
    context: rr.AnnotationContext,
    draw_order: float,
) -> None:
    """Class images `[t h w]`, one a step. Class images are drawn cell by cell, without smoothing."""
    frames, height, width = classes.shape
    form = rr.components.ImageFormat(width=width, height=height, channel_datatype=rr.ChannelDatatype.U8)
    style = rr.SegmentationImage.from_fields(format=form, opacity=1.0, draw_order=draw_order)
    stream.log(entity, context, style, static=True)
    pixels = np.ascontiguousarray(classes, np.uint8).reshape(frames, height * width)
    _send(stream, entity, np.arange(frames), rr.SegmentationImage.columns(buffer=pixels))


def _send_cells(
    stream: rr.RecordingStream, entity: str, cells: Bool[np.ndarray, "t h w"], style: dict[str, Any]
) -> None:
    """Dots in the middle of cells, any number a step."""
    frame, row, column = np.nonzero(cells)
    counts = np.bincount(frame, minlength=len(cells))
    centers = np.stack([column, row], axis=-1).astype(np.float32) + 0.5
    stream.log(entity, rr.Points2D.from_fields(**style), static=True)
    _send(
        stream,
        entity,
        np.arange(len(cells)),
        rr.Points2D.columns(positions=centers).partition(lengths=counts),
    )


def _send_robot(stream: rr.RecordingStream, entity: str, pose: Pose) -> None:
    """Where the robot is, where it looks, and the way it came."""
    steps = np.arange(len(pose.x))
    centers = np.stack([pose.x, pose.y], axis=-1).astype(np.float32) + 0.5
    ahead = 2.5 * np.asarray(FORWARD, np.float32)[pose.heading]
    robot = rr.Points2D.from_fields(radii=0.8, colors=_ROBOT_COLOR, draw_order=60)
    arrow = rr.Arrows2D.from_fields(radii=0.3, colors=_ROBOT_COLOR, draw_order=61)
    line = rr.LineStrips2D.from_fields(radii=0.16, colors=_TRAJECTORY_COLOR, draw_order=30)
    stream.log(entity, robot, static=True)
    stream.log(f"{entity}/heading", arrow, static=True)
    stream.log(f"{entity}/trajectory", line, static=True)
    _send(stream, entity, steps, rr.Points2D.columns(positions=centers))
    _send(stream, f"{entity}/heading", steps, rr.Arrows2D.columns(origins=centers, vectors=ahead))
    # A line needs two points, so the first one stands twice.
    ways = [np.concatenate([centers[:1], centers[: step + 1]]) for step in steps]
    _send(stream, f"{entity}/trajectory", steps, rr.LineStrips2D.columns(strips=ways))


def _status(frames: Frames, result: EpisodeResult) -> list[str]:
    """One line a step: how far, what the plan is, what it has cost."""
    extra = running_extra_steps(frames)
    last = len(frames) - 1
    lines = []
    for step, (mode, length) in enumerate(zip(frames.mode.tolist(), frames.length.tolist(), strict=True)):
        if step == last:
            plan = "goal reached" if result.success else MODE_NAMES[mode] if mode == GAVE_UP else "step limit"
        else:
            what = {EXPLORE: "exploring, subgoal", TO_GOAL: "to the goal", GAVE_UP: "gave up"}[mode]
            plan = what if mode == GAVE_UP else f"{what} in {length}"
        cost = f" · {extra[step]:+.0f} % extra" if np.isfinite(extra[step]) else ""
        lines.append(f"**step {step}** of {last} · {plan}{cost}")
    return lines


def _send_mode(
    stream: rr.RecordingStream, entity: str, label: str, frames: Frames, result: EpisodeResult, outcome: str
) -> None:
    """A line of text whenever the plan mode changes, and what came of it at the end."""
    changes = np.flatnonzero(np.diff(frames.mode, prepend=-1)).tolist()
    lines = [(step, MODE_NAMES[frames.mode[step]]) for step in changes]
    others = int(np.sum(frames.action[:-1] != actions_from_letters(result.actions)))
    if others:
        # Another network than the episode's, or another device, whose rounding settles a near tie otherwise.
        lines.append((0, f"plans shown are made anew, and {others} of their actions are not those taken"))
    lines.append((len(frames) - 1, outcome))
    steps = np.array([step for step, _ in lines])
    _send(stream, entity, steps, rr.TextLog.columns(text=[f"{label}: {words}" for _, words in lines]))


def _send_curve(stream: rr.RecordingStream, entity: str, values: np.ndarray, name: str, color: tuple) -> None:
    """A number a step, where it is known."""
    known = np.flatnonzero(np.isfinite(values))
    stream.log(entity, rr.SeriesLines(names=name, colors=color, widths=2.0), static=True)
    if known.size:
        _send(stream, entity, known, rr.Scalars.columns(scalars=values[known].astype(np.float64)))


def _send_episode(
    stream: rr.RecordingStream,
    label: str,
    frames: Frames,
    result: EpisodeResult,
    scale: _CostScale,
    color: tuple,
) -> None:
    """Everything of one planner, below the entity of its label."""
    entity = rr.new_entity_path([label])
    _send_images(stream, f"{entity}/map", frames.terrain, _terrain_context(), 0)
    reachable = _veil_context("reachable", _REACHABLE_COLOR)
    _send_images(stream, f"{entity}/map/reachable", frames.reachable, reachable, 1)
    in_view = _veil_context("field of view", _FIELD_OF_VIEW_COLOR)
    _send_images(stream, f"{entity}/map/field_of_view", frames.field_of_view, in_view, 2)
    if frames.cost_to_go is not None:
        known = frames.seen & TRAVERSABLE[frames.terrain]
        _send_images(stream, f"{entity}/cost_to_go", scale.classes(frames.cost_to_go, known), scale.context(), 0)
    exploring = (frames.mode == EXPLORE)[:, None, None]
    candidates = frames.candidates.any(axis=1) & exploring
    subgoals = frames.subgoals.any(axis=1) & (frames.mode != GAVE_UP)[:, None, None]
    dots = {"radii": 0.18, "colors": _CANDIDATE_COLOR, "draw_order": 20}
    _send_cells(stream, f"{entity}/plan/frontier_expanding", candidates, dots)
    discs = {"radii": 0.6, "colors": _SUBGOAL_COLOR, "draw_order": 50}
    _send_cells(stream, f"{entity}/plan/subgoals", subgoals, discs)
    _send_robot(stream, f"{entity}/robot", frames.pose)
    status = _status(frames, result)
    _send(
        stream,
        f"{entity}/status",
        np.arange(len(frames)),
        rr.TextDocument.columns(text=status, media_type=["text/markdown"] * len(status)),
    )
    _send_mode(stream, f"{entity}/mode", label, frames, result, status[-1].split(" · ")[1])
    _send_curve(stream, f"{entity}/extra_steps", running_extra_steps(frames), label, color)
    to_goal = np.where(frames.to_goal >= 0, frames.to_goal, np.nan)
    _send_curve(stream, f"{entity}/steps_to_goal", to_goal, label, color)


def _send_house(stream: rr.RecordingStream, house: House, exact: np.ndarray, scale: _CostScale) -> None:
    """What no robot knows beforehand, and the legend."""

    def image(classes: np.ndarray) -> rr.SegmentationImage:
        return rr.SegmentationImage(classes, opacity=1.0)

    stream.log("hidden/map", _terrain_context(), image(house.terrain), static=True)
    everywhere = np.ones(house.terrain.shape, bool)
    stream.log("hidden/cost_to_go", scale.context(), image(scale.classes(exact, everywhere)), static=True)
    rows, columns = np.nonzero(house.terrain == FRONT_DOOR)
    centers = np.stack([columns, rows], axis=-1) + 0.5
    goals = rr.Points2D(centers, radii=0.5, colors=_GOAL_COLOR, labels=["goal"] * len(rows), show_labels=False)
    stream.log("hidden/goals", goals, static=True)
    legend = rr.TextDocument(_legend(house, scale), media_type="text/markdown")
    stream.log("legend", legend, static=True)


def _blueprint(house: House, labels: Mapping[str, bool]) -> rrb.Blueprint:
    """The first view: what is hidden on the left, then one column a planner, curves and legend around them.

    Args:
      house: the house.
      labels: planner -> does it estimate the cost-to-go?
    """
    height, width = house.terrain.shape
    bounds = rrb.VisualBounds2D(x_range=[-0.5, width + 0.5], y_range=[-0.5, height + 0.5])

    def grid_view(name: str, contents: list[str]) -> rrb.Spatial2DView:
        return rrb.Spatial2DView(origin="/", contents=contents, name=name, visual_bounds=bounds)

    hidden = rrb.Vertical(
        grid_view("hidden map", ["/hidden/map", "/hidden/goals"]),
        grid_view("exact cost-to-go", ["/hidden/cost_to_go", "/hidden/goals"]),
    )
    columns: list[rrb.Container] = [hidden]
    entities = [f"/{rr.new_entity_path([label])}" for label in labels]
    for entity, (label, estimates) in zip(entities, labels.items(), strict=True):
        cost, whose = (f"{entity}/cost_to_go", "estimated") if estimates else ("/hidden/cost_to_go", "exact")
        on_map = [f"{entity}/map/**", f"{entity}/plan/**", f"{entity}/robot/**"]
        on_cost = [cost, f"{entity}/plan/subgoals", f"{entity}/robot/**"]
        columns.append(
            rrb.Vertical(
                grid_view(f"{label}: observed map", on_map),
                grid_view(f"{label}: {whose} cost-to-go", on_cost),
                rrb.TextDocumentView(origin=f"{entity}/status", name=label),
                row_shares=[5, 5, 1],
            )
        )

    def of_all(name: str) -> list[str]:
        return [f"{entity}/{name}" for entity in entities]

    curves = rrb.Horizontal(
        rrb.TimeSeriesView(origin="/", contents=of_all("extra_steps"), name="extra steps so far (%)"),
        rrb.TimeSeriesView(origin="/", contents=of_all("steps_to_goal"), name="steps left to the goal (the oracle's)"),
        rrb.TextLogView(origin="/", contents=of_all("mode"), name="plan mode"),
    )
    legend = rrb.TextDocumentView(origin="/legend", name="legend")
    grids = rrb.Horizontal(*columns, legend, column_shares=[4.0] * len(columns) + [2.5])
    return rrb.Blueprint(
        rrb.Vertical(grids, curves, row_shares=[7, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=10.0),
        auto_views=False,
    )


def _check(house: House, result_by_planner: Mapping[str, EpisodeResult], rules: Rules) -> EpisodeResult:
    """The first result, once all are known to be of one start in this house under these rules.

    Raises:
      ValueError: where they are not.
    """
    if not result_by_planner:
        raise ValueError("no episode to record; give the result of at least one planner")
    first = next(iter(result_by_planner.values()))
    start = (first.house, first.x, first.y, first.heading)
    for label, result in result_by_planner.items():
        if result.house != house.name:
            raise ValueError(f"{label}: an episode in {result.house}, not in {house.name}")
        if (result.house, result.x, result.y, result.heading) != start:
            raise ValueError(f"{label}: another start than the first planner's; a recording is of one start")
        if (result.range, result.expanding_range) != (rules.sensing.radius, rules.expanding_range):
            raise ValueError(f"{label}: sensing range {result.range} is not that of the rules, {rules.sensing.radius}")
    return first


def record_episode(
    path: str | Path,
    *,
    house: House,
    result_by_planner: Mapping[str, EpisodeResult],
    rules: Rules,
    estimator: Estimator | None = None,
) -> Path:
    """Write one rerun file (`.rrd`) of one start, with one or more planners side by side.

    Open it with `rerun FILE`. Needs no viewer, window or network, and touches no other recording of the process.

    Args:
      path: file to write; its folder is made.
      house: where the episodes took place.
      result_by_planner: what to call each planner -> its episode. All are of one start.
      rules: what was seen and what counted as frontier.
      estimator: the network of `dc2g`.

    Returns:
      The path.

    Raises:
      InputError: if the file cannot be written.
      ValueError: if the episodes do not belong together, to the house or to the rules, or a `dc2g` episode comes
        without an estimator.
    """
    first = _check(house, result_by_planner, rules)
    episodes = {label: replay_result(result, house, rules, estimator) for label, result in result_by_planner.items()}
    exact = np.asarray(_exact_cost_to_go(world_from_terrain(house.terrain)))
    scale = _CostScale.of(exact)
    path = Path(path)
    stream = rr.RecordingStream("dc2g_jax")
    blueprint = _blueprint(house, {label: frames.cost_to_go is not None for label, frames in episodes.items()})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        stream.save(path, default_blueprint=blueprint)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({error}); name a file in a folder of yours") from None
    stream.send_recording_name(f"{house.name} from ({first.x}, {first.y}), heading {first.heading}")
    _send_house(stream, house, exact, scale)
    for number, (label, frames) in enumerate(episodes.items()):
        color = _CURVE_COLORS[number % len(_CURVE_COLORS)]
        _send_episode(stream, label, frames, result_by_planner[label], scale, color)
    stream.flush()
    stream.disconnect()
    return path
