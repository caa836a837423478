"""The planner on a robot's own map: grids like those of ROS, with poses in meters in the map frame."""

import collections
import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Int, UInt8

from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.grid import bitboard
from dc2g_jax._src.grid.gridworld import belief_from_map
from dc2g_jax._src.grid.poses import make_pose
from dc2g_jax._src.grid.sensing import MAX_SENSING_RANGE, Kernel
from dc2g_jax._src.grid.terrain import NOTHING, UNKNOWN
from dc2g_jax._src.planning.decisions import explain
from dc2g_jax._src.planning.metric_map import (
    DrawnMap,
    MetricMap,
    MetricPose,
    beside_ground,
    class_of_values,
    draw,
    in_map_frame,
)
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES, Planner
from dc2g_jax._src.runtime.errors import InputError, check_number
from dc2g_jax._src.runtime.programs import jit


class MetricCandidate(NamedTuple):
    """A pose that the robot might explore from, see `planning.decisions.Candidate`.

    Attributes:
      pose: the pose.
      cost_to_go: predicted cost from there to the door, in cells of the planner; `None` without predictions.
      distance: actions from the robot: one cell forward, or a quarter turn.
      score: the planner's score; the lowest wins.
    """

    pose: MetricPose
    cost_to_go: float | None
    distance: int
    score: float


@dataclass(frozen=True)
class MetricDecision:
    """The next subgoal of a robot, and the reason for it.

    Attributes:
      mode: "explore", "to_goal" (a door is reachable) or "gave_up": the end of exploration.
      subgoal: last pose of the path; `None` if and only if the planner gave up.
      path: the robot's own pose, then the centers of the cells along a shortest plan, one pose per action.
      candidates: candidates for exploration, the subgoal first, then in ascending order of score.
      why: the reason, in one sentence.
      cell_size: side of the cells used for planning, in meters.
    """

    mode: str
    subgoal: MetricPose | None
    path: tuple[MetricPose, ...]
    candidates: tuple[MetricCandidate, ...]
    why: str
    cell_size: float


