"""A planner whose subgoals are chosen by one score: a weighted sum of a dozen terms, whatever the map."""

import functools
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.estimation.estimators import PLAIN_CLASSES, NetworkCostToGo, update_where
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import FORWARD, HEADINGS, Pose, PoseSet, every_heading
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.choosing import at_cells
from dc2g_jax._src.planning.planners import (
    Ask,
    Assessment,
    Planner,
    explore_or_finish,
    in_view,
    observed_terrain,
    reachable_cells,
)
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.planning.selection import mean_of
from dc2g_jax._src.runtime.programs import apart

#: Cells a side of the squares that the map is divided into; each has one candidate at most.
SIDE = 8

#: Squares whose shares of unobserved, free and frontier cells are terms: cells ahead of the pose, and radius.
_UNSEEN, _FREE, _FRONTIER = ((0, 8), (0, 16), (0, 32)), ((6, 4),), ((0, 3),)

#: The terms of the score, see `Scored`.
TERMS = (
    "actions", "log_actions", "gain", "log_gain", "cost", "kept", "unseen_8", "unseen_16", "unseen_32",
    "free_ahead", "frontier_3", "straight_ahead", "winding",
)  # fmt: skip

#: Those that differ from pose to pose within a square; they choose its candidate.
_OF_POSES = TERMS[:6]

#: The network is asked about the map and its mirror image in turn.
_VIEWS = ((), (1,))

#: XLA has no code for the least of floats within an operation of a CPU. So scores are rounded to integers.
_STEPS_PER_UNIT, _MOST_STEPS = 2**16, 2**22 - 1


class Candidates(NamedTuple):
    """The most promising pose of each square of the map.

    Attributes:
      pose: the poses.
      present: whether the square has one.
      of_poses: their first terms, see `Scored`.
    """

    pose: Pose
    present: Bool[Array, "square *batch"]
    of_poses: Float[Array, "term square *batch"]


class Choice(NamedTuple):
    """State between steps.

    Attributes:
      reachable: reachable cells at the last step.
      subgoal: the pose chosen last.
      chosen_from: cells that had been observed then.
      estimate: the network's last cost-to-go.
      choices: number of choices so far.
      terms: the terms of all candidates at the last choice, for learning.
      present: which squares had a candidate then.
      score: their scores, as integers.
      forced: the candidate to choose next, whatever its score; -1 for the best.
    """

    reachable: Board
    subgoal: PoseSet
    chosen_from: Board
    estimate: Float[Array, "h w *batch"]
    choices: Int[Array, "*batch"]
    terms: Float[Array, "term square *batch"]
    present: Bool[Array, "square *batch"]
    score: Int[Array, "square *batch"]
    forced: Int[Array, "*batch"]


def _with_classes(belief: Belief) -> Bool[Array, "*batch"]:
    """Whether anything has been observed that a network can read, see `estimation.estimators.PLAIN_CLASSES`."""
    plain = functools.reduce(jnp.bitwise_or, map(belief.of_class, PLAIN_CLASSES))
    return ~bitboard.is_empty(belief.seen & ~plain)


def _as_integers(score: Float[Array, "..."]) -> Int[Array, "..."]:
    """Scores as integers in the same order, of 23 bits with the sign."""
    return jnp.round(jnp.clip(score * _STEPS_PER_UNIT, -_MOST_STEPS, _MOST_STEPS)).astype(jnp.int32)


def _weighted(weights: Float[Array, "term"], values: Float[Array, "term ..."]) -> Float[Array, "..."]:
    """The weighted sum, added term by term: XLA has no code for such a sum within an operation of a CPU."""
    return functools.reduce(jnp.add, [weight * value for weight, value in zip(weights, values, strict=True)])


def _terms_of_poses(
    view_size: int, distance: Array, gain: Array, kept: Array, cost: Array
) -> Float[Array, "term heading h w *batch"]:
    """The first terms, of every pose."""
    actions, new = jnp.maximum(distance, 0).astype(jnp.float32), jnp.maximum(gain, 1).astype(jnp.float32)
    values = (actions, jnp.log(actions + 1), new / view_size, jnp.log(new), jnp.broadcast_to(cost, actions.shape), kept)
    return jnp.stack([value.astype(jnp.float32) for value in values])


