"""What `MetricPlanner` promises, in plain loops over cells: what is left to explore, and what a robot has looked at.

Cells are (column, row), counted from the origin of the map frame along the map's rows, with y upward.
"""

import collections
import functools
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

FREE, OCCUPIED, UNKNOWN = 0, 100, -1

#: Quarter turns counterclockwise, as (dx, dy).
TURNS = ((1, 0), (0, 1), (-1, 0), (0, -1))

Cell = tuple[int, int]

#: A cell and the free cells beside it, as (dx, dy).
Looked = tuple[Cell, frozenset[Cell]]


class Ground:
    """A map in cells of `factor` pixels along a side: each is occupied, else unknown, else free, as its worst pixel.

    The robot's own cell and doors are free. So that doors beside the map count, some unknown cells surround it.
    """

    def __init__(self, grid: Any, factor: int, pose: tuple[float, float, float], doors=()):
        self.size, self.yaw, self.resolution = factor * grid.resolution, grid.origin.yaw, grid.resolution
        along = [meters / grid.resolution for meters in self._turned(*grid.origin[:2])]
        first = [math.floor(pixels + 0.01) for pixels in along]
        self._offset = [(pixels - whole) * grid.resolution for pixels, whole in zip(along, first, strict=True)]
        badness = np.select([grid.cells == OCCUPIED, grid.cells == UNKNOWN], [2, 1], 0)
        frame = [
            (start % factor + 2 * factor, -(start + count) % factor + 2 * factor)
            for start, count in zip(first[::-1], badness.shape, strict=True)
        ]
        badness = np.pad(badness, frame, constant_values=1)
        rows, columns = (count // factor for count in badness.shape)
        worst = badness.reshape(rows, factor, columns, factor).max((1, 3))
        self._corner = first[0] // factor - 2, first[1] // factor - 2
        self.robot, self.heading = self.pose(pose)
        self.doors = {self.cell(*door) for door in doors}
        is_free = worst == 0
        for x, y in (self.robot, *self.doors):
            x, y = x - self._corner[0], y - self._corner[1]
            if 0 <= x < columns and 0 <= y < rows:
                is_free[y, x], worst[y, x] = True, 0
        parts, _ = ndimage.label(is_free)
        self.free, self.occupied = self._cells(is_free), self._cells(worst == 2)
        at_robot = parts[self.robot[1] - self._corner[1], self.robot[0] - self._corner[0]]
        self.reachable = self._cells(parts == at_robot)

    def _cells(self, chosen: np.ndarray) -> set[Cell]:
        rows, columns = np.nonzero(chosen)
        left, bottom = self._corner
        return set(zip((columns + left).tolist(), (rows + bottom).tolist(), strict=True))

    def _turned(self, x: float, y: float) -> tuple[float, float]:
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return x * cos + y * sin, y * cos - x * sin

    def cell(self, x: float, y: float) -> Cell:
        """The cell that holds a point of the map frame."""
        right, up = ((at - off) / self.size for at, off in zip(self._turned(x, y), self._offset, strict=True))
        return math.floor(right), math.floor(up)

    def pose(self, pose: tuple[float, float, float]) -> tuple[Cell, int]:
        """Cell and nearest quarter turn."""
        return self.cell(*pose[:2]), round((pose[2] - self.yaw) / (math.pi / 2)) % 4

    def is_unknown(self, cell: Cell) -> bool:
        return cell not in self.free and cell not in self.occupied

    def looked(self, cell: Cell) -> Looked:
        return cell, frozenset((dx, dy) for dx, dy in TURNS if (cell[0] + dx, cell[1] + dy) in self.free)

    def frontier(self) -> set[Cell]:
        """Unknown cells beside reachable ones."""
        beside = {(x + dx, y + dy) for x, y in self.reachable for dx, dy in TURNS}
        return {cell for cell in beside if self.is_unknown(cell)}


class View(NamedTuple):
    """Unknown cells in view: those in plain sight, and all that are if walls hide as little as they may."""

    surely: set[Cell]
    maybe: set[Cell]


@functools.cache
def _offsets(reach: int, degrees: float) -> list[tuple[Cell, list[Cell]]]:
    """Offsets in view when facing +x, the nearest first; and the cells before each one on the line to the robot."""
    near = range(-reach, reach + 1)
    found = []
    for dx, dy in sorted(((x, y) for x in near for y in near if (x, y) != (0, 0)), key=lambda at: max(map(abs, at))):
        if math.hypot(dx, dy) > reach or (
            degrees < 360 and math.degrees(math.atan2(abs(dy), dx)) >= degrees / 2 - 1e-9
        ):
            continue
        longest = max(abs(dx), abs(dy))
        exact = [at * (longest - 1) / longest for at in (dx, dy)]
        before = {
            (a, b)
            for a in {math.floor(exact[0] + 1e-9), math.ceil(exact[0] - 1e-9)}
            for b in {math.floor(exact[1] + 1e-9), math.ceil(exact[1] - 1e-9)}
        }
        found.append(((dx, dy), sorted(before)))
    return found


def view(ground: Ground, pose: tuple[Cell, int], reach: int, degrees: float) -> View:
    """The unknown cells in view from a pose; walls hide what is behind them."""
    (x, y), (fx, fy) = pose[0], TURNS[pose[1]]

    def cell(offset: Cell) -> Cell:
        return x + offset[0] * fx - offset[1] * fy, y + offset[0] * fy + offset[1] * fx

    surely, maybe = {(0, 0)}, {(0, 0)}
    for offset, before in _offsets(reach, degrees):
        clear = {near for near in before if near == (0, 0) or cell(near) not in ground.occupied}
        if all(near in surely & clear for near in before):
            surely.add(offset)
        if maybe & clear:
            maybe.add(offset)
    return View(*({at for at in map(cell, seen) if ground.is_unknown(at)} for seen in (surely, maybe)))


class Promises:
    """Follows the calls of a `MetricPlanner` for occupancy maps, and checks its decisions."""

    def __init__(self, cell_size: float, smallest_cell: float, sensing_range: float, degrees: float):
        self._cell_size, self._smallest, self._range, self._degrees = cell_size, smallest_cell, sensing_range, degrees
        #: Cells that were looked at in vain, by their size: those in plain sight, and all that may have been in view.
        self._surely: dict[float, set[Looked]] = collections.defaultdict(set)
        self._maybe: dict[float, set[Looked]] = collections.defaultdict(set)
        self._last: tuple[Ground, Any] | None = None
        self._pending: tuple[View, float] | None = None

    def _view(self, pose, ground: Ground) -> View:
        seen = view(ground, ground.pose(pose), self._reach(ground), self._degrees)
        # What is in view from ground that the map has forgotten is left open.
        return seen if ground.pose(pose)[0] in ground.free else View(set(), seen.maybe)

    def _reach(self, ground: Ground) -> int:
        return math.floor(self._range / ground.size + 1e-4)

    def set_aside(self, pose) -> None:
        """What is in view from here on the last map does not count from now on."""
        if self._last is not None:
            self._put_aside(self._view(pose, self._last[0]), self._last[0])

    def _put_aside(self, seen: View, ground: Ground) -> None:
        for cells, aside in (seen.surely, self._surely), (seen.maybe, self._maybe):
            aside[round(ground.size, 6)] |= {ground.looked(cell) for cell in cells if ground.is_unknown(cell)}

    def check(self, grid, pose, doors, decision) -> None:
        """Check a decision on a map."""
        now = grid.origin.yaw, grid.resolution
        if self._last is not None and not np.allclose(now, (self._last[0].yaw, self._last[0].resolution), 0, 1e-7):
            self._surely.clear()
            self._maybe.clear()
            self._last = self._pending = None
        if self._pending is not None:
            seen, size = self._pending
            self._put_aside(seen, Ground(grid, round(size / grid.resolution), pose, doors))
        self._pending = None
        factor = round(decision.cell_size / grid.resolution)
        ground = Ground(grid, factor, pose, doors)
        if self._last is not None:
            before, last = self._last
            if last.mode == "explore":
                away = math.dist(pose[:2], last.subgoal[:2])
                if away <= before.size and before.pose(pose)[1] == before.pose(last.subgoal)[1]:
                    now = Ground(grid, round(before.size / grid.resolution), pose, doors)
                    self._pending = self._view(last.subgoal, now), before.size
        {"gave_up": self._check_stop, "explore": self._check_exploring, "to_goal": self._check_going}[decision.mode](
            grid, pose, doors, decision, ground
        )
        self._last = ground, decision

    def _check_path(self, pose, decision, ground: Ground) -> None:
        assert decision.path[0] == tuple(pose), "the path starts elsewhere"
        assert decision.path[-1] == decision.subgoal or len(decision.path) == 1
        poses = [ground.pose(each) for each in decision.path]
        for (before, turn), (after, then) in itertools.pairwise(poses):
            step = after[0] - before[0], after[1] - before[1]
            assert (step == TURNS[turn] and turn == then) or (step == (0, 0) and (then - turn) % 4 in (1, 3)), "a jump"
        assert all(cell in ground.free for cell, _ in poses), "the path leaves free ground"

    def _check_going(self, grid, pose, doors, decision, ground) -> None:
        self._check_path(pose, decision, ground)
        assert ground.pose(decision.subgoal)[0] in ground.doors & ground.reachable

    def _check_exploring(self, grid, pose, doors, decision, ground: Ground) -> None:
        assert not ground.doors & ground.reachable, "explores, but a door is reachable"
        self._check_path(pose, decision, ground)
        size = round(ground.size, 6)
        left = {cell for cell in ground.frontier() if ground.looked(cell) not in self._surely[size]}
        assert left & self._view(decision.subgoal, ground).maybe, "nothing to see there"

    def _check_stop(self, grid, pose, doors, decision, ground) -> None:
        smallest, factor = (
            max(1, math.ceil(size / grid.resolution - 1e-4)) for size in (self._smallest, self._cell_size)
        )
        assert math.isclose(decision.cell_size, min(smallest, factor) * grid.resolution), "stopped at large cells"
        while True:
            ground = Ground(grid, factor, pose, doors)
            assert not ground.doors & ground.reachable, "stopped, but a door is reachable"
            size = round(ground.size, 6)
            left = {cell for cell in ground.frontier() if ground.looked(cell) not in self._maybe[size]}
            if all(self._is_ahead(ground, cell) for cell in left):
                left = set()
            assert not left, f"stopped with a reachable frontier of {len(left)} cells of {size} m"
            if factor <= smallest:
                return
            factor = max(factor // 2, smallest)

    @staticmethod
    def _is_ahead(ground: Ground, cell: Cell) -> bool:
        """Whether a cell touches no reachable ground but the robot's, and the robot faces it."""
        at = [(dx, dy) for dx, dy in TURNS if (cell[0] - dx, cell[1] - dy) in ground.reachable]
        return at == [TURNS[ground.heading]] and (cell[0] - at[0][0], cell[1] - at[0][1]) == ground.robot
