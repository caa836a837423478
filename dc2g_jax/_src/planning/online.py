"""The planner for a real robot: each call takes the map so far and the pose, and returns a decision.

There is no simulator and no batch. The robot's software provides the map. Cells may change and the map may grow between
calls.
"""

import dataclasses
import functools
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Int, UInt8

from dc2g_jax._src.estimation.estimators import Estimator
from dc2g_jax._src.estimation.padding import padded
from dc2g_jax._src.files.cache import keep_compiled_programs
from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.gridworld import Belief, belief_from_map
from dc2g_jax._src.grid.poses import HEADINGS, Pose
from dc2g_jax._src.grid.sensing import check_sensing_range
from dc2g_jax._src.grid.terrain import CLASS_NAMES, OUTSIDE, ROAD, TRAVERSABLE, UNKNOWN
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.decisions import Decision, RobotPose, View, decide
from dc2g_jax._src.planning.inputs import map_of, numbers_of
from dc2g_jax._src.planning.learned_score import LearnedScore
from dc2g_jax._src.planning.named import make_planner
from dc2g_jax._src.planning.planners import (
    DC2G,
    Assessment,
    Planner,
    PlannerLike,
    asks,
    assess,
    can_be_revised,
    distances_and_scores,
)
from dc2g_jax._src.planning.rules import Rules, named_settings
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number
from dc2g_jax._src.runtime.programs import ONE_OPERATION_OPTIONS, jit, one_operation

#: Planners by name that need only the robot's map.
ONLINE_PLANNERS = ("frontier", "dc2g", "dc2g_uncertain")

#: Side length of the smallest compiled grid, in cells. Each further one is twice as large, and the largest more than
#: twice. There are few, as each takes some seconds to compile.
_SMALLEST_GRID = 256

#: Minimum number of unobserved cells on each side of an open-ended map. The network was trained on maps of 50 x 50
#: cells; with this margin, even the smallest map looks like one of them.
_OPEN_MARGIN = 24


def view_of(belief: Belief, assessment: Assessment) -> View:
    """The inputs of a decision of one robot, for use in compiled functions."""
    distance, score = distances_and_scores(belief, assessment)
    subgoals, candidates = (
        poses.unpack(these, belief.width) for these in (assessment.plan.subgoals, assessment.candidates)
    )
    mode, cost_to_go, penalty = assessment.plan.mode, assessment.cost_to_go, assessment.penalty
    traced: Any = (distance, mode, subgoals, candidates, cost_to_go, score, penalty)
    return View(*traced)


#: A robot waits for the compilation: this saves a third of its time. A network takes most of the run time anyway.
_OPTIONS = {**ONE_OPERATION_OPTIONS, "xla_backend_optimization_level": 2}


class _Frame(NamedTuple):
    """Where the planner's own grid lies, in the coordinates of the decisions, and its rows and columns."""

    left: int
    top: int
    rows: int
    columns: int


class _Memory(NamedTuple):
    """What is kept between calls: the frame, the map in it, the robot's pose there, and the planner's state."""

    frame: _Frame
    terrain: UInt8[np.ndarray, "h w"]
    pose: Int[np.ndarray, "3"]
    state: Any


def _observed(terrain: UInt8[Array, "h w"]) -> UInt8[Array, "h w"]:
    """The map without the cells beyond it."""
    return jnp.where(terrain == OUTSIDE, jnp.uint8(UNKNOWN), terrain)


@jit
def _first_state(planner: PlannerLike, terrain: UInt8[Array, "h w"]) -> Any:
    """The planner's state at the start of a search, given the map so far."""
    return planner.init(World.from_terrain(_observed(terrain)))