@functools.partial(jit, static_argnames=("sensing",))
def _in_view(terrain: UInt8[Array, "h w"], heading: Int[Array, ""], *, sensing: Kernel) -> Bool[Array, "h w"]:
    """The cells seen from the middle of a map."""
    height, width = terrain.shape
    belief = belief_from_map(terrain, make_pose(width // 2, height // 2, heading))
    return bitboard.unpack(sensing.visible(belief.pose, belief.opaque, width), width)


class MetricPlanner:
    """Decides for one robot on its own map in meters, one call at a time, with an `OnlinePlanner`.

    ```
    planner = MetricPlanner(cell_size=0.25, sensing_range=3.0)
    decision = planner.plan(MetricMap(cells, 0.05, MapFrame(-10.0, -10.0, 0.0)), (0.0, 0.0, 1.57))
    ```

    The map may be finer than the planner's cells. A cell has the smallest whole number of pixels along a side that
    makes it at least `cell_size`, and stays in place when the map grows. Pixels are merged by
    `grid.sampling.sample_conservatively`. The robot's own cell counts as traversable. The world continues
    beyond the map's edges.

    If there is nothing to explore and no path to a door, the planner halves its cells and tries again, down to
    `smallest_cell`, in whole pixels. So it gives up only if no unknown cell lies beside ground that free cells of that
    size connect to the robot, except cells in view only from the robot's own pose, and cells that were set aside.

    The robot has reached its subgoal if it faces the same way and is within one cell or half of `cell_size`, whichever
    is larger. Cells in view from there that are unknown now and at the next call are set aside, for as long as the same
    free cells lie beside them. So exploration ends, even if the map changes back and forth. On a map of another
    resolution or rotation, all cells count again.

    Subgoals are centers of free cells, so walls are at least half a cell away: half of `smallest_cell` at worst. If the
    map has no ground under the robot, it turns where it stands.

    Args:
      planner: see `OnlinePlanner`. The rules of one of your own keep their sensing range in cells, whatever the side
        of a cell.
      cell_size: side of the planner's cells, in meters: about the robot's diameter, and at most half as wide as the
        narrowest passage, so that a cell fits into it.
      sensing_range: range of the robot's field of view, in meters; walls hide what is behind them. The whole cells in
        it count, up to 64.
      field_of_view: width of the robot's field of view in degrees, 1 to 360; `None` for the planner's own, else 90.
      smallest_cell: side of the smallest cells after halving, in meters, rounded up to whole pixels; `None` for a
        quarter of `cell_size`. Passages at least twice as wide as these cells are found, or three times where they run
        diagonally.
      labels: value of a cell -> class name (see `grid.terrain.CLASS_NAMES`), for semantic maps; `None` for
        occupancy maps, whose cells are 0 (free) to 100 (occupied).
      network: see `OnlinePlanner`.
      largest: rows and columns of the largest map, in cells of the planner. A larger map compiles again, for some tens
        of seconds. So do cells of another side than `cell_size`, such as halved ones, which are four times as many.

    Raises:
      InputError: a size is invalid, a label is unknown, or `OnlinePlanner` rejects the planner.
    """

    def __init__(
        self,
        planner: str | Planner = "dc2g",
        *,
        cell_size: float,
        sensing_range: float,
        field_of_view: float | None = None,
        smallest_cell: float | None = None,
        labels: Mapping[int, str] | None = None,
        network: Estimator | str | Path | None = None,
        largest: tuple[int, int] = (100, 100),
    ):
        check_number("cell_size", cell_size, above=0, hint="meters, such as 0.25")
        check_number("sensing_range", sensing_range, above=0, hint="meters, such as 3.0")
        self._smallest_cell = cell_size / 4 if smallest_cell is None else smallest_cell
        check_number("smallest_cell", self._smallest_cell, above=0, most=cell_size, hint="meters, the cell_size")
        self._classes = class_of_values(labels)
        self._cell_size = cell_size
        self._make = functools.partial(
            OnlinePlanner, planner, network=network, open_ended=True, settings="occluded", field_of_view=field_of_view
        )
        self._sensing_range, self._largest = sensing_range, largest
        self._fixed_reach: int | None = None
        # On most maps, cells have this side. It also checks the planner before there is a map.
        reach = self._reach(cell_size)
        self._online: dict[int, OnlinePlanner] = {reach: self._make(sensing_range=reach, largest=largest)}
        self._fixed_reach = reach if hasattr(planner, "rules") else None
        self._factors: dict[int, int] = {}  # of the last map of each sensing range
        self._aside: dict[int, set[tuple[int, int, int]]] = collections.defaultdict(set)
        self._drawn: DrawnMap | None = None
        self._target: MetricPose | None = None
        self._looked_at: tuple[int, list[tuple[int, int]]] | None = None

    def plan(self, grid: MetricMap, pose: npt.ArrayLike, *, doors: Iterable[Sequence[float]] = ()) -> MetricDecision:
        """Decide the next subgoal (Algorithm 2).

        Args:
          grid: the map so far.
          pose: x, y and yaw of the robot in the map frame, meters and radians. The yaw is rounded to the nearest
            quarter turn of the grid.
          doors: x and y of the doors that the robot has detected, in the map frame. Each makes its cell a door,
            whatever the map says there. Doors far off the map count once the map comes near.

        Raises:
          InputError: the map, the pose or a door is invalid, or the sensing range is less than a cell.
        """
        here = MetricPose(*in_map_frame("pose", pose, 3))
        found = tuple(in_map_frame("door", door, 2) for door in doors)
        self._look_around(here, grid, found)
        factor = max(1, math.ceil(self._cell_size / grid.resolution - 1e-4))
        decision = self._decided(grid, factor, here, found)
        smallest = max(1, math.ceil(self._smallest_cell / grid.resolution - 1e-4))
        while decision.mode == MODE_NAMES[GAVE_UP] and factor > smallest:
            factor = max(factor // 2, smallest)
            decision = self._decided(grid, factor, here, found)
        self._target = decision.subgoal if decision.mode == MODE_NAMES[EXPLORE] else None
        return decision

    def set_aside(self, pose: MetricPose) -> None:
        """Set aside the unknown cells in view from a pose that the robot has visited or cannot reach.

        Args:
          pose: the subgoal of the last decision.
        """
        if self._drawn is not None:
            self._put_aside(self._unknown_in_view(pose, self._drawn), self._drawn)

    def _put_aside(self, cells: Iterable[tuple[int, int]], drawn: DrawnMap) -> None:
        """Set aside those of the cells that are unknown on a map. (Only cells beside ground ever count.)"""
        self._aside[drawn.factor] |= beside_ground(cells, drawn.terrain, drawn.left, drawn.top)

    def _unknown_in_view(self, pose: MetricPose, drawn: DrawnMap) -> list[tuple[int, int]]:
        """Columns and rows of the unknown cells in view from a pose on a map, including those set aside."""
        terrain, left, top, cells, *_ = drawn
        reach = self._reach(cells.size)
        sensing = self._online[reach].rules.sensing
        x, y, heading = cells.pose_in(pose)
        if not (0 <= x - left < terrain.shape[1] and 0 <= y - top < terrain.shape[0]):
            return []
        around = np.pad(terrain, reach)[y - top :, x - left :][: 2 * reach + 1, : 2 * reach + 1]
        seen = jax.device_get(_in_view(around, np.int32(heading), sensing=sensing))
        rows, columns = np.nonzero(seen & np.isin(around, (UNKNOWN, NOTHING)))
        return list(zip((columns + x - reach).tolist(), (rows + y - reach).tolist(), strict=True))

    def _look_around(self, here: MetricPose, grid: MetricMap, doors: Iterable[Sequence[float]]) -> None:
        """Set aside cells that stayed unknown when looked at. Forget them all if the map's cells have changed."""
        if self._drawn is None:
            return
        cells, factor = self._drawn.cells, self._drawn.factor
        if not (
            math.isclose(cells.frame.yaw, grid.origin.yaw, abs_tol=1e-6)
            and math.isclose(cells.size, factor * grid.resolution, rel_tol=1e-6)
        ):
            self._aside.clear()
            self._drawn = self._target = self._looked_at = None
            for online in self._online.values():
                online.start_anew()
            return
        if self._looked_at is not None:
            pixels, unknown = self._looked_at
            self._put_aside(unknown, self._draw(grid, pixels, here, doors))
        self._looked_at = None
        if self._target is not None:
            near = math.dist(here[:2], self._target[:2]) <= max(self._cell_size / 2, cells.size)
            if near and cells.pose_in(here).heading == cells.pose_in(self._target).heading:
                self._looked_at = factor, self._unknown_in_view(self._target, self._draw(grid, factor, here, doors))

    def _reach(self, size: float) -> int:
        """Sensing range in cells of this side, in meters."""
        reach = math.floor(self._sensing_range / size + 1e-4)
        if reach < 1:
            raise InputError(
                f"sensing_range {self._sensing_range} is less than cell_size, {size:.3g} m; give at least that"
            )
        return self._fixed_reach or min(reach, MAX_SENSING_RANGE)

    def _online_for(self, reach: int, shape: tuple[int, ...]) -> OnlinePlanner:
        """The planner for a sensing range and a map's shape, both in cells. It is made, or made larger, if need be."""
        online = self._online.get(reach)
        largest = self._largest if online is None else online.largest
        if any(side > limit for side, limit in zip(shape, largest, strict=True)):
            rows, columns = (max(side, 2 * limit) for side, limit in zip(shape, largest, strict=True))
            largest = rows, columns
        if online is None or online.largest != largest:
            online = self._online[reach] = self._make(sensing_range=reach, largest=largest)
        return online

    def _draw(self, grid: MetricMap, factor: int, here: MetricPose, doors: Iterable[Sequence[float]]) -> DrawnMap:
        """The map in cells of `factor` pixels along a side."""
        aside, reach = self._aside[factor], self._reach(factor * grid.resolution)
        return draw(grid, factor, self._classes, here, doors=doors, aside=aside, margin=reach)

    def _decided(
        self, grid: MetricMap, factor: int, here: MetricPose, doors: Iterable[Sequence[float]]
    ) -> MetricDecision:
        """The decision in cells of `factor` pixels along a side."""
        self._drawn = drawn = self._draw(grid, factor, here, doors)
        cells, own = drawn.cells, drawn.cells.pose_in(here)
        reach = self._reach(cells.size)
        online = self._online_for(reach, drawn.terrain.shape)
        if self._factors.get(reach) != factor:
            online.start_anew()
        self._factors[reach] = factor
        decision = online.plan(drawn.terrain, own, origin=(drawn.left, drawn.top))

        def placed(poses: Sequence[tuple[Any, ...]]) -> list[MetricPose]:
            """Poses at cell centers. If the map has no ground under the robot, it turns where it stands."""
            middles = cells.centers(poses)
            if drawn.on_ground:
                return middles
            return [
                middle._replace(x=here.x, y=here.y) if pose[:2] == own[:2] else middle
                for pose, middle in zip(poses, middles, strict=True)
            ]

        def words(*cell: int) -> tuple[str, str]:
            (pose,) = placed([cell])
            return f"({pose.x:z.2f}, {pose.y:z.2f}) m", f"{math.degrees(pose.yaw):z.0f} degrees"

        why = explain(decision.mode, decision.path, decision.candidates, words)
        if decision.mode == MODE_NAMES[GAVE_UP] and drawn.aside:
            why += f"; {drawn.aside} cells are still unknown after the robot looked at them"
        return MetricDecision(
            mode=decision.mode,
            subgoal=placed([decision.subgoal])[0] if decision.subgoal else None,
            path=(here, *placed(decision.path[1:])) if decision.path else (),
            candidates=tuple(
                MetricCandidate(pose, each.cost_to_go, each.distance, each.score)
                for pose, each in zip(placed(decision.candidates), decision.candidates, strict=True)
            ),
            why=why,
            cell_size=cells.size,
        )
