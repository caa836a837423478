"""A bound on the actions of any planner, relative to those of frontier exploration from the same start.

A virtual robot, the shadow, explores as `Frontier` does. It moves for free as long as the robot has already seen what
it would see. The robot follows any planner until it can only just afford to return to the shadow. The proof of the
bound is in docs/notebook/bounded.md.
"""

import dataclasses
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Int

from dc2g_jax._src.grid import bitboard, poses
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import FORWARD_ACTION, Pose, every_heading, moved
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.frontiers import unseen
from dc2g_jax._src.planning.planners import (
    DC2G,
    EXPLORE,
    GAVE_UP,
    TO_GOAL,
    Ask,
    Assessment,
    Frontier,
    Plan,
    Planner,
    asks,
    assess,
    plan_to,
    sensing_of,
)
from dc2g_jax._src.planning.rules import Rules

#: Actions that undo a move forward (two turns, forward, two turns) and a turn.
_UNDO_FORWARD, _UNDO_TURN = 5, 1


class Shadow(NamedTuple):
    """A virtual robot that explores as `Frontier` does and knows only what it would have seen itself.

    Attributes:
      pose: its pose.
      seen: cells that it would have seen.
      reachable: state of its planner.
      action: its next action.
      mode: mode of its plan.
      steps: number of its actions; -1 before the robot's first decision.
    """

    pose: Pose
    seen: Board
    reachable: Board
    action: Int[Array, "*batch"]
    mode: Int[Array, "*batch"]
    steps: Int[Array, "*batch"]


class BoundedState(NamedTuple):
    """State of `Bounded` between steps.

    Attributes:
      planner: state of the wrapped planner.
      shadow: the virtual robot.
      taken: number of decisions so far, which are the robot's actions.
      led: whether the robot returns to the shadow or goes with it.
    """

    planner: Any
    shadow: Shadow
    taken: Int[Array, "*batch"]
    led: Bool[Array, "*batch"]


#: Part of the slack that must be left before a robot that returned to the shadow may leave it again.
_RENEWED = 0.5


