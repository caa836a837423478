"""Random stories of a robot that explores with a map that misbehaves, in plain NumPy.

The robot builds an occupancy grid of a part of a real map with a lidar. Its map closes loops, grows, is published at
another resolution, inflated or in part forgotten; passages shut and open, and the robot gets stuck or lost.
"""

import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from dc2g_jax._src.grid.map_frame import MapFrame
from dc2g_jax._src.planning.metric import MetricPlanner
from dc2g_jax._src.planning.metric_map import MetricMap
from dc2g_jax._src.readers.occupancy import read_occupancy_map
from tests.oracles.metric_oracle import FREE, OCCUPIED, UNKNOWN, Promises

#: Meters of a pixel as in a message, of the planner's cells and of the smallest ones; and how far the robot sees.
PIXEL, CELL, SMALLEST, RANGE = float(np.float32(0.1)), 0.2, 0.1, 1.0

#: Pixels along a side of the world, one of these.
SIDES = (18, 24, 30)

#: Pixels around the world, into which a map may be moved.
FRAME = 12

#: Decisions while the map misbehaves, and most decisions after that.
NOISY, MOST = 10, 300

#: A subgoal that the robot has failed to reach so often is set aside, as the node for ROS 2 does.
TRIES = 2


class Told(NamedTuple):
    """A story: how it ended, its decisions, the slowest one in seconds, and the free ground that was not seen."""

    end: str
    decisions: int
    slowest: float
    unseen: float


