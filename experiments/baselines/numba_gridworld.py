"""Episodes in Numba: the same queues and loops as `gridworld.c`, compiled by Numba, on one core.

Importing this module needs Numba. Sets of poses are four byte grids, one a heading; a queue holds a pose a row.
"""

from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from .problem import BASELINES, BaselineName, HeadingOffsets, Outcome, Problem, empty_outcome

_Cells = npt.NDArray[np.uint8]  # 0 or 1, [h w]
_Poses = npt.NDArray[np.uint8]  # [4 h w]
_Queue = npt.NDArray[np.int64]  # x, y and heading, [4 h w, 3]
#: Seen, free and reachable cells; targets, poses found and the first action to each; the queue.
_Robot = tuple[_Cells, _Cells, _Cells, _Poses, _Poses, _Poses, _Queue]

_FORWARD_X = np.array([1, 0, -1, 0])
_FORWARD_Y = np.array([0, 1, 0, -1])
_NO_PLAN = -1
_ORACLE, _FRONTIER_LAZY = BASELINES.index("oracle"), BASELINES.index("frontier_lazy")
_NEAREST, _NEAREST_SMALLEST, _LAZY = 0, 1, 2


def _compiled(function: Any) -> Any:
    """Compile at the first call, and keep the result on disk."""
    return numba.njit(cache=True)(function)


@_compiled
def _moved(x: int, y: int, heading: int, action: int, height: int, width: int) -> tuple[int, int, int]:
    """The pose after an action. A step forward off the map stays in place."""
    if action == 1:
        return x, y, (heading + 3) % 4
    if action == 2:
        return x, y, (heading + 1) % 4
    ahead_x, ahead_y = x + _FORWARD_X[heading], y + _FORWARD_Y[heading]
    if 0 <= ahead_x < width and 0 <= ahead_y < height:
        return ahead_x, ahead_y, heading
    return x, y, heading


@_compiled
def _observe(
    seen: _Cells, free: _Cells, traversable: _Cells, sensing: HeadingOffsets, x: int, y: int, heading: int
) -> None:
    """Add what is seen from a pose."""
    height, width = seen.shape
    for i in range(sensing.first[heading], sensing.first[heading + 1]):
        column, row = x + sensing.dx[i], y + sensing.dy[i]
        if 0 <= column < width and 0 <= row < height:
            seen[row, column] = 1
            free[row, column] = traversable[row, column]


@_compiled
def _find_reachable(reachable: _Cells, free: _Cells, queue: _Queue, x: int, y: int) -> None:
    """Flood the free cells connected to the robot's own."""
    height, width = free.shape
    reachable[:] = 0
    if not free[y, x]:
        return
    head, tail = 0, 1
    reachable[y, x] = 1
    queue[0, 0], queue[0, 1] = x, y
    while head < tail:
        column, row = queue[head, 0], queue[head, 1]
        head += 1
        for heading in range(4):
            next_column, next_row = column + _FORWARD_X[heading], row + _FORWARD_Y[heading]
            inside = 0 <= next_column < width and 0 <= next_row < height
            if inside and free[next_row, next_column] and not reachable[next_row, next_column]:
                reachable[next_row, next_column] = 1
                queue[tail, 0], queue[tail, 1] = next_column, next_row
                tail += 1


@_compiled
def _wanted(seen: _Cells, x: int, y: int) -> bool:
    """Is a cell one that frontier-expanding poses cover: seen, with an unseen neighbor?"""
    height, width = seen.shape
    if not seen[y, x]:
        return False
    for heading in range(4):
        column, row = x + _FORWARD_X[heading], y + _FORWARD_Y[heading]
        if 0 <= column < width and 0 <= row < height and not seen[row, column]:
            return True
    return False


@_compiled
def _target_frontier_expanding(robot: _Robot, kernel: HeadingOffsets, x: int, y: int, heading: int) -> None:
    """Target the frontier-expanding poses: reachable, not the current one, covering a wanted cell."""
    seen, _, reachable, targets, _, _, queue = robot
    height, width = seen.shape
    count = 0
    for row in range(height):
        for column in range(width):
            if _wanted(seen, column, row):
                queue[count, 0], queue[count, 1] = column, row
                count += 1
    targets[:] = 0
    for k in range(4):
        for i in range(kernel.first[k], kernel.first[k + 1]):
            for place in range(count):
                column, row = queue[place, 0] - kernel.dx[i], queue[place, 1] - kernel.dy[i]
                if 0 <= column < width and 0 <= row < height and reachable[row, column]:
                    targets[k, row, column] = 1
    targets[heading, y, x] = 0


@_compiled
def _covers_wanted(robot: _Robot, kernel: HeadingOffsets, x: int, y: int, heading: int) -> bool:
    """Does a pose cover a wanted cell?"""
    seen = robot[0]
    height, width = seen.shape
    for i in range(kernel.first[heading], kernel.first[heading + 1]):
        column, row = x + kernel.dx[i], y + kernel.dy[i]
        if 0 <= column < width and 0 <= row < height and _wanted(seen, column, row):
            return True
    return False


