"""Decisions of one robot from distances, candidates and scores, in plain NumPy and Python."""

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from dc2g_jax._src.grid.poses import ACTION_LETTERS, FORWARD, HEADINGS
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES, TO_GOAL
from dc2g_jax._src.runtime.errors import InputError

#: Names of the headings; y grows to the south.
HEADING_NAMES = ("east", "south", "west", "north")


class RobotPose(NamedTuple):
    """A pose as Python integers.

    Attributes:
      x: column.
      y: row, growing downward.
      heading: 0 = +x (east), 1 = +y (south), 2 = -x (west), 3 = -y (north).
    """

    x: int
    y: int
    heading: int


class Candidate(NamedTuple):
    """A cell that the robot might explore from.

    Attributes:
      x: column.
      y: row.
      heading: heading of the candidate pose there; of several, the nearest.
      cost_to_go: predicted cost from there to the door, in cells if the estimator's costs are: the mean, or the summary
        of the planner's selection rule; `None` for planners without predictions.
      distance: actions from the robot to this pose.
      score: the planner's score; the lowest wins. For `dc2g`, the cost-to-go plus what the way to the candidate counts
        for, plus `penalty`, all as they were when the subgoal was chosen; for frontier exploration, the distance.
      penalty: part of the score beyond cost-to-go and the way to the candidate: what it reveals.
    """

    x: int
    y: int
    heading: int
    cost_to_go: float | None
    distance: int
    score: float
    penalty: float


@dataclasses.dataclass(frozen=True)
class Decision:
    """The next action of a robot, and the reason for it.

    Attributes:
      action: the next action, "F" (one cell forward), "L" or "R" (turn in place); `None` if the robot stands on a door
        or the planner gave up.
      mode: "explore", "to_goal" (a door is reachable) or "gave_up".
      subgoal: last pose of the plan; `None` if the planner gave up.
      path: poses from the robot's own to the subgoal, inclusive, along a shortest plan over observed ground.
      actions: the actions of the plan as letters, one fewer than poses. The first one is `action`.
    """

    action: str | None
    mode: str
    subgoal: RobotPose | None
    path: tuple[RobotPose, ...]
    actions: str
    _rank: Callable[[], tuple[Candidate, ...]] = dataclasses.field(repr=False, compare=False)

    @functools.cached_property
    def candidates(self) -> tuple[Candidate, ...]:
        """Candidates for exploration, one per cell: usually the subgoal first, then in ascending order of score.

        Empty in the other modes. Ranked when first asked for.
        """
        return self._rank()

    @functools.cached_property
    def why(self) -> str:
        """The reason, in one sentence."""
        return explain(self.mode, self.path, self.candidates)


class View(NamedTuple):
    """The inputs of a decision.

    Attributes:
      distance: actions from the robot to every pose, -1 for unreachable poses.
      mode: plan mode.
      subgoals: poses at which the plan may end.
      candidates: poses to explore from.
      cost_to_go: predicted cost-to-go of every cell, `None` without predictions. Like `score`, it is only valid while
        exploring.
      score: score of every cell with a candidate.
      penalty: part of the score beyond cost-to-go and the way to the candidate; `None` for planners without one.
    """

    distance: Int[np.ndarray, "heading h w"]
    mode: int | Int[np.ndarray, ""]
    subgoals: Bool[np.ndarray, "heading h w"]
    candidates: Bool[np.ndarray, "heading h w"]
    cost_to_go: Float[np.ndarray, "h w"] | None
    score: Float[np.ndarray, "h w"]
    penalty: Float[np.ndarray, "h w"] | None


def decide(view: View, left: int, top: int) -> Decision:
    """Make a decision.

    Args:
      view: inputs of the decision.
      left: column of the view's first cell, in the coordinates of the decision.
      top: row of the view's first cell.

    Raises:
      InputError: a score is NaN.
    """
    mode = MODE_NAMES[int(view.mode)]
    chosen_from = np.any(view.candidates & (view.distance >= 0), axis=0)
    if view.mode != TO_GOAL and np.isnan(view.score[chosen_from]).any():
        raise InputError("the estimated cost-to-go is not a number (NaN) in some cell; check the estimator's weights")
    if view.mode == GAVE_UP:
        return Decision(None, mode, None, (), "", tuple)
    plan, actions = shortest_plan(view.distance, view.subgoals)
    path = tuple(RobotPose(left + x, top + y, heading) for x, y, heading in plan)
    rank = functools.partial(_ranked, view, plan[-1], left, top) if view.mode == EXPLORE else tuple
    return Decision(actions[0] if actions else None, mode, path[-1], path, actions, rank)


