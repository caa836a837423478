"""Slow, obviously right gridworld: what a robot sees, where it may go, what it plans, how an episode runs.

Queues, dictionaries and boolean arrays only. Grids are indexed [y, x], stacks of them [heading, y, x]; a pose
is (x, y, heading) with y growing downward and headings 0 = +x, 1 = +y, 2 = -x, 3 = -y. Actions are 0 forward,
1 left (heading - 1), 2 right (heading + 1).
"""

import functools
import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np

Array = np.ndarray
Pose = tuple[int, int, int]
Offset = tuple[int, int]
Rules = Literal["reference", "complete"]
PlannerName = Literal["oracle", "frontier", "dc2g"]
Mode = Literal["explore", "to_goal", "gave_up"]
CostToGo = Array | Callable[[Array, Array], Array]

FRONT_DOOR = 1
TRAVERSABLE_CLASSES = (1, 3, 4, 6, 8, 15)  # front_door, road, driveway, path, sidewalk, traversable
STEPS: tuple[Offset, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))  # heading -> (dx, dy)
ACTION_LETTERS = "FLR"


# ---- sensing ----


def _forward_and_sideways(dx: int, dy: int, heading: int) -> tuple[int, int]:
    """Return an offset's components along the heading and along its right-hand side."""
    ahead_x, ahead_y = STEPS[heading]
    right_x, right_y = STEPS[(heading + 1) % 4]
    return dx * ahead_x + dy * ahead_y, dx * right_x + dy * right_y


def _in_wedge(dx: int, dy: int, heading: int) -> bool:
    """Tell whether the angle between offset and heading is strictly less than 45 degrees."""
    forward, sideways = _forward_and_sideways(dx, dy, heading)
    return abs(sideways) < forward


def _in_view(dx: int, dy: int, heading: int, degrees: float) -> bool:
    """Tell whether the angle between offset and heading is strictly less than half of the field of view, if not 360."""
    forward, sideways = _forward_and_sideways(dx, dy, heading)
    if degrees in (90, 180):  # no rounding
        return abs(sideways) < forward if degrees == 90 else forward > 0
    return degrees == 360 or forward > math.cos(math.radians(degrees / 2)) * math.hypot(dx, dy) + 1e-9


@functools.cache
def sensing_offsets(radius: int, heading: int, degrees: float = 90) -> tuple[Offset, ...]:
    """Offsets (dx, dy) from the robot of the cells it sees, its own included, in raster order."""
    span = range(-radius, radius + 1)
    return tuple(
        (dx, dy)
        for dy in span
        for dx in span
        if (dx, dy) == (0, 0) or (dx * dx + dy * dy <= radius * radius and _in_view(dx, dy, heading, degrees))
    )


@functools.cache
def expanding_offsets(radius: int, heading: int) -> tuple[Offset, ...]:
    """Offsets (dx, dy) from the robot to a frontier cell it expands, rules `reference`, in raster order."""
    span = range(-radius, radius + 1)
    wedge = {
        (dx, dy) for dy in span for dx in span if dx * dx + dy * dy < radius * radius and _in_wedge(dx, dy, heading)
    }
    square = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    kept = {(dx, dy) for dx, dy in wedge if all((dx + i, dy + j) in wedge for i, j in square)}
    ahead_x, ahead_y = STEPS[heading]
    kept |= {(cells * ahead_x, cells * ahead_y) for cells in (0, 1, 2)}
    return tuple(sorted(kept, key=lambda offset: (offset[1], offset[0])))


def visible(pose: Pose, radius: int, shape: tuple[int, int], degrees: float = 90) -> Array:
    """Cells seen from a pose: bool [h w]."""
    x, y, heading = pose
    height, width = shape
    seen = np.zeros(shape, bool)
    for dx, dy in sensing_offsets(radius, heading, degrees):
        if 0 <= x + dx < width and 0 <= y + dy < height:
            seen[y + dy, x + dx] = True
    return seen