@struct.dataclass
class Bounded(Planner):
    """Any planner, with a bound on its actions: `factor * F + slack * (rows + columns)` at most.

    `F` is the number of actions of `Frontier` with these rules from the same start. The bound holds on every map on
    which frontier exploration reaches a goal, whatever the wrapped planner decides, if cells keep their class. On other
    maps the wrapped planner is free once frontier exploration has failed. Each decision counts as an action.

    Attributes:
      planner: the wrapped planner.
      rules: rules of frontier exploration; their field of view must be that of the robot.
      factor: factor on frontier's actions, finite and at least 1.
      slack: additional actions as a multiple of the rows and columns of the map, at least 0. With factor 1 and slack 0,
        the actions are frontier's; with infinite slack, the wrapped planner's.
      virtual_steps: most actions of the shadow per decision, at least 1. The bound holds for any number.
    """

    planner: Planner
    rules: Rules = struct.field(pytree_node=False)
    factor: float
    slack: float
    virtual_steps: int = struct.field(pytree_node=False, default=2)
    batch_per_core: ClassVar[int] = DC2G.batch_per_core

    @property
    def estimator(self) -> Any:
        """The estimator of the wrapped planner, if it has one."""
        return self.planner.estimator  # type: ignore[attr-defined]

    def init(self, world: World) -> BoundedState:
        """The wrapped planner's state. The shadow starts at the first decision, at the robot's pose."""
        sensing_of(self.planner, self.rules.sensing)
        nothing = jnp.zeros_like(world.traversable)
        zero = jnp.zeros(nothing.shape[2:], jnp.int32)
        explores, before = jnp.full_like(zero, EXPLORE), jnp.full_like(zero, -1)
        shadow = Shadow(Pose(zero, zero, zero), nothing, nothing, action=zero, mode=explores, steps=before)
        return BoundedState(self.planner.init(world), shadow, taken=zero, led=jnp.zeros_like(zero, bool))

    def look(self, belief: Belief, state: BoundedState) -> tuple[Bool[Array, "*batch"], Any]:
        """What the wrapped planner looks at."""
        if asks(self.planner):
            return self.planner.look(belief, state.planner)
        return jnp.zeros(belief.pose.x.shape, bool), ()

    def ask(self, belief: Belief, state: BoundedState) -> Any:
        """The answer that the wrapped planner gets."""
        if asks(self.planner):
            return self.planner.ask(belief, state.planner)
        return jnp.zeros((0, belief.height, belief.width, *belief.pose.x.shape))

    def conclude(self, belief: Belief, state: BoundedState, looked: Any, ask: Ask) -> tuple[Assessment, BoundedState]:
        """The wrapped planner's decision, or that of the shadow where its actions could exceed the bound."""
        if asks(self.planner):
            assessment, planner_state = self.planner.conclude(
                belief, state.planner, looked, lambda belief, own: ask(belief, state._replace(planner=own))
            )
        else:
            assessment, planner_state = assess(self.planner, belief, state.planner, self.rules)
        plan, after = self._bounded(belief, assessment.plan, state)
        return dataclasses.replace(assessment, plan=plan), after._replace(planner=planner_state)

    def revised(self, state: BoundedState, changed: Board) -> BoundedState:
        """The state after these cells changed their class: without a bound if there are any.

        The robot then follows the wrapped planner alone, since the shadow has not seen the map as it is now.
        """
        mode = jnp.where(bitboard.is_empty(changed), state.shadow.mode, GAVE_UP)
        planner_state = self.planner.revised(state.planner, changed)
        return state._replace(planner=planner_state, shadow=state.shadow._replace(mode=mode))

    def _caught_up(self, belief: Belief, shadow: Shadow) -> Shadow:
        """The shadow after its next actions, as far as the robot has seen what it would see."""

        def goes_on(carry: tuple[Shadow, Array, Array]) -> Bool[Array, ""]:
            return carry[2] & (carry[1] < self.virtual_steps)

        def follow(carry: tuple[Shadow, Array, Array]) -> tuple[Shadow, Array, Array]:
            shadow, moves = self._followed(belief, carry[0])
            return shadow, carry[1] + 1, jnp.any(moves)

        return jax.lax.while_loop(goes_on, follow, (shadow, jnp.int32(0), jnp.bool_(True)))[0]

    def _followed(self, belief: Belief, shadow: Shadow) -> tuple[Shadow, Bool[Array, "*batch"]]:
        """The shadow after its next action, if it can take it; and whether it can. The first one starts it."""
        next_pose = _chosen(shadow.steps < 0, belief.pose, _next_pose(belief, shadow.pose, shadow.action))
        view = self.rules.sensing.visible(next_pose, belief.opaque, belief.width)
        # With occlusion, cells that the robot has not seen hide nothing here. So if all cells in this view have been
        # seen, none of those that hide others is missing, and the view is the true one.
        certain = _same(next_pose, belief.pose) | ~bitboard.intersects(view, unseen(belief))
        arrived = bitboard.contains(belief.goals & shadow.seen, shadow.pose.x, shadow.pose.y)
        moves = certain & ~arrived & (shadow.mode != GAVE_UP)
        # Shadows that wait know no ground, so that no search runs for them.
        seen = jnp.where(moves, shadow.seen | (view & belief.seen), jnp.uint32(0))
        known = {name: getattr(belief, name) & seen for name in ("classes", "seen", "traversable", "goals")}
        own_belief = dataclasses.replace(belief, pose=next_pose, **known)
        plan, reachable = Frontier(self.rules).plan(own_belief, shadow.reachable)
        later = Shadow(next_pose, seen, reachable, plan.action, plan.mode, shadow.steps + 1)
        return _chosen(moves, later, shadow), moves

    def _bounded(self, belief: Belief, wrapped: Plan, state: BoundedState) -> tuple[Plan, BoundedState]:
        """The plan that keeps the bound."""
        shadow = self._caught_up(belief, state.shadow)
        there = _same(belief.pose, shadow.pose)
        target = _chosen(there, _next_pose(belief, shadow.pose, shadow.action), shadow.pose)
        to_goal = wrapped.mode == TO_GOAL
        # Goals count whatever the wrapped planner says of them, or it could break the bound by changing its mind.
        subgoals = poses.only(target, *belief.goals.shape[:2]) | every_heading(belief.goals)
        back = plan_to(belief, subgoals, belief.traversable, jnp.where(to_goal, TO_GOAL, EXPLORE))
        slack = self.slack * (belief.height + belief.width)
        left = self.factor * shadow.steps + slack - state.taken - jnp.where(there, 0, back.length)
        affordable = left >= 1 + jnp.where(wrapped.action == FORWARD_ACTION, _UNDO_FORWARD, _UNDO_TURN)
        led = ~affordable | (state.led & (left < _RENEWED * slack))
        ahead = _next_pose(belief, belief.pose, wrapped.action)
        possible = bitboard.contains(belief.traversable, ahead.x, ahead.y) & (wrapped.mode != GAVE_UP)
        free = possible & affordable & (~led | to_goal)
        without_bound = (shadow.mode == GAVE_UP) | (back.mode == GAVE_UP)
        after = state._replace(shadow=shadow, taken=state.taken + 1, led=led)
        return _chosen(free | without_bound, wrapped, back), after


def _same(a: Pose, b: Pose) -> Bool[Array, "*batch"]:
    return (a.x == b.x) & (a.y == b.y) & (a.heading == b.heading)


def _next_pose(belief: Belief, pose: Pose, action: Int[Array, "*batch"]) -> Pose:
    return moved(pose, action, belief.height, belief.width)


def _chosen(condition: Bool[Array, "*batch"], one: Any, other: Any) -> Any:
    """One tree where the condition holds, else the other."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)
