"""The planner of a learned score in plain NumPy: one robot, one pose at a time, in double precision."""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from tests.oracles import numpy_gridworld as oracle
from tests.oracles.numpy_gridworld import ACTION_LETTERS, FRONT_DOOR, STEPS, TRAVERSABLE_CLASSES, Array, Mode, Pose

#: Cells a side of the squares with one candidate each.
SIDE = 8

#: Unknown, front door, house, nothing and traversable: all that maps without semantics have.
PLAIN_CLASSES = (0, 1, 7, 14, 15)

#: Terms for the way to a candidate; the others tell what it reveals.
WAY = ("actions", "log_actions", "straight_ahead", "winding")

#: Scores that differ by less than the first and more than the second may be in another order in single precision.
CLOSE, EQUAL = 2e-3, 1e-9


class Unclear(Exception):
    """Two scores are too close to tell the lower one in single precision."""


class Candidate(NamedTuple):
    """The best pose of a square, its cost-to-go, its terms by name, and its score."""

    pose: Pose
    cost: float
    terms: dict[str, float]
    score: float


def lowest(scored: Iterable[tuple[float, Any]]) -> Any:
    """The item of the lowest score, the first of equal ones."""
    scored = list(scored)
    least = min(score for score, _ in scored)
    if any(EQUAL < score - least < CLOSE for score, _ in scored):
        raise Unclear
    return next(item for score, item in scored if score - least <= EQUAL)


def share(cells: Array, x: int, y: int, radius: int) -> float:
    """Cells of a set in the square around a cell, as far as on the map, per cell of the square."""
    rows, columns = (slice(max(0, at - radius), max(0, at + radius + 1)) for at in (y, x))
    return cells[rows, columns].sum() / (2 * radius + 1) ** 2


def pose_terms(seen: Array, there: Pose, actions: int, kept: bool, sensing: int) -> dict[str, float]:
    """The terms that differ within a square."""
    new = (~seen & oracle.visible(there, sensing, seen.shape)).sum()
    return {
        "actions": actions,
        "log_actions": np.log(actions + 1),
        "gain": new / len(oracle.sensing_offsets(sensing, 0)),
        "log_gain": np.log(new),
        "kept": kept,
    }


def area_terms(seen: Array, free: Array, frontier: Array, pose: Pose, there: Pose, actions: int) -> dict[str, float]:
    """The terms about what is around a pose, and the way there."""
    (x, y, heading), (across, down) = there, (there[0] - pose[0], there[1] - pose[1])
    ahead, robot = STEPS[heading], STEPS[pose[2]]
    return {
        **{f"unseen_{radius}": share(~seen, x, y, radius) for radius in (8, 16, 32)},
        "free_ahead": share(free, x + 6 * ahead[0], y + 6 * ahead[1], 4),
        "frontier": share(frontier, x, y, 3) * 7,
        "straight_ahead": across * robot[0] + down * robot[1],
        "winding": actions / (abs(across) + abs(down) + 4),
    }


def summed(weights: dict[str, float], cost: float, terms: dict[str, float]) -> float:
    """Cost and weighted terms."""
    return cost + sum(weights[term] * value for term, value in terms.items())


def candidates(
    observed: Array,
    pose: Pose,
    revealing: Array,
    kept: Pose | None,
    cost: Array,
    weights: dict[str, float],
    sensing: int,
) -> list[Candidate]:
    """The candidates, of the squares row by row. `cost` is the cost-to-go of every cell."""
    seen, free = observed != 0, np.isin(observed, TRAVERSABLE_CLASSES)
    frontier = oracle.frontier_complete(seen, oracle.reachable(free, *pose[:2]))
    distance = oracle.distances_from(free, pose)
    squares: dict[tuple[int, int], list[tuple[float, Any]]] = {}
    for heading, y, x in np.argwhere(revealing).tolist():
        there, actions = (x, y, heading), int(distance[heading, y, x])
        own = pose_terms(seen, there, actions, there == kept, sensing)
        squares.setdefault((y // SIDE, x // SIDE), []).append((summed(weights, cost[y, x], own), (there, actions, own)))
    found = []
    for _, scored in sorted(squares.items(), key=lambda item: item[0]):
        there, actions, own = lowest(scored)
        terms = own | area_terms(seen, free, frontier, pose, there, actions)
        its_cost = float(cost[there[1], there[0]])
        found.append(Candidate(there, its_cost, terms, summed(weights, its_cost, terms)))
    return found


class Chooser:
    """Chooses subgoals, one after the other.

    `estimate` gives the cost-to-go of every cell from the observed classes, about the map and its mirror image in turn.
    """

    def __init__(self, weights: dict[str, float], sensing: int, estimate: Callable[[Array], Array] | None = None):
        self.weights, self.sensing, self.estimate = weights, sensing, estimate
        self.subgoal: Pose | None = None
        self.chosen_from: Array = np.zeros(0)
        self.answers: list[Array] = []
        self.candidates: list[Candidate] = []
        self.choices = 0

    def plan(self, observed: Array, pose: Pose) -> tuple[Mode, list[int] | None]:
        """The mode and the actions of the plan."""
        seen, free = observed != 0, np.isin(observed, TRAVERSABLE_CLASSES)
        reached = oracle.reachable(free, *pose[:2])
        doors = reached & (observed == FRONT_DOOR)
        if doors.any():
            return "to_goal", oracle.plan_to_goal(free, pose, doors, "complete")
        revealing = oracle.frontier_expanding_complete(seen, reached, pose, self.sensing)
        if not revealing.any():
            return "gave_up", None
        view = len(oracle.sensing_offsets(self.sensing, 0))
        if self.subgoal is None or not revealing[self.subgoal[::-1]] or 3 * (seen != self.chosen_from).sum() >= view:
            self._choose(observed, pose, revealing)
        target = np.zeros_like(revealing)
        target[self.subgoal[::-1]] = True
        return "explore", oracle.shortest_actions(free, pose, target)

    def cost(self, observed: Array) -> Array:
        """The mean of the last two answers; zeros before there are any."""
        return np.mean(self.answers[-2:], axis=0) if self.answers else np.zeros(observed.shape)

    def _choose(self, observed: Array, pose: Pose, revealing: Array) -> None:
        if self.estimate and not np.isin(observed, PLAIN_CLASSES).all():
            turn = slice(None, None, -1 if self.choices % 2 else 1)
            self.answers.append(self.estimate(observed[:, turn])[:, turn])
        self.candidates = candidates(
            observed, pose, revealing, self.subgoal, self.cost(observed), self.weights, self.sensing
        )
        self.subgoal = lowest((found.score, found.pose) for found in self.candidates)
        self.chosen_from, self.choices = observed != 0, self.choices + 1


def run_episode(terrain: Array, pose: Pose, chooser: Chooser, max_steps: int) -> tuple[bool, str, Mode]:
    """Run one episode; success, actions as letters, and mode of the last plan."""
    seen, letters, mode = oracle.visible(pose, chooser.sensing, terrain.shape), "", "explore"
    while terrain[pose[1], pose[0]] != FRONT_DOOR:
        if len(letters) == max_steps:
            return False, letters, mode
        mode, actions = chooser.plan(np.where(seen, terrain, 0), pose)
        if actions is None:
            return False, letters, mode
        pose = oracle.moved(pose, actions[0], terrain.shape)
        letters += ACTION_LETTERS[actions[0]]
        seen |= oracle.visible(pose, chooser.sensing, terrain.shape)
    return True, letters, "to_goal"