@functools.cache
def _looked_through(radius: int, heading: int, degrees: float) -> tuple[tuple[Offset, Offset], ...]:
    """The offsets (dx, dy) in view and those that they are looked at through, ring by ring.

    From one square ring to the next: a cell is looked at through the one in view, a step nearer along x or y, whichever
    is longer, that is nearest to the straight line; of two equally near ones, through the one nearer to the axis.
    """
    in_view = sorted(set(sensing_offsets(radius, heading, degrees)) - {(0, 0)}, key=lambda one: max(map(abs, one)))
    through = []
    for offset in in_view:
        axis = 0 if abs(offset[0]) >= abs(offset[1]) else 1
        step = offset[axis] - (1 if offset[axis] > 0 else -1)
        exact = offset[1 - axis] * step / offset[axis]
        before = [one for one in ((0, 0), *in_view) if one[axis] == step]
        through.append(min(before, key=lambda one: (abs(one[1 - axis] - exact), abs(one[1 - axis]))))
    return tuple(zip(in_view, through, strict=True))


def visible_past(opaque: Array, pose: Pose, radius: int, degrees: float = 90) -> Array:
    """Cells seen from a pose where opaque cells hide what is behind them: bool [h w]."""
    x, y, heading = pose
    height, width = opaque.shape
    seen = np.zeros(opaque.shape, bool)
    seen[y, x] = True
    clear = {(0, 0): True}
    for (dx, dy), through in _looked_through(radius, heading, degrees):
        column, row = x + dx, y + dy
        inside = 0 <= column < width and 0 <= row < height
        clear[dx, dy] = clear[through] and not (inside and opaque[row, column])
        if inside and clear[through]:
            seen[row, column] = True
    return seen


def _counts(cells: Array, offsets: Sequence[Offset]) -> Array:
    """For each cell, at how many of the offsets from it one of `cells` lies: int [h w]."""
    height, width = cells.shape
    margin = max(abs(part) for offset in offsets for part in offset)
    framed = np.pad(cells, margin).astype(np.int64)
    counts = np.zeros(cells.shape, np.int64)
    for dx, dy in offsets:
        counts += framed[margin + dy : margin + dy + height, margin + dx : margin + dx + width]
    return counts


def _sources(cells: Array, offsets: Sequence[Offset]) -> Array:
    """Cells from which at least one of `cells` lies at one of the offsets: bool [h w]."""
    return _counts(cells, offsets) > 0


# ---- frontiers ----


def _neighbor_of(cells: Array) -> Array:
    """Cells that have a 4-neighbor among `cells`: bool [h w]."""
    return _sources(cells, list(STEPS))


def reachable(free: Array, x: int, y: int) -> Array:
    """Free cells 4-connected to (x, y) through free cells: bool [h w]. Empty where (x, y) is not free."""
    height, width = free.shape
    is_free = free.tolist()
    reached = np.zeros(free.shape, bool)
    if not is_free[y][x]:
        return reached
    found = {(x, y)}
    queue = deque(found)
    while queue:
        column, row = queue.popleft()
        reached[row, column] = True
        for dx, dy in STEPS:
            cell = (column + dx, row + dy)
            inside = 0 <= cell[0] < width and 0 <= cell[1] < height
            if inside and is_free[cell[1]][cell[0]] and cell not in found:
                found.add(cell)
                queue.append(cell)
    return reached


def frontier_reference(seen: Array) -> Array:
    """Seen cells, traversable or not, with an unseen in-bounds 4-neighbor: bool [h w]."""
    return seen & _neighbor_of(~seen)


def frontier_complete(seen: Array, reachable: Array) -> Array:
    """Reachable cells with an unseen in-bounds 4-neighbor: bool [h w]."""
    return reachable & _neighbor_of(~seen)


def frontier_expanding_reference(seen: Array, reachable: Array, pose: Pose, radius: int) -> Array:
    """Reachable poses whose expanding kernel covers a frontier cell, less the current one: bool [4 h w]."""
    frontier = frontier_reference(seen)
    return _expanding(frontier, reachable, pose, [expanding_offsets(radius, heading) for heading in range(4)])


def frontier_expanding_complete(seen: Array, reachable: Array, pose: Pose, radius: int, degrees: float = 90) -> Array:
    """Reachable poses that see an unseen neighbor of a frontier cell, less the current one: bool [4 h w]."""
    wanted = ~seen & _neighbor_of(frontier_complete(seen, reachable))
    return _expanding(wanted, reachable, pose, [sensing_offsets(radius, heading, degrees) for heading in range(4)])


def _expanding(wanted: Array, reachable: Array, pose: Pose, kernels: Sequence[Sequence[Offset]]) -> Array:
    x, y, heading = pose
    poses = np.stack([reachable & _sources(wanted, kernel) for kernel in kernels])
    poses[heading, y, x] = False
    return poses


