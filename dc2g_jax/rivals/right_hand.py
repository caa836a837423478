"""The right-hand rule: follow the wall, one hand on it. The oldest way out of a maze."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Bool, Int

from dc2g_jax.grid import (
    FORWARD,
    FORWARD_ACTION,
    HEADINGS,
    LEFT_ACTION,
    RIGHT_ACTION,
    Belief,
    Board,
    PoseSet,
    World,
    bitboard,
    every_heading,
    only,
    poses,
)
from dc2g_jax.planning import (
    EXPLORE,
    TO_GOAL,
    Assessment,
    Plan,
    Planner,
    Rules,
    explore_or_finish,
    exploring_poses,
    reachable_cells,
)


class Walk(NamedTuple):
    """State between steps.

    Attributes:
      reachable: reachable cells at the last step.
      seen: cells observed at the last step.
      walked: poses in which a move forward has ended since something new was seen.
      moved: whether the last action was a move forward.
      at_wall: whether the robot follows a wall; before, it goes straight on.
      around: whether it has walked around without seeing anything new, and looks for another wall.
    """

    reachable: Board
    seen: Board
    walked: PoseSet
    moved: Bool[Array, "*batch"]
    at_wall: Bool[Array, "*batch"]
    around: Bool[Array, "*batch"]


@struct.dataclass
class RightHand(Planner):
    """Goes straight on to a wall and follows it, right hand on it, until it sees the goal and a way there.

    The rule, which is folklore, finds every goal beside the outer wall of a maze, but circles islands forever. A robot
    that is back where it has been since it last saw something new goes to the nearest frontier-expanding pose and
    begins anew there. So exploration ends. To feel the wall, it turns right after a move unless it knows that the cell
    there is blocked: robots do not see beside them.

    Attributes:
      rules: field of view and definition of frontiers.
    """

    rules: Rules = struct.field(pytree_node=False)

    def init(self, world: World) -> Walk:
        """Before the first step, nothing is known."""
        nothing = jnp.zeros_like(world.traversable)
        no = jnp.zeros(nothing.shape[2:], bool)
        return Walk(nothing, nothing, every_heading(nothing), moved=no, at_wall=no, around=no)

    def _beside(self, belief: Belief, turn: int) -> tuple[Bool[Array, "*batch"], Bool[Array, "*batch"]]:
        """Whether the cell ahead of the robot, after a turn to the right or none, is free; and whether it is known."""
        dx, dy = jnp.moveaxis(jnp.asarray(FORWARD, jnp.int32)[(belief.pose.heading + turn) % HEADINGS], -1, 0)
        x, y = belief.pose.x + dx, belief.pose.y + dy
        inside = (x >= 0) & (x < belief.width) & (y >= 0) & (y < belief.height)
        x, y = jnp.clip(x, 0, belief.width - 1), jnp.clip(y, 0, belief.height - 1)
        free, known = (bitboard.contains(board, x, y) for board in (belief.traversable, belief.seen))
        return free & inside, known | ~inside

    def _step_along_wall(self, belief: Belief, state: Walk) -> Int[Array, "*batch"]:
        """Right if the wall may have ended there, else ahead, else left."""
        ahead, _ = self._beside(belief, 0)
        right, right_known = self._beside(belief, 1)
        look_right = state.at_wall & state.moved & (right | ~right_known)
        action = jnp.where(ahead, FORWARD_ACTION, LEFT_ACTION)
        return jnp.where(look_right, RIGHT_ACTION, action).astype(jnp.int32)

    def assess(self, belief: Belief, state: Walk) -> tuple[Assessment, Walk]:
        """Follow the wall, or head for the goal once it is reachable."""
        reachable = reachable_cells(belief, state.reachable)
        candidates = exploring_poses(belief, reachable, self.rules)
        news = ~bitboard.is_empty(belief.seen ^ state.seen)
        here = only(belief.pose, *reachable.shape[:2])
        walked = jnp.where(news, jnp.uint32(0), state.walked)
        around = ~news & (state.around | (state.moved & ~poses.is_empty(walked & here)))
        # After the way to another frontier, the robot is at no wall.
        at_wall = state.at_wall & ~state.around
        search = jnp.where(around, candidates, jnp.uint32(0))
        plan = explore_or_finish(belief, reachable, search, self.rules)
        follows = (plan.mode != TO_GOAL) & ~around & ~poses.is_empty(candidates)
        action = self._step_along_wall(belief, state._replace(at_wall=at_wall))
        along = Plan(action, jnp.full_like(plan.mode, EXPLORE), jnp.ones_like(plan.length), candidates)
        plan = jax.tree.map(lambda one, other: jnp.where(follows, one, other), along, plan)
        moved = plan.action == FORWARD_ACTION
        walked = jnp.where(state.moved, walked | here, walked)
        state = Walk(reachable, belief.seen, walked, moved, at_wall | (follows & (action == LEFT_ACTION)), around)
        return Assessment(plan, reachable, candidates), state

    def revised(self, state: Walk, changed: Board) -> Walk:
        """The state without the ground, which can be lost, and without the walk."""
        del changed
        nothing = jnp.zeros_like(state.reachable)
        return state._replace(reachable=nothing, walked=every_heading(nothing))