@functools.partial(jit, static_argnames=("rules",), compiler_options=_OPTIONS)
def _look(
    planner: PlannerLike,
    state: Any,
    before: UInt8[Array, "h w"],
    terrain: UInt8[Array, "h w"],
    pose: Int[Array, "3"],
    *,
    rules: Rules,
) -> tuple[View, Any]:
    """The inputs of a decision, and the planner's state after it.

    What comes before and after a network is one operation each.

    Args:
      planner: the planner.
      state: its state after the last decision.
      before: class indices then.
      terrain: class indices now, `OUTSIDE` beyond the map.
      pose: column, row and heading.
      rules: field of view and definition of frontiers.
    """

    def begin(
        state: Any, before: UInt8[Array, "h w"], terrain: UInt8[Array, "h w"], pose: Int[Array, "3"]
    ) -> tuple[Belief, Any, Any]:
        outside = bitboard.pack(terrain == OUTSIDE)
        belief = dataclasses.replace(belief_from_map(_observed(terrain), Pose(*pose)), outside=outside)
        if can_be_revised(planner):
            changed = bitboard.pack(_changed(before, terrain))
            same, revised = bitboard.is_empty(changed), planner.revised(state, changed)
            state = jax.tree.map(lambda kept, new: kept if new is kept else jnp.where(same, kept, new), state, revised)
        return belief, state, planner.look(belief, state) if asks(planner) else None

    def conclude(planner: PlannerLike, belief: Belief, state: Any, looked: Any, answer: Any) -> tuple[View, Any]:
        if looked is None:
            assessment, state = assess(planner, belief, state, rules)
        else:
            assessment, state = planner.conclude(belief, state, looked, lambda *_: answer)
        return view_of(belief, assessment), state

    belief, state, looked = one_operation(begin, state, before, terrain, pose)
    answer = None
    if looked is not None:
        told = jax.eval_shape(planner.ask, belief, state)
        nothing = jax.tree.map(lambda each: jnp.zeros(each.shape, each.dtype), told)
        answer = jax.lax.cond(looked[0], lambda: planner.ask(belief, state), lambda: nothing)
    return one_operation(conclude, planner, belief, state, looked, answer)


def _changed(before: Any, now: Any) -> Any:
    """Cells that had been observed and are of another class now, or unobserved again."""
    return (before != UNKNOWN) & (before != now)