class Story:
    """One robot in one world.

    Attributes:
      free: ground that the robot can drive on, bool [h w], y upward.
      known: what the robot has seen, int8 [h w].
    """

    def __init__(self, world: np.ndarray, rng: np.random.Generator, degrees: float):
        self.side = len(world)
        self.rng, self.free, self.degrees = rng, world.copy(), degrees
        self.known = np.full(world.shape, UNKNOWN, np.int8)
        self.specks = rng.random(world.shape) < rng.choice([0.0, 0.0, 0.003, 0.01])
        self.glass = ~world & self._blob(rng.integers(0, 4), 6)
        self.range = RANGE * rng.uniform(0.8, 1.3)
        row, column = rng.choice(np.argwhere(world))
        self.x, self.y, self.yaw = column + rng.uniform(0.1, 0.9), row + rng.uniform(0.1, 0.9), rng.uniform(-3, 3)
        # The map: how it is turned and moved against the world, and the grid against the map frame.
        self.turn, self.jump, self.grid_yaw = 0.0, (0.0, 0.0), 0.0
        self.scale, self.inflation, self.stuck, self.lost = 1.0, 0, 0, (0.0, 0.0)
        self.fraction = float(rng.choice([0.0, 0.25]))
        self.doors: list[tuple[float, ...]] = []
        self.shut: list[np.ndarray] = []

    # --- the world ----------------------------------------------------------------------------------------------------

    def _blob(self, count: int, size: int) -> np.ndarray:
        """Random rectangles."""
        cells = np.zeros(self.free.shape, bool)
        for _ in range(count):
            y, x = (self.rng.integers(side) for side in self.free.shape)
            height, width = self.rng.integers(1, size + 1, 2)
            cells[y : y + height, x : x + width] = True
        return cells

    def look(self) -> None:
        """What a lidar sees. Rays go through glass, which stays unknown."""
        directions = self.yaw + np.radians(self.degrees) * (np.arange(160) / 159 - 0.5)
        along = np.arange(0, self.range / PIXEL, 0.5)
        x = np.floor(self.x + along * np.cos(directions)[:, None]).astype(int)
        y = np.floor(self.y + along * np.sin(directions)[:, None]).astype(int)
        inside = (x >= 0) & (x < self.side) & (y >= 0) & (y < self.side)
        x, y = x.clip(0, self.side - 1), y.clip(0, self.side - 1)
        stops = (~self.free & ~self.glass)[y, x] | ~inside
        before = np.cumsum(stops, axis=1)
        is_free, is_hit = (before == 0) & self.free[y, x], (before == 1) & stops & inside
        self.known[y[is_free], x[is_free]] = FREE
        self.known[y[is_hit], x[is_hit]] = OCCUPIED
        self.known[int(self.y), int(self.x)] = FREE
        self.known[self.specks] = UNKNOWN

    def drive(self, path: Any, some: int) -> bool:
        """Follow the first poses of a path in the map frame, and look from each. False if the robot gets stuck."""
        for pose in path[1 : some + 1]:
            x, y, yaw = self.in_world(pose)
            if self.stuck or not self._is_free((x + self.x) / 2, (y + self.y) / 2) or not self._is_free(x, y):
                self.look()
                return False
            off = self.rng.uniform(-0.45, 0.45, 2) * CELL / PIXEL / 2
            close = (off * sides / 100 for sides in ((1, 1), (1, -1), (-1, 1), (-1, -1)))
            right, up = next(each for each in (off, *close) if self._is_free(x + each[0], y + each[1]))
            self.x, self.y, self.yaw = x + right, y + up, yaw + self.rng.uniform(-0.2, 0.2)
            self.look()
        return True

    def _is_free(self, x: float, y: float) -> bool:
        return 0 <= x < self.side and 0 <= y < self.side and bool(self.free[int(y), int(x)])

    # --- the map ------------------------------------------------------------------------------------------------------

    @property
    def _frame(self) -> MapFrame:
        """The frame of the grid."""
        return MapFrame(0.0, 0.0, self.grid_yaw)

    def in_map(self, x: float, y: float, yaw: float) -> tuple[float, float, float]:
        """A pose of the world in pixels as one in the map frame in meters."""
        right, up = MapFrame(0.0, 0.0, self.turn).to_map(x - self.side / 2, y - self.side / 2)
        right, up = (at + self.side / 2 + jump + self.fraction for at, jump in zip((right, up), self.jump, strict=True))
        return *self._frame.to_map(right * PIXEL, up * PIXEL), yaw + self.turn + self.grid_yaw

    def in_world(self, pose: Any) -> tuple[float, float, float]:
        """The inverse of `in_map`."""
        along = zip(self._frame.to_grid(*pose[:2]), self.jump, strict=True)
        right, up = (at / PIXEL - self.fraction - jump - self.side / 2 for at, jump in along)
        x, y = MapFrame(0.0, 0.0, self.turn).to_grid(right, up)
        return x + self.side / 2, y + self.side / 2, pose[2] - self.turn - self.grid_yaw

    def grid(self) -> MetricMap:
        """The map as it is published: what is known, and some pixels around."""
        walls = ndimage.binary_dilation(self.known == OCCUPIED, np.ones((2 * self.inflation + 1,) * 2))
        known = np.pad(np.where(walls, OCCUPIED, self.known), 1, constant_values=UNKNOWN)
        up, right = np.indices((self.side + 2 * FRAME,) * 2) - FRAME + 0.5 - self.side / 2
        at = MapFrame(0.0, 0.0, self.turn).to_grid(right - self.jump[0], up - self.jump[1])
        column, row = (np.floor(pixels + self.side / 2).astype(int).clip(-1, self.side) + 1 for pixels in at)
        left, bottom, right, top = self._window(pixels := known[row, column])
        pixels, size = pixels[bottom:top, left:right], PIXEL / 2
        if self.scale == 2:
            parts, size = pixels.reshape((top - bottom) // 2, 2, (right - left) // 2, 2), 2 * PIXEL
            is_free, is_occupied = (parts == FREE).all((1, 3)), (parts == OCCUPIED).any((1, 3))
            pixels = np.select([is_occupied, is_free], [OCCUPIED, FREE], UNKNOWN)
        elif self.scale == 0.5:
            pixels = pixels.repeat(2, 0).repeat(2, 1)
        else:
            size = PIXEL
        corner = ((pixels - FRAME + self.fraction) * PIXEL for pixels in (left, bottom))
        return MetricMap(pixels.astype(np.int8), size, MapFrame(*self._frame.to_map(*corner), self.grid_yaw))

    def _window(self, pixels: np.ndarray) -> tuple[int, int, int, int]:
        """Left, bottom, right and top of the known part, the robot and a margin."""
        ends = []
        for known, at in zip(np.nonzero(pixels != UNKNOWN)[::-1], self._frame.to_grid(*self.pose()[:2]), strict=True):
            known = [*known.tolist(), math.floor(at / PIXEL - self.fraction) + FRAME]
            low, high = min(known) - self.rng.integers(0, 4), max(known) + self.rng.integers(1, 5)
            ends.append((max(low, 0), min(high, len(pixels))))
        (left, right), (bottom, top) = ends
        if self.scale == 2:  # whole pixels of twice the size
            left, bottom, right, top = left // 2 * 2, bottom // 2 * 2, -(-right // 2) * 2, -(-top // 2) * 2
        return left, bottom, right, top

    def pose(self) -> tuple[float, float, float]:
        """Where the robot believes that it is, in the map frame."""
        return self.in_map(self.x + self.lost[0], self.y + self.lost[1], self.yaw)

    # --- misbehavior --------------------------------------------------------------------------------------------------

    def misbehave(self) -> None:
        """Let something happen."""
        kinds = (
            self._close_loop, self._turn_grid, self._change_resolution, self._inflate, self._shut, self._open,
            self._get_stuck, self._get_lost, self._forget, self._find_door, self._lose_door, self._blink, self._shift,
        )  # fmt: skip
        kinds[self.rng.integers(len(kinds))]()

    def _close_loop(self) -> None:
        self.turn += self.rng.uniform(-0.1, 0.1)
        self.jump = tuple(np.clip(self.jump + self.rng.uniform(-2, 2, 2), -4, 4).tolist())

    def _turn_grid(self) -> None:
        self.grid_yaw = float(self.rng.choice([0.0, self.rng.uniform(-3, 3)]))

    def _shift(self) -> None:
        self.fraction = float(self.rng.choice([0.0, 0.25, 0.5]))

    def _change_resolution(self) -> None:
        self.scale = float(self.rng.choice([0.5, 1.0, 2.0]))

    def _inflate(self) -> None:
        self.inflation = int(self.rng.integers(0, 4))

    def _around(self, pixels: int) -> tuple[slice, slice]:
        """Rows and columns around the robot."""
        y, x = (slice(max(int(at) - pixels, 0), int(at) + pixels + 1) for at in (self.y, self.x))
        return y, x

    def _shut(self) -> None:
        passage = self._blob(1, 8) & self.free
        passage[self._around(1)] = False
        self.free &= ~passage
        self.shut.append(passage)

    def _open(self) -> None:
        if self.shut:
            self.free |= self.shut.pop(self.rng.integers(len(self.shut)))

    def _get_stuck(self) -> None:
        self.stuck = int(self.rng.integers(1, 6))

    def _get_lost(self) -> None:
        self.lost = tuple(self.rng.uniform(-4, 4, 2).tolist())

    def _forget(self) -> None:
        part = self._blob(1, 12)
        part |= self.rng.random() < 0.1
        if self.rng.random() < 0.5:
            part[self._around(2)] = True
        self.known[part] = UNKNOWN

    def _find_door(self) -> None:
        self.doors.append(tuple(self.rng.uniform(-3, self.side + 3, 2).tolist()))

    def _lose_door(self) -> None:
        self.doors = self.doors[1:]

    def _blink(self) -> None:
        pixels = (self.known != UNKNOWN) & (self.rng.random(self.known.shape) < 0.02)
        self.known[pixels] = self.rng.choice([FREE, OCCUPIED, UNKNOWN], np.count_nonzero(pixels))

    def calm(self) -> None:
        """From here on the map is static."""
        self.stuck, self.lost = 0, (0.0, 0.0)
        self.doors = self.doors if self.rng.random() < 0.3 else []

    # --- the story ----------------------------------------------------------------------------------------------------

    def tell(self, planner: MetricPlanner) -> Told:
        """Explore to the end."""
        promises = Promises(CELL, SMALLEST, RANGE, self.degrees)
        slowest, failed, at_door = 0.0, [], 0
        self.look()
        for number in range(NOISY + MOST):
            if number < NOISY and self.rng.random() < 0.35:
                self.misbehave()
            if number == NOISY:
                self.calm()
            self.stuck = max(self.stuck - 1, 0)
            grid, pose = self.grid(), self.pose()
            if number < NOISY and self.rng.random() < 0.3:
                self.lost = 0.0, 0.0
            doors = [self.in_map(*door, 0.0)[:2] for door in self.doors]
            started = time.process_time()
            decision = planner.plan(grid, pose, doors=doors)
            slowest = max(slowest, time.process_time() - started)
            promises.check(grid, pose, doors, decision)
            if decision.subgoal is None:
                if number >= NOISY:
                    return Told("gave_up", number + 1, slowest, self._unseen())
                self.look()
                continue
            whole = len(decision.path) - 1
            some = whole if self.rng.random() < 0.7 else int(self.rng.integers(0, whole + 1))
            if self.drive(decision.path, some):
                if decision.mode == "to_goal" and some == whole:
                    at_door += number >= NOISY
                    if at_door:
                        return Told("to_goal", number + 1, slowest, self._unseen())
                continue
            if decision.mode == "to_goal":
                at_door += number >= NOISY
                if at_door > 5:
                    return Told("blocked", number + 1, slowest, self._unseen())
                continue
            if sum(math.dist(decision.subgoal, other) < 0.01 for other in failed) + 1 >= TRIES:
                planner.set_aside(decision.subgoal)
                promises.set_aside(decision.subgoal)
            failed.append(decision.subgoal)
        raise AssertionError(f"no end after {NOISY + MOST} decisions")

    def _unseen(self) -> float:
        """The share of the ground that the robot can reach, a pixel at a time, and has not seen."""
        found, queue = {(int(self.x), int(self.y))}, [(int(self.x), int(self.y))]
        while queue:
            x, y = queue.pop()
            for there in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
                if there not in found and self._is_free(*there):
                    found.add(there)
                    queue.append(there)
        return sum(self.known[y, x] == UNKNOWN for x, y in found) / len(found)


def worlds_of(files: list[Path]) -> list[np.ndarray]:
    """The free ground of ROS maps that are large enough, bool [h w], at half their resolution."""
    maps = []
    for file in files:
        free = read_occupancy_map(file).free[::-1]
        rows, columns = (side // 2 for side in free.shape)
        if min(rows, columns) >= max(SIDES):
            maps.append(free[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).all((1, 3)))
    return maps


def planner_for(degrees: float) -> MetricPlanner:
    """A planner for the stories of robots with this field of view, with all its programs."""
    planner = MetricPlanner(
        cell_size=CELL, smallest_cell=SMALLEST, sensing_range=RANGE, field_of_view=degrees, largest=(56, 56)
    )
    closed = np.pad(np.full((2, 2), FREE), 2, constant_values=OCCUPIED)
    planner.plan(MetricMap(closed, PIXEL, MapFrame(0.0, 0.0, 0.0)), (3 * PIXEL, 3 * PIXEL, 0.0))
    return planner


def story(number: int, maps: list[np.ndarray]) -> Story:
    """The story of this number, in a part of one of the maps with walls around it."""
    rng, part = np.random.default_rng(number), np.zeros((1, 1), bool)
    while part.mean() <= 0.1:
        free, side = maps[rng.integers(len(maps))], rng.choice(SIDES)
        y, x = (rng.integers(pixels - side + 1) for pixels in free.shape)
        part = np.rot90(free[y : y + side, x : x + side], rng.integers(4))
    return Story(np.pad(part[1:-1, 1:-1], 1), rng, (90.0, 360.0)[number % 2])