@_compiled
def _first_action(
    robot: _Robot, ground: _Cells, kernel: HeadingOffsets, x: int, y: int, heading: int, choice: int
) -> int:
    """First action of the plan to the nearest target, `_NO_PLAN` where there is none. See `gridworld.c`."""
    _, _, _, targets, found, first, queue = robot
    height, width = ground.shape
    head, tail, level_end, best, best_action = 0, 1, 1, 4, _NO_PLAN
    found[:] = 0
    found[heading, y, x] = 1
    queue[0, 0], queue[0, 1], queue[0, 2] = x, y, heading
    while head < tail:
        if head == level_end:
            if best_action != _NO_PLAN:
                break
            level_end = tail
        column, row, turned = queue[head, 0], queue[head, 1], queue[head, 2]
        if choice == _LAZY:
            hit = head > 0 and _covers_wanted(robot, kernel, column, row, turned)
        else:
            hit = targets[turned, row, column] == 1
        if hit:
            if choice != _NEAREST_SMALLEST:
                return first[turned, row, column]
            # All targets stand on one cell then, so the heading alone decides.
            if turned < best:
                best, best_action = turned, first[turned, row, column]
        for action in range(3):
            next_x, next_y, next_heading = _moved(column, row, turned, action, height, width)
            if not found[next_heading, next_y, next_x] and ground[next_y, next_x]:
                found[next_heading, next_y, next_x] = 1
                first[next_heading, next_y, next_x] = action if head == 0 else first[turned, row, column]
                queue[tail, 0], queue[tail, 1], queue[tail, 2] = next_x, next_y, next_heading
                tail += 1
        head += 1
    return best_action


@_compiled
def _target_goals(targets: _Poses, goals: _Cells, among: _Cells, first_only: bool) -> bool:
    """Target the poses on goal cells: all of them, or those on the first cell alone. Are there any?"""
    height, width = goals.shape
    found = False
    targets[:] = 0
    for row in range(height):
        for column in range(width):
            if goals[row, column] and among[row, column]:
                targets[:, row, column] = 1
                found = True
                if first_only:
                    return True
    return found


@_compiled
def _plan(
    robot: _Robot,
    traversable: _Cells,
    goals: _Cells,
    kernel: HeadingOffsets,
    planner: int,
    x: int,
    y: int,
    heading: int,
) -> int:
    """The next action, or `_NO_PLAN` to give up."""
    _, free, reachable, targets, _, _, queue = robot
    ground, choice = free, _NEAREST
    if planner == _ORACLE:
        ground = traversable
        _target_goals(targets, goals, traversable, False)
    else:
        _find_reachable(reachable, free, queue, x, y)
        if _target_goals(targets, goals, reachable, True):
            choice = _NEAREST_SMALLEST
        elif planner == _FRONTIER_LAZY:
            choice = _LAZY
        else:
            _target_frontier_expanding(robot, kernel, x, y, heading)
    return _first_action(robot, ground, kernel, x, y, heading, choice)


@_compiled
def _run_episodes(
    traversable: npt.NDArray[np.uint8],
    goals: npt.NDArray[np.uint8],
    world: npt.NDArray[np.int32],
    start: npt.NDArray[np.int32],
    sensing: HeadingOffsets,
    kernel: HeadingOffsets,
    planner: int,
    step_limit: int,
    outcome: Outcome,
) -> None:
    """Run episodes one after another; see `Problem` and `Outcome`."""
    steps, success, actions = outcome
    _, height, width = traversable.shape
    cells, poses = (height, width), (4, height, width)
    seen, free, reachable = np.zeros(cells, np.uint8), np.zeros(cells, np.uint8), np.zeros(cells, np.uint8)
    targets, found, first = np.zeros(poses, np.uint8), np.zeros(poses, np.uint8), np.zeros(poses, np.uint8)
    queue = np.zeros((4 * height * width, 3), np.int64)
    robot = (seen, free, reachable, targets, found, first, queue)
    for episode in range(len(world)):
        ground, doors = traversable[world[episode]], goals[world[episode]]
        x, y, heading = np.int64(start[episode, 0]), np.int64(start[episode, 1]), np.int64(start[episode, 2])
        seen[:], free[:] = 0, 0
        _observe(seen, free, ground, sensing, x, y, heading)
        count = 0
        while not doors[y, x] and count < step_limit:
            action = _plan(robot, ground, doors, kernel, planner, x, y, heading)
            if action == _NO_PLAN:
                break
            x, y, heading = _moved(x, y, heading, action, height, width)
            _observe(seen, free, ground, sensing, x, y, heading)
            actions[episode, count] = action
            count += 1
        steps[episode] = count
        success[episode] = doors[y, x]


def run_episodes(problem: Problem, planner: BaselineName) -> Outcome:
    """Run every episode, one after another on one core."""
    outcome = empty_outcome(problem)
    _run_episodes(
        problem.traversable,
        problem.goals,
        problem.world,
        problem.start,
        problem.sensing,
        problem.expanding,
        BASELINES.index(planner),
        problem.step_limit,
        outcome,
    )
    return outcome