# ---- search ----


def _breadth_first(free: Array, pose: Pose, parents: dict[Pose, tuple[Pose, int] | None]) -> Iterator[Pose]:
    """Yield poses nearest first, filling `parents`: forward, left, right; first in, first out."""
    height, width = free.shape
    is_free = free.tolist()
    parents[pose] = None
    queue = deque([pose])
    while queue:
        current = queue.popleft()
        yield current
        x, y, heading = current
        dx, dy = STEPS[heading]
        children = [(x + dx, y + dy, heading), (x, y, (heading - 1) % 4), (x, y, (heading + 1) % 4)]
        for action, child in enumerate(children):
            if not (0 <= child[0] < width and 0 <= child[1] < height):
                continue
            if is_free[child[1]][child[0]] and child not in parents:
                parents[child] = (current, action)
                queue.append(child)


def _actions_to(target: Pose, parents: dict[Pose, tuple[Pose, int] | None]) -> list[int]:
    """Trace a pose back to the root of the search."""
    actions = []
    step = parents[target]
    while step is not None:
        previous, action = step
        actions.append(action)
        step = parents[previous]
    return actions[::-1]


def shortest_actions(free: Array, pose: Pose, is_target: Array) -> list[int] | None:
    """First plan breadth-first search finds to a pose of `is_target` (bool [4 h w]); None without one."""
    parents: dict[Pose, tuple[Pose, int] | None] = {}
    targets = is_target.tolist()
    for x, y, heading in _breadth_first(free, pose, parents):
        if targets[heading][y][x]:
            return _actions_to((x, y, heading), parents)
    return None


def distances_from(free: Array, pose: Pose) -> Array:
    """Actions needed from a pose to every other: int [4 h w], -1 where there is no path."""
    distances = np.full((4, *free.shape), -1)
    parents: dict[Pose, tuple[Pose, int] | None] = {}
    for x, y, heading in _breadth_first(free, pose, parents):
        step = parents[x, y, heading]
        previous = step[0] if step else None
        distances[heading, y, x] = distances[previous[2], previous[1], previous[0]] + 1 if previous else 0
    return distances


def _grown(cells: Array) -> Array:
    """Dilate by a 3x3 square."""
    return _sources(cells, [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)])


def cost_to_go(traversable: Array, goals: Array) -> Array:
    """Least travel cost to the nearest goal, 8-connected: float64 [h w]; inf where there is no path.

    While no goal cell is traversable, the goal is grown by a 3x3 square; then its traversable cells cost 0.
    """
    height, width = traversable.shape
    costs = np.full((height, width), np.inf)
    if not (goals.any() and traversable.any()):
        return costs
    while not (goals & traversable).any():
        goals = _grown(goals)
    queue = [(0.0, int(x), int(y)) for y, x in np.argwhere(goals & traversable)]
    for _, x, y in queue:
        costs[y, x] = 0.0
    heapq.heapify(queue)
    moves = [(dx, dy, math.hypot(dx, dy)) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (dx, dy) != (0, 0)]
    while queue:
        cost, x, y = heapq.heappop(queue)
        if cost > costs[y, x]:
            continue
        for dx, dy, length in moves:
            column, row = x + dx, y + dy
            if not (0 <= column < width and 0 <= row < height) or not traversable[row, column]:
                continue
            if cost + length < costs[row, column]:
                costs[row, column] = cost + length
                heapq.heappush(queue, (cost + length, column, row))
    return costs


# ---- planners ----


def plan_to_goal(free: Array, pose: Pose, goals: Array, rules: Rules) -> list[int]:
    """Plan to a goal cell known to be reachable (`goals` holds reachable cells only)."""
    if rules == "complete":
        actions = shortest_actions(free, pose, np.stack([goals] * 4))
        assert actions is not None
        return actions
    y, x = (int(index) for index in np.argwhere(goals)[0])
    parents: dict[Pose, tuple[Pose, int] | None] = {}
    for _ in _breadth_first(free, pose, parents):
        pass
    plans = [_actions_to((x, y, heading), parents) for heading in range(4)]
    return min(plans, key=len)  # the first of the shortest: the smaller heading index