class OnlinePlanner:
    """Decides for one robot from its own partial map, one call at a time.

    ```
    planner = OnlinePlanner("dc2g")
    decision = planner.plan(grid, (x, y, heading))
    ```

    It remembers the search between calls. On a map of known size whose cells keep their class, a robot that takes the
    actions one by one decides as in a rollout; but in towns larger than the network's maps, the network gets the whole
    map instead of a window. Observed cells may change in any way: the planner then chooses again (see
    `Planner.revised`; a planner without this method starts a new search).

    A new search also starts if most of the observed cells have changed, if the robot is where it cannot have come from,
    or if the map's size or origin changes. In an open-ended world, size and origin may change until the map comes close
    to the edge of the planner's own, wider grid.

    A planner serves one robot, one call at a time. Exploration ends if the robot observes everything in its field of
    view at every pose that it reaches. Mark cells that its sensor cannot classify as `nothing`.

    Creating the planner compiles a program for its largest grid and, beyond 512 cells a side, also for smaller ones.
    Each takes three to ten seconds of CPU time, and more for longer sensing ranges. The programs are kept on disk (see
    `files.cache.keep_compiled_programs`), and later starts load them. No call compiles anything after the start, and
    decisions do not depend on the grid size. Planners whose `knows_outside` is false, such as those with
    other estimators than `NetworkCostToGo`, get grids of exactly the map's size; each new size is compiled.

    Args:
      planner: one of `ONLINE_PLANNERS`, or any planner. If it has `rules`, they are used.
      network: estimator of a planner by name, or the place of a trained network, see `estimation.hub.load_network`;
        `None` for the shipped one.
      sensing_range: range of the robot's field of view, in cells, 1 to 64.
      field_of_view: width of the robot's field of view in degrees, 1 to 360; `None` for that of the settings, 90.
      largest: rows and columns of the largest map.
      open_ended: whether the world continues beyond the map's edges. If so, the robot explores across them too.
        Otherwise the map's size is the world's, and there is nothing to observe beyond it.
      settings: rules of a planner by name, see `planning.rules.SETTINGS`; `occluded` if walls hide what is
        behind them.

    Attributes:
      rules: field of view and definition of frontiers.
      largest: rows and columns of the largest map.

    Raises:
      InputError: the planner is unknown or has another sensing range, the network cannot be read, or a size is invalid.
    """

    def __init__(
        self,
        planner: str | Planner = "dc2g",
        *,
        network: Estimator | str | Path | None = None,
        sensing_range: int = 8,
        field_of_view: float | None = None,
        largest: tuple[int, int] = (100, 100),
        open_ended: bool = False,
        settings: str = "paper",
    ):
        keep_compiled_programs()
        rows, columns = numbers_of("largest", largest, 2, whole=True)
        for side in (rows, columns):
            check_number("largest", side, whole=True, least=1, hint="rows and columns")
        check_sensing_range("sensing_range", sensing_range)
        if not hasattr(planner, "plan"):
            if not isinstance(planner, str) or ":" not in planner:
                check_name("planner for a robot", planner, ONLINE_PLANNERS, "or one of your own")
            planner = make_planner(
                planner, network=network, settings=settings, sensing_range=sensing_range, field_of_view=field_of_view
            )
        asked = named_settings(settings, field_of_view).rules(sensing_range)
        self.rules: Rules = getattr(planner, "rules", asked)
        if (own := self.rules.sensing).radius != sensing_range:
            raise InputError(f"sensing_range {sensing_range}: the planner's rules say {own.radius}; give that")
        if field_of_view is not None and own.offsets != asked.sensing.offsets:
            theirs = "something else" if own.degrees is None else f"{own.degrees:g} degrees"
            raise InputError(f"field_of_view {field_of_view:g}: the planner's rules say {theirs}; leave it out")
        if isinstance(planner, DC2G | LearnedScore) and planner.estimator is not None:
            planner = dataclasses.replace(planner, estimator=padded(planner.estimator))
        self._planner = planner
        self._memory: _Memory | None = None
        self.largest = rows, columns
        self._margin, self._room = (max(_OPEN_MARGIN, sensing_range), sensing_range) if open_ended else (0, 0)
        frame = 2 * self._margin
        shapes = _shapes_up_to(rows + frame, columns + frame, larger_than=frame)
        self._pads_maps = getattr(self._planner, "knows_outside", False)
        self._shapes = shapes if self._pads_maps else shapes[-1:]
        for shape in self._shapes:
            terrain = np.full(shape, UNKNOWN, np.uint8)
            terrain[0, 0] = ROAD  # a class, so that the network runs as well
            state = _first_state(self._planner, terrain)
            for _ in range(2):  # the state of a planner of one's own may change its types at the first step
                given = self._planner, state, terrain, terrain, np.zeros(3, np.int32)
                _, state = _look(*given, rules=self.rules)
        # Without another look at all classes, which takes a tenth of a call.
        self._look = functools.partial(_look.of(given, {"rules": self.rules}), rules=self.rules)

    def plan(self, grid: npt.ArrayLike, pose: npt.ArrayLike, *, origin: npt.ArrayLike = (0, 0)) -> Decision:
        """Decide the next action (Algorithm 2).

        All poses, given and returned, are in the coordinates of the origin. So a map that grows to the left or to the
        top gets a smaller origin, and its cells keep their coordinates. If y grows upward instead of downward, "L" and
        "R" are swapped, and so are north and south.

        Args:
          grid: observed class indices, uint8 `[h w]`, 0 for unobserved cells; see `grid.terrain`.
          pose: column x, row y and heading of the robot, on an observed traversable cell.
          origin: column x and row y of the grid's first cell.

        Raises:
          InputError: the grid or the pose is invalid.
        """
        left, top = numbers_of("origin", origin, 2, whole=True)
        checked = _checked_grid(grid, self.largest)
        robot = _checked_pose(pose, checked, left, top)
        frame, memory = self._frame(left, top, *checked.shape), self._memory
        terrain = self._framed(checked, left, top, frame)
        here = np.array([robot.x - frame.left, robot.y - frame.top, robot.heading], np.int32)
        if memory is None:
            memory = _Memory(frame, terrain, here, _first_state(self._planner, terrain))
        elif not self._goes_on(memory, frame, terrain):
            self.start_anew()
            return self.plan(grid, pose, origin=origin)
        view, state = self._look(self._planner, memory.state, memory.terrain, terrain, here)
        view = jax.tree.map(np.asarray, view)
        x, y, heading = memory.pose
        if self._memory is not None and view.distance[heading, y, x] < 0:  # the robot cannot have come from there
            self.start_anew()
            return self.plan(grid, pose, origin=origin)
        decision = decide(view, frame.left, frame.top)
        self._memory = _Memory(frame, terrain, here, state)
        return decision

    def start_anew(self) -> None:
        """Begin a new search at the next call."""
        self._memory = None

    def _frame(self, left: int, top: int, rows: int, columns: int) -> _Frame:
        """The frame of a map: in an open-ended world, the last one while there is a margin around the map."""
        if not self._margin:
            return _Frame(left, top, rows, columns)
        if self._memory is not None:
            last = self._memory.frame
            before = min(left - last.left, top - last.top)
            after = min(last.left + last.columns - left - columns, last.top + last.rows - top - rows)
            if min(before, after) >= self._margin:
                return last
        # Wider at first, as far as the largest grid allows, so that the frame does not change whenever the map grows.
        above, beside = (
            self._margin + min(self._room, (most - side) // 2)
            for most, side in zip(self.largest, (rows, columns), strict=True)
        )
        return _Frame(left - beside, top - above, rows + 2 * above, columns + 2 * beside)

    def _framed(self, grid: UInt8[np.ndarray, "h w"], left: int, top: int, frame: _Frame) -> UInt8[np.ndarray, "h2 w2"]:
        """The map in its frame, in the upper left corner of the smallest compiled grid that fits it."""
        rows, columns = frame.rows, frame.columns
        fitting = (shape for shape in self._shapes if rows <= shape[0] and columns <= shape[1])
        terrain = np.full(next(fitting) if self._pads_maps else (rows, columns), OUTSIDE, np.uint8)
        terrain[:rows, :columns] = UNKNOWN
        terrain[top - frame.top :, left - frame.left :][: grid.shape[0], : grid.shape[1]] = grid
        return terrain

    def _goes_on(self, memory: _Memory, frame: _Frame, terrain: UInt8[np.ndarray, "h w"]) -> bool:
        """Whether the search goes on: no observed cell changed, or at most half did and the planner can be revised."""
        if frame != memory.frame:
            return False
        changed = np.count_nonzero(_changed(memory.terrain, terrain))
        if not changed:
            return True
        observed = np.count_nonzero((memory.terrain != UNKNOWN) & (memory.terrain != OUTSIDE))
        return can_be_revised(self._planner) and bool(2 * changed <= observed)


def _shapes_up_to(rows: int, columns: int, *, larger_than: int) -> list[tuple[int, int]]:
    """Shapes of the compiled grids, ascending: squares, limited to the largest shape."""
    doubled = (_SMALLEST_GRID << doublings for doublings in itertools.count())
    sides = itertools.takewhile(lambda side: 2 * side < max(rows, columns), doubled)
    return [*((min(side, rows), min(side, columns)) for side in sides if side > larger_than), (rows, columns)]


def _checked_grid(grid: npt.ArrayLike, largest: tuple[int, int]) -> UInt8[np.ndarray, "h w"]:
    """The grid, if it is valid."""
    cells = map_of("grid", grid, np.uint8, "class indices, uint8 [rows columns]")
    if cells.shape[0] > largest[0] or cells.shape[1] > largest[1]:
        raise InputError(
            f"grid has shape {cells.shape}; give at most {largest[0]} rows and {largest[1]} columns, or make the "
            "planner with a larger `largest`"
        )
    if cells.max() >= len(CLASS_NAMES):
        y, x = np.argwhere(cells >= len(CLASS_NAMES))[0]
        hint = "(0: not observed), an index into dc2g_jax.grid.CLASS_NAMES"
        check_number(f"grid[{y}, {x}]", int(cells[y, x]), whole=True, least=0, most=len(CLASS_NAMES) - 1, hint=hint)
    return cells


def _checked_pose(pose: npt.ArrayLike, grid: UInt8[np.ndarray, "h w"], left: int, top: int) -> RobotPose:
    """The pose, if it is valid."""
    x, y, heading = numbers_of("pose", pose, 3, whole=True)
    height, width = grid.shape
    check_number("the robot's heading", heading, least=0, most=HEADINGS - 1, hint="(+x, +y, -x, -y)")
    if not (left <= x < left + width and top <= y < top + height):
        raise InputError(
            f"the robot is at ({x}, {y}), off the map of columns {left} to {left + width - 1} and rows {top} to "
            f"{top + height - 1}; give both pose and origin in cells of one frame"
        )
    terrain = grid[y - top, x - left]
    if not TRAVERSABLE[terrain]:
        found = "has not been observed" if terrain == UNKNOWN else f"is {CLASS_NAMES[terrain]!r}, not traversable"
        raise InputError(
            f"the robot's cell ({x}, {y}) {found}; mark the ground under the robot as what it is, or as "
            f"{CLASS_NAMES.index('traversable')} ('traversable')"
        )
    return RobotPose(x, y, heading)
