"""Episodes taken once more, noting at every step what the planner saw and wanted; for recordings and figures."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Float32, Int, Int8, UInt8

from dc2g_jax._src.estimation.estimators import Estimator, answers_in_cells
from dc2g_jax._src.grid import bitboard, gridworld, poses, search
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import ACTION_LETTERS, Pose, every_heading, make_pose
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.decisions import shortest_plan
from dc2g_jax._src.planning.frontiers import frontier_cells
from dc2g_jax._src.planning.named import planner_with
from dc2g_jax._src.planning.planners import EXPLORE, PlannerLike, assess, distances_and_scores, reachable_cells
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.readers.houses import House
from dc2g_jax._src.rollouts.results import EpisodeResult
from dc2g_jax._src.rollouts.rollout import NO_ACTION
from dc2g_jax._src.runtime.programs import jit

#: Steps replayed by one call on the device, so that one compiled program serves episodes of every length.
_CHUNK = 64


@struct.dataclass
class Frames:
    """What a robot knew and wanted before each of its actions, and after the last: one frame more than actions.

    Attributes:
      pose: where the robot was, int32 columns, rows and headings `[t]`.
      terrain: observed class indices, 0 where nothing had been observed.
      seen: cells observed so far.
      field_of_view: cells in view from the pose.
      reachable: observed traversable cells connected to the robot.
      candidates: frontier-expanding poses by the rules, whether or not the planner asks for them.
      subgoals: poses the plan leads into: of `Plan.subgoals` those nearest to the robot; all where there is no path.
      mode: plan mode, see `planning.planners`.
      action: what the planner decides here. Equal to the action taken where planner and rules are those of the
        episode; without meaning in the last frame.
      length: actions from the robot to the subgoal.
      to_goal: actions an oracle needs from here to the nearest goal, -1 where there is no path.
      cost_to_go: the planner's estimate of the cost-to-go, as its selection rule takes it: most often the mean of its
        outcomes. Where it does not explore, the last one it went by. `None` if it makes none or never explores.
      frontier: frontier cells, whatever the rules count: reachable, with an unobserved 4-neighbor (paper, section
        III-D).
      score: while exploring, the planner's score of the cells it chooses from, the lowest wins; the distance for a
        planner that has no score. NaN on all other cells.
      path: the plan as poses from the robot's own to the subgoal, both included: columns, rows, headings; none where
        there is no path.
      in_cells: is `cost_to_go` in cells? Otherwise in parts of the highest cost, 0 to 1.
    """

    pose: Pose
    terrain: UInt8[np.ndarray, "t h w"]
    seen: Bool[np.ndarray, "t h w"]
    field_of_view: Bool[np.ndarray, "t h w"]
    reachable: Bool[np.ndarray, "t h w"]
    candidates: Bool[np.ndarray, "t heading h w"]
    subgoals: Bool[np.ndarray, "t heading h w"]
    mode: Int[np.ndarray, "t"]
    action: Int[np.ndarray, "t"]
    length: Int[np.ndarray, "t"]
    to_goal: Int[np.ndarray, "t"]
    cost_to_go: Float32[np.ndarray, "t h w"] | None
    frontier: Bool[np.ndarray, "t h w"]
    score: Float32[np.ndarray, "t h w"]
    path: tuple[Int[np.ndarray, "poses 3"], ...]
    in_cells: bool

    def __len__(self) -> int:
        """Number of frames, one more than actions."""
        return len(self.mode)


def _frame(belief: Belief, state: Any, world: World, planner: PlannerLike, rules: Rules) -> tuple[dict[str, Any], Any]:
    """One frame, and the planner's new state."""
    width = belief.width
    pose = belief.pose
    reachable = reachable_cells(belief, jnp.zeros_like(belief.seen))
    assessment, state = assess(planner, belief, state, rules)
    plan = assessment.plan
    way_home = search.first_action(pose, every_heading(world.goals), world.traversable)
    distance, score = distances_and_scores(belief, assessment)
    nearest = poses.pack(distance == plan.length) & plan.subgoals
    boards = {
        "seen": belief.seen,
        "field_of_view": rules.sensing.visible(pose, world.opaque, width),
        "reachable": reachable,
        "frontier": frontier_cells(belief, reachable),
    }
    pose_sets = {
        "candidates": rules.frontier_expanding(belief, reachable),
        "subgoals": jnp.where(poses.is_empty(nearest), plan.subgoals, nearest),
    }
    frame = {
        "pose": pose,
        "terrain": belief.terrain,
        **{name: bitboard.unpack(board, width) for name, board in boards.items()},
        **{name: poses.unpack(pose_set, width) for name, pose_set in pose_sets.items()},
        "mode": plan.mode,
        "action": plan.action,
        "length": plan.length,
        "to_goal": jnp.where(way_home.found, way_home.length, -1),
        "distance": distance,
        "score": jnp.where(plan.mode == EXPLORE, score, jnp.nan),
        "cost_to_go": assessment.cost_to_go,
    }
    return frame, state