def candidates(
    belief: Belief, revealing: PoseSet, of_poses: Float[Array, "term heading h w *batch"], score: Array, reached: Array
) -> Candidates:
    """The pose of the lowest score in each square.

    Args:
      belief: belief of the robot.
      revealing: poses to choose from.
      of_poses: terms of every pose.
      score: their weighted sum, by which a square's pose is chosen.
      reached: whether each pose can be reached.
    """
    height, width, *batch = score.shape[1:]
    down, across = -(-height // SIDE), -(-width // SIDE)
    place = np.arange(HEADINGS)[:, None, None] * SIDE**2 + np.arange(height)[:, None] % SIDE * SIDE
    place = (place + np.arange(width) % SIDE).reshape(HEADINGS, height, width, *(1 for _ in batch))
    none = jnp.iinfo(jnp.int32).max
    # The score, and the place in the square in the lowest 8 bits.
    order = jnp.where(poses.unpack(revealing, width) & reached, _as_integers(score) * HEADINGS * SIDE**2 + place, none)
    margins = [(0, 0), (0, down * SIDE - height), (0, across * SIDE - width), *((0, 0) for _ in batch)]
    order = jnp.min(jnp.pad(order, margins, constant_values=none), axis=0)
    order = jnp.min(order.reshape(down, SIDE, across, SIDE, *batch), axis=(1, 3)).reshape(-1, *batch)
    present, there = order != none, jnp.where(order == none, 0, order % (HEADINGS * SIDE**2))
    square = jnp.arange(down * across).reshape(-1, *(1 for _ in batch))
    y = jnp.minimum(square // across * SIDE + there // SIDE % SIDE, height - 1)
    x = jnp.minimum(square % across * SIDE + there % SIDE, width - 1)
    pose = Pose(x, y, there // SIDE**2)
    flat = ((pose.heading * height + y) * width + x)[None]
    values = of_poses.reshape(of_poses.shape[0], -1, *batch)
    return Candidates(pose, present, jnp.take_along_axis(values, flat, axis=1))


def _sums(cells: Bool[Array, "set h w *batch"]) -> Int[Array, "set below right *batch"]:
    """Number of cells of each set above and left of each corner of the grid."""

    def along(axis: int, counts: Array) -> Array:
        rows = jnp.moveaxis(counts, axis, 0)
        sums = jax.lax.scan(lambda above, row: (above + row,) * 2, jnp.zeros_like(rows[0]), rows)[1]
        return jnp.moveaxis(sums, 0, axis)

    sums = along(2, along(1, cells.astype(jnp.int32)))
    return jnp.pad(sums, [(0, 0), (1, 0), (1, 0), *((0, 0) for _ in cells.shape[3:])])


def _terms_of_squares(belief: Belief, reachable: Board, found: Candidates) -> Float[Array, "term square *batch"]:
    """The other terms, of the candidates."""
    height, width, pose = belief.height, belief.width, found.pose
    sets = (frontiers.unseen(belief), belief.traversable, frontiers.frontier_cells(belief, reachable))
    sums = _sums(jnp.stack([bitboard.unpack(board, width) for board in sets]))
    ahead = jnp.asarray(FORWARD, jnp.int32)

    def within(number: int, square: tuple[int, int]) -> Float[Array, "square *batch"]:
        """Cells of a set in a square ahead of each candidate."""
        cells, radius = square
        x, y = (at + cells * ahead[pose.heading, axis] for axis, at in enumerate((pose.x, pose.y)))
        left, right = (jnp.clip(x + end, 0, width) for end in (-radius, radius + 1))
        top, bottom = (jnp.clip(y + end, 0, height) for end in (-radius, radius + 1))
        corners = [at_cells(sums[number], column, row) for row in (top, bottom) for column in (left, right)]
        return (corners[3] - corners[2] - corners[1] + corners[0]).astype(jnp.float32)

    def side(square: tuple[int, int]) -> int:
        return 2 * square[1] + 1

    across, down = pose.x - belief.pose.x, pose.y - belief.pose.y
    robot = ahead[belief.pose.heading]
    straight = (across * robot[..., 0] + down * robot[..., 1]).astype(jnp.float32)
    cells = (jnp.abs(across) + jnp.abs(down)).astype(jnp.float32)
    return jnp.stack(
        [
            *(within(0, square) / side(square) ** 2 for square in _UNSEEN),
            *(within(1, square) / side(square) ** 2 for square in _FREE),
            *(within(2, square) / side(square) for square in _FRONTIER),
            straight,
            found.of_poses[0] / (cells + 4),
        ]
    )


@struct.dataclass
class Scored(Planner):
    """Heads for the candidate of the lowest score, or for the goal once it is reachable.

    Candidates are poses that reveal something: in each square of the map that of the lowest sum of the terms that
    differ within a square. The score is a weighted sum of:

    - `actions` to the pose, and `log_actions`, the logarithm of one more;
    - `gain`, newly seen cells there in fields of view, and `log_gain`, the logarithm of their number;
    - `cost`, the network's cost-to-go in cells, the mean of its answers to the map and to its mirror image in turn; 0
      on maps without classes, where it is not asked;
    - `kept`, 1 for the last choice: so a choice holds;
    - `unseen_R`, the share of unobserved cells in the square of radius R; `free_ahead`, of free cells in that of radius
      4 around the cell 6 ahead; `frontier_3`, frontier cells in that of radius 3, per cell of its side;
    - `straight_ahead`, cells ahead of the robot along its heading; `winding`, actions per cell of the way.

    Attributes:
      rules: field of view.
      weights: weight of each of `TERMS`.
      network: the network; `None` to do without.
      replan_fraction: share of the cells in the field of view that must be newly seen before the planner chooses anew.
    """

    rules: Rules = struct.field(pytree_node=False)
    weights: Float[Array, "term"]
    network: NetworkCostToGo | None = None
    replan_fraction: float = struct.field(pytree_node=False, default=1 / 3)
    batch_per_core: ClassVar[int] = 16

    def init(self, world: World) -> Choice:
        """Nothing is reachable before the first observation."""
        nothing, batch = jnp.zeros_like(world.goals), world.goals.shape[2:]
        squares = -(-world.height // SIDE) * -(-world.width // SIDE)
        zero = jnp.zeros(batch, jnp.int32)
        return Choice(
            nothing, every_heading(nothing), nothing, jnp.zeros((world.height, world.width, *batch), jnp.float32), zero,
            jnp.zeros((len(TERMS), squares, *batch), jnp.float32), jnp.zeros((squares, *batch), bool),
            jnp.zeros((squares, *batch), jnp.int32), zero - 1,
        )  # fmt: skip

    def _has_network(self, belief: Belief) -> Bool[Array, "*batch"]:
        """Whether there is a network, and a map that it can read."""
        return _with_classes(belief) & (self.network is not None)

    def look(self, belief: Belief, state: Choice) -> tuple[Bool[Array, "*batch"], Any]:
        """Whether the network is asked; whether a choice is due, reachable cells, and poses that reveal something."""
        reachable = reachable_cells(belief, state.reachable)
        revealing = frontiers.complete(belief, reachable, self.rules.sensing)
        undecided = ~poses.is_empty(revealing) & ~bitboard.intersects(reachable, belief.goals)
        news = bitboard.count(belief.seen ^ state.chosen_from)
        enough = max(1, round(self.replan_fraction * len(self.rules.sensing.offsets[0])))
        due = undecided & ((news >= enough) | poses.is_empty(state.subgoal & revealing))
        return due & self._has_network(belief), (due, reachable, revealing)

    def ask(self, belief: Belief, state: Choice) -> Float[Array, "h w *batch"]:
        """The network's mean answer to the map or its mirror image, in turn."""
        if self.network is None:
            return state.estimate
        view = state.choices % len(_VIEWS)
        told = self.network.estimate(in_view(observed_terrain(belief), _VIEWS, view, 0), ())
        return in_view(mean_of(told).astype(jnp.float32), _VIEWS, view, 0)

    def choose(self, inputs: tuple[Belief, Board, PoseSet], state: Choice, ask: Ask) -> Choice:
        """The candidate of the lowest score."""
        belief, reachable, revealing = inputs
        width, sensing = belief.width, self.rules.sensing
        estimate = jnp.where(self._has_network(belief), ask(belief, state), 0.0)
        cost = jnp.where(state.choices > 0, (estimate + state.estimate) / 2, estimate)
        distance = apart(lambda pose, free: search.distances(pose, free, width), belief.pose, reachable)
        gain = sensing.count_seen(frontiers.unseen(belief), belief.opaque, width)
        kept = poses.unpack(state.subgoal, width)
        of_poses = apart(functools.partial(_terms_of_poses, len(sensing.offsets[0])), distance, gain, kept, cost)
        prior = apart(lambda values: _weighted(self.weights[: len(_OF_POSES)], values), of_poses)
        found = apart(candidates, belief, revealing, of_poses, prior, distance >= 0)
        terms = jnp.concatenate([found.of_poses, apart(_terms_of_squares, belief, reachable, found)])
        score = jnp.where(found.present, _as_integers(_weighted(self.weights, terms)), jnp.iinfo(jnp.int32).max)
        best = jnp.argmin(score, axis=0).astype(jnp.int32)
        best = jnp.where(state.forced >= 0, state.forced, best)
        x, y, heading = (
            jnp.take_along_axis(values, best[None], axis=0)[0]
            for values in (found.pose.x, found.pose.y, found.pose.heading)
        )
        return Choice(
            reachable, poses.only(Pose(x, y, heading), *reachable.shape[:2]), belief.seen, estimate, state.choices + 1,
            terms, found.present, score, jnp.full_like(best, -1),
        )  # fmt: skip

    def conclude(self, belief: Belief, state: Choice, looked: Any, ask: Ask) -> tuple[Assessment, Choice]:
        """Head for the chosen pose, or for the goal."""
        _, (due, reachable, revealing) = looked
        state = update_where(functools.partial(self.choose, ask=ask), due, (belief, reachable, revealing), state)
        plan = explore_or_finish(belief, reachable, state.subgoal & revealing, self.rules)
        return Assessment(plan, reachable, revealing), state._replace(reachable=reachable)