def shortest_plan(
    distance: Int[np.ndarray, "heading h w"], targets: Bool[np.ndarray, "heading h w"]
) -> tuple[list[tuple[int, int, int]], str]:
    """The lexicographically smallest shortest plan to the targets: its poses (x, y, heading) and its letters.

    Args:
      distance: actions from the robot to every pose, -1 for unreachable poses.
      targets: poses to reach, at least one of them reachable.
    """
    rows, columns = distance.shape[1:]
    reached = np.flatnonzero(targets & (distance >= 0))
    lengths = distance.reshape(-1)[reached]
    length = int(lengths.min())
    heading, y, x = (index.tolist() for index in np.unravel_index(reached[lengths == length], distance.shape))
    # Poses on shortest plans, layer by layer from the targets back to the robot.
    layers = [set(zip(x, y, heading, strict=True))]
    for done in reversed(range(length)):
        before = {pose for later in layers[-1] for pose in _next_to(later, -1)}
        inside = ((x, y, heading) for x, y, heading in before if 0 <= x < columns and 0 <= y < rows)
        layers.append({(x, y, heading) for x, y, heading in inside if distance[heading, y, x] == done})
    (pose,) = layers.pop()
    path, letters = [pose], ""
    for layer in reversed(layers):
        steps = zip(ACTION_LETTERS, _next_to(pose, 1), strict=True)
        letter, pose = next(step for step in steps if step[1] in layer)
        path.append(pose)
        letters += letter
    return path, letters


def _next_to(pose: tuple[int, int, int], forward: int) -> tuple[tuple[int, int, int], ...]:
    """The poses one action later, in the order of the actions, or one action earlier if `forward` is -1."""
    x, y, heading = pose
    dx, dy = FORWARD[heading]
    ahead = (x + forward * dx, y + forward * dy, heading)
    return ahead, (x, y, (heading - forward) % HEADINGS), (x, y, (heading + forward) % HEADINGS)


def _ranked(view: View, subgoal: tuple[int, int, int], left: int, top: int) -> tuple[Candidate, ...]:
    """The candidates, one per cell: the subgoal, then in ascending order of score and distance."""
    reachable = view.candidates & (view.distance >= 0)
    y, x = np.nonzero(reachable.any(axis=0))
    distances = np.where(reachable[:, y, x], view.distance[:, y, x], view.distance.size)
    is_subgoal = (x == subgoal[0]) & (y == subgoal[1])
    heading = np.where(is_subgoal, subgoal[2], distances.argmin(axis=0))
    distance, score = distances.min(axis=0), view.score[y, x]
    order = np.lexsort((x, y, distance, score, ~is_subgoal))
    costs = np.full(len(order), None) if view.cost_to_go is None else view.cost_to_go[y, x]
    penalty = np.zeros(len(order)) if view.penalty is None else view.penalty[y, x]
    fields = (x + left, y + top, heading, costs, distance, score, penalty)
    return tuple(itertools.starmap(Candidate, zip(*(field[order].tolist() for field in fields), strict=True)))


def _in_cells(x: int, y: int, heading: int) -> tuple[str, str]:
    return f"({x}, {y})", HEADING_NAMES[heading]


def _sum(best: Candidate) -> str:
    """The terms of a candidate's score that are not zero, as text."""
    if best.cost_to_go is None:
        return ""
    terms = (
        (best.cost_to_go, "predicted cost-to-go"),
        (best.score - best.cost_to_go - best.penalty, "for the way there"),
        (best.penalty, "for what it reveals"),
    )
    shown = [(value, what) for value, what in terms if abs(value) > 0.05] or terms[:1]
    (first, name), *others = shown
    more = "".join(f" {'-' if value < 0 else '+'} {abs(value):.1f} {what}" for value, what in others)
    return f" = {first:.1f} {name}{more}"


def explain(
    mode: str,
    path: Sequence[RobotPose],
    candidates: Sequence[Candidate],
    words: Callable[[int, int, int], tuple[str, str]] = _in_cells,
) -> str:
    """The reason for a decision, in one sentence.

    Args:
      mode: mode of the decision.
      path: its path.
      candidates: its candidates; the subgoal is usually the first.
      words: column, row and heading -> names of the place and the direction.
    """
    if not path:
        return "gave up: no door is reachable, and nothing unobserved can be seen from anywhere reachable"
    length = len(path) - 1
    (place, facing), away = words(*path[-1]), "1 action" if length == 1 else f"{length} actions"
    if mode == MODE_NAMES[TO_GOAL]:
        reached = (
            f"the door at {place} is reachable in {away}" if length else f"the robot stands on the door at {place}"
        )
        return f"to goal: {reached}"
    subgoal, details = f"explore: {place} facing {facing}", f"{away} away"
    if not candidates or candidates[0][:2] != path[-1][:2]:
        return f"{subgoal} is the planner's choice, {details}"
    best, *others = candidates
    what, digits = "is the nearest", 0
    if best.cost_to_go is not None or best.score != best.distance:
        what, digits, details = "has the lowest score", 1, f"{best.score:.1f}{_sum(best)}, {details}"
    if not others:
        return f"{subgoal} is the only candidate, {details}"
    second = others[0]
    if second.score < best.score:
        what = "is the planner's choice"
    first_shown, shown = (f"{one.score:.{digits}f}" for one in (best, second))
    if shown == first_shown and second.score != best.score:  # no tie but for rounding
        shown = f"{abs(second.score - best.score):.1g} {'more' if second.score > best.score else 'less'}"
    next_best = f"next best {shown} at {words(*second[:3])[0]}"
    return f"{subgoal} {what} of {len(candidates)} candidates, {details}; {next_best}"