@functools.partial(jit, static_argnames=("rules",))
def first_carry(world: World, start: Pose, planner: PlannerLike, *, rules: Rules) -> tuple[Belief, Any]:
    """The robot's first belief, and the planner's first state."""
    return gridworld.reset(world, start, rules.sensing), planner.init(world)


@functools.partial(jit, static_argnames=("rules",))
def _replay_chunk(
    carry: tuple[Belief, Any], actions: Int8[Array, "chunk"], world: World, planner: PlannerLike, *, rules: Rules
) -> tuple[tuple[Belief, Any], dict[str, Any]]:
    """One frame before each action."""

    def cycle(carry: tuple[Belief, Any], action: Array) -> tuple[tuple[Belief, Any], dict[str, Any]]:
        belief, state = carry
        frame, state = _frame(belief, state, world, planner, rules)
        return (gridworld.step(world, belief, action.astype(jnp.int32), rules.sensing), state), frame

    return jax.lax.scan(cycle, carry, actions)


def _path(
    distance: Int[np.ndarray, "heading h w"], subgoals: Bool[np.ndarray, "heading h w"]
) -> Int[np.ndarray, "poses 3"]:
    """The plan into the nearest of the subgoals."""
    path = shortest_plan(distance, subgoals)[0] if np.any(subgoals & (distance >= 0)) else []
    return np.array(path, int).reshape(-1, 3)


def replay(
    world: World, start: Pose, actions: Int8[np.ndarray, "actions"], *, planner: PlannerLike, rules: Rules
) -> Frames:
    """Take recorded actions once more, and note at every step what the planner saw and wanted.

    The program is compiled once for each kind of planner, rules and size of map, whatever the number of actions.

    Args:
      world: the house.
      start: first pose.
      actions: 0 forward, 1 turn left, 2 turn right.
      planner: who decided them. It plans again at every step; the robot follows `actions` all the same.
      rules: what was seen and what counts as frontier.

    Returns:
      One frame before each action and one after the last, as NumPy arrays.
    """
    n_frames = len(actions) + 1
    padded = np.full(-(-n_frames // _CHUNK) * _CHUNK, NO_ACTION, np.int8)
    padded[: len(actions)] = actions
    carry = first_carry(world, start, planner, rules=rules)
    chunks: list[dict[str, Any]] = []
    path: list[np.ndarray] = []
    for first in range(0, len(padded), _CHUNK):
        chunk = jnp.asarray(padded[first : first + _CHUNK])
        carry, frames = _replay_chunk(carry, chunk, world, planner, rules=rules)
        fetched = jax.device_get(frames)
        path += map(_path, fetched.pop("distance"), fetched["subgoals"])
        chunks.append(fetched)
    whole = jax.tree.map(lambda *parts: np.concatenate(parts)[:n_frames], *chunks)
    if not np.any(whole["mode"] == EXPLORE):
        whole["cost_to_go"] = None
    in_cells = answers_in_cells(getattr(planner, "estimator", None))
    return Frames(**whole, path=tuple(path[:n_frames]), in_cells=in_cells)


def actions_from_letters(letters: str) -> Int8[np.ndarray, "actions"]:
    """Action indices from the letters F, L, R.

    Raises:
      ValueError: for any other letter.
    """
    return np.array([ACTION_LETTERS.index(letter) for letter in letters], np.int8)


def running_extra_steps(frames: Frames) -> Float[np.ndarray, "t"]:
    """Extra steps made so far in percent of the oracle's: 100 (steps + steps left - oracle's) / oracle's.

    Never falls, and ends at the episode's extra steps where the goal is reached. NaN where there is no path to a goal,
    or the robot starts on one.
    """
    steps = np.arange(len(frames))
    oracle = float(frames.to_goal[0])
    if oracle <= 0:
        return np.full(len(frames), np.nan)
    return np.where(frames.to_goal >= 0, 100 * (steps + frames.to_goal - oracle) / oracle, np.nan)


def replay_result(result: EpisodeResult, house: House, rules: Rules, estimator: Estimator | None = None) -> Frames:
    """Replay an episode as `rollouts.evaluation.Runner` gives it.

    Args:
      result: the episode.
      house: where it took place.
      rules: what was seen and what counted as frontier.
      estimator: the network of `dc2g`.

    Raises:
      ValueError: if the rules have another range, the actions do not end as the result says, or for `dc2g` without an
        estimator.
    """
    if (result.range, result.expanding_range) != (rules.sensing.radius, rules.expanding_range):
        raise ValueError(
            f"{result.planner}: sensing range {result.range} is not that of the rules, {rules.sensing.radius}"
        )
    frames = replay(
        World.from_terrain(house.terrain),
        make_pose(result.x, result.y, result.heading),
        actions_from_letters(result.actions),
        planner=planner_with(result.planner, rules, estimator),
        rules=rules,
    )
    if (frames.to_goal[-1] == 0) != result.success:
        raise ValueError(f"{result.planner}: the actions do not end as the result says; they are of another map")
    return frames