def lowest_cost_poses(poses: Array, costs: Array) -> Array:
    """Poses of the set (bool [4 h w]) whose cell has the lowest cost-to-go (float [h w]) in the set."""
    if not poses.any():
        return poses
    lowest = costs[poses.any(axis=0)].min()
    return poses & (costs == lowest)


def explore_poses(
    seen: Array, reached: Array, pose: Pose, *, rules: Rules, sensing_radius: int, expanding_radius: int
) -> Array:
    """Frontier-expanding poses by either rule set: bool [4 h w]."""
    if rules == "reference":
        return frontier_expanding_reference(seen, reached, pose, expanding_radius)
    return frontier_expanding_complete(seen, reached, pose, sensing_radius)


def moved(pose: Pose, action: int, shape: tuple[int, int]) -> Pose:
    """Pose after an action. Forward off the map stays in place; what lies ahead is not looked at."""
    x, y, heading = pose
    if action == 1:
        return x, y, (heading - 1) % 4
    if action == 2:
        return x, y, (heading + 1) % 4
    dx, dy = STEPS[heading]
    inside = 0 <= x + dx < shape[1] and 0 <= y + dy < shape[0]
    return (x + dx, y + dy, heading) if inside else pose


def driven(pose: Pose, action: int, traversable: Array) -> Pose:
    """Pose after an action. Forward off the map or into a cell that is not traversable stays in place."""
    x, y, heading = moved(pose, action, traversable.shape)
    return (x, y, heading) if traversable[y, x] else (*pose[:2], heading)


def revealing_poses(
    poses: Array, seen: Array, reached: Array, pose: Pose, *, sensing_radius: int, expanding_radius: int
) -> Array:
    """Poses dc2g chooses among: those of `poses` that reveal something, or all that do where none of them does."""
    radii = {"sensing_radius": sensing_radius, "expanding_radius": expanding_radius}
    revealing = explore_poses(seen, reached, pose, rules="complete", **radii)
    return poses & revealing if (poses & revealing).any() else revealing


def run_episode(
    terrain: Array,
    pose: Pose,
    planner: PlannerName,
    *,
    rules: Rules,
    sensing_radius: int,
    expanding_radius: int,
    max_steps: int,
    cost_to_go: CostToGo | None = None,
    goals: Array | None = None,
) -> tuple[bool, str, Mode]:
    """Run one episode on terrain classes [h w]; return success, actions as letters, mode of the last plan.

    `goals` (bool [h w]) are all front doors unless given. `dc2g` takes a cost-to-go grid or a function of
    (seen, observed terrain), unseen terrain being 0, and goes where something is revealed. It chooses anew at every
    step. A start on a goal cell is a success without an action.
    """
    traversable = np.isin(terrain, TRAVERSABLE_CLASSES)
    goals = terrain == FRONT_DOOR if goals is None else goals
    oracle_actions = shortest_actions(traversable, pose, np.stack([goals] * 4)) if planner == "oracle" else None
    seen = visible(pose, sensing_radius, terrain.shape)
    letters: list[str] = []
    mode: Mode = "explore"
    while not goals[pose[1], pose[0]]:
        if len(letters) == max_steps:
            return False, "".join(letters), mode
        free = seen & traversable
        reached = reachable(free, pose[0], pose[1])
        actions: list[int] | None
        if planner == "oracle":
            mode, actions = "to_goal", oracle_actions[len(letters) :] if oracle_actions else None
        elif (goals & reached).any():
            mode, actions = "to_goal", plan_to_goal(free, pose, goals & reached, rules)
        else:
            radii = {"sensing_radius": sensing_radius, "expanding_radius": expanding_radius}
            poses = explore_poses(seen, reached, pose, rules=rules, **radii)
            if planner == "dc2g":
                assert cost_to_go is not None
                costs = cost_to_go(seen, np.where(seen, terrain, 0)) if callable(cost_to_go) else cost_to_go
                poses = lowest_cost_poses(revealing_poses(poses, seen, reached, pose, **radii), costs)
            mode, actions = "explore", shortest_actions(free, pose, poses)
        if actions is None:
            return False, "".join(letters), "gave_up"
        pose = moved(pose, actions[0], terrain.shape)
        letters.append(ACTION_LETTERS[actions[0]])
        seen |= visible(pose, sensing_radius, terrain.shape)
    return True, "".join(letters), "to_goal"
