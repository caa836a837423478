"""A planner that goes where a learned score, the cost of exploring from there, is lowest, on any kind of map."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int

from dc2g_jax._src.estimation.estimators import PLAIN_CLASSES, Estimates, Estimator, Extent, trait, update_where
from dc2g_jax._src.estimation.extents import TownWindow
from dc2g_jax._src.grid import bitboard, poses, search
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import FORWARD, HEADINGS, Pose, PoseSet, every_heading
from dc2g_jax._src.grid.sensing import PAPER_DEGREES
from dc2g_jax._src.grid.squares import at_cells, corner_sums, in_rectangle
from dc2g_jax._src.grid.streets import in_town
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning import frontiers
from dc2g_jax._src.planning.planners import (
    Ask,
    Assessment,
    SubgoalPlanner,
    explore_or_finish,
    observed_terrain,
    summarized,
)
from dc2g_jax._src.planning.rules import Rules
from dc2g_jax._src.planning.selection import mean_of, mean_outcome
from dc2g_jax._src.runtime.errors import InputError, short
from dc2g_jax._src.runtime.programs import apart

#: Cells a side of the squares that the map is divided into; each has at most one candidate.
SIDE = 8

#: Terms of the score that differ between the poses of a square, see `LearnedScore`; they select its candidate.
POSE_TERMS = ("actions", "log_actions", "gain", "log_gain", "kept")

#: Terms about what is around a candidate.
AREA_TERMS = ("unseen_8", "unseen_16", "unseen_32", "free_ahead", "frontier", "straight_ahead", "winding")

#: All terms but the cost-to-go, whose weight is 1.
TERMS = (*POSE_TERMS, *AREA_TERMS)

#: Terms that tell what a candidate reveals; the others are of the path to it.
_REVEALS = np.flatnonzero(~np.isin(TERMS, ("actions", "log_actions", "straight_ahead", "winding")))

#: Distance ahead and radius, in cells, of the squares of the area terms: unobserved, free and frontier cells.
_UNSEEN, _FREE, _FRONTIER = ((0, 8), (0, 16), (0, 32)), (6, 4), (0, 3)

#: XLA has no code for the minimum of floats within one CPU operation. So scores are rounded to integers of 23 bits,
#: sign included.
_STEPS_PER_CELL, _MOST_STEPS = 2**11, 2**22 - 1


class Candidates(NamedTuple):
    """The most promising pose of each square of the map, row by row.

    Attributes:
      pose: the poses.
      present: whether the square has a candidate.
      cost: predicted cost-to-go there, in cells; 0 without prediction.
      terms: values of `TERMS`.
      score: the score, in cells.
    """

    pose: Pose
    present: Bool[Array, "square *batch"]
    cost: Float[Array, "square *batch"]
    terms: Float[Array, "term square *batch"]
    score: Float[Array, "square *batch"]


class ScoredChoice(NamedTuple):
    """State of `LearnedScore` between steps.

    Attributes:
      reachable: reachable cells at the last step.
      subgoals: the pose chosen last.
      chosen_from: cells that had been observed then.
      candidates: the candidates then.
      estimates: the estimator's last two answers, the newest first.
      choices: number of choices so far.
      estimator: state of the estimator.
    """

    reachable: Board
    subgoals: PoseSet
    chosen_from: Board
    candidates: Candidates
    estimates: tuple[Estimates, Estimates]
    choices: Int[Array, "*batch"]
    estimator: Any


def _as_integers(score: Float[Array, "..."]) -> Int[Array, "..."]:
    """Scores as integers in the same order."""
    return jnp.round(jnp.clip(score * _STEPS_PER_CELL, -_MOST_STEPS, _MOST_STEPS)).astype(jnp.int32)


def _weighted(weights: Array, values: Sequence[Array] | Array) -> Float[Array, "..."]:
    """The weighted sum, added term by term: XLA has no code for such a sum within one CPU operation."""
    return functools.reduce(jnp.add, [weight * value for weight, value in zip(weights, values, strict=True)])


def _pose_terms(view_size: int, distance: Array, gain: Array, kept: Array) -> list[Float[Array, "..."]]:
    """`POSE_TERMS` of poses."""
    actions, new = jnp.maximum(distance, 0).astype(jnp.float32), jnp.maximum(gain, 1).astype(jnp.float32)
    return [actions, jnp.log(actions + 1), new / view_size, jnp.log(new), kept.astype(jnp.float32)]


def _best_of_squares(
    eligible: Bool[Array, "heading h w *batch"], score: Float[Array, "heading h w *batch"]
) -> tuple[Pose, Bool[Array, "square *batch"]]:
    """The eligible pose with the lowest score in each square, and whether there is one."""
    height, width, *batch = score.shape[1:]
    down, across = -(-height // SIDE), -(-width // SIDE)
    heading, y, x = (jax.lax.broadcasted_iota(jnp.int32, score.shape, axis) for axis in range(3))
    place = heading * SIDE**2 + y % SIDE * SIDE + x % SIDE
    none = jnp.iinfo(jnp.int32).max
    # The score, and the place in the square in the lowest 8 bits.
    order = jnp.where(eligible, _as_integers(score) * (HEADINGS * SIDE**2) + place, none)
    margins = [(0, 0), (0, down * SIDE - height), (0, across * SIDE - width), *((0, 0) for _ in batch)]
    order = jnp.min(jnp.pad(order, margins, constant_values=none), axis=0)
    order = jnp.min(order.reshape(down, SIDE, across, SIDE, *batch), axis=(1, 3)).reshape(-1, *batch)
    present, there = order != none, jnp.where(order == none, 0, order % (HEADINGS * SIDE**2))
    square = jnp.arange(down * across).reshape(-1, *(1 for _ in batch))
    y = jnp.minimum(square // across * SIDE + there // SIDE % SIDE, height - 1)
    x = jnp.minimum(square % across * SIDE + there % SIDE, width - 1)
    return Pose(x, y, there // SIDE**2), present


def _area_terms(
    belief: Belief, reachable: Board, pose: Pose, actions: Float[Array, "square *batch"]
) -> Float[Array, "term square *batch"]:
    """`AREA_TERMS` of the candidates."""
    sets = (frontiers.unseen(belief), belief.traversable, frontiers.frontier_cells(belief, reachable))
    unseen, free, frontier = (corner_sums(bitboard.unpack(board, belief.width)) for board in sets)
    ahead = jnp.asarray(FORWARD, jnp.int32)

    def within(sums: Array, square: tuple[int, int]) -> Float[Array, "square *batch"]:
        cells, radius = square
        x, y = (at + cells * ahead[pose.heading, axis] for axis, at in enumerate((pose.x, pose.y)))
        return in_rectangle(sums, x - radius, y - radius, x + radius + 1, y + radius + 1).astype(jnp.float32)

    across, down = pose.x - belief.pose.x, pose.y - belief.pose.y
    robot = ahead[belief.pose.heading]
    straight = (across * robot[..., 0] + down * robot[..., 1]).astype(jnp.float32)
    cells = (jnp.abs(across) + jnp.abs(down)).astype(jnp.float32)
    shares = [within(unseen, square) / (2 * square[1] + 1) ** 2 for square in _UNSEEN]
    free_ahead, at_frontier = within(free, _FREE) / (2 * _FREE[1] + 1) ** 2, within(frontier, _FRONTIER)
    return jnp.stack([*shares, free_ahead, at_frontier / (2 * _FRONTIER[1] + 1), straight, actions / (cells + 4)])


def weights_of(score: Mapping[str, Mapping[str, Any]], degrees: float | None = None) -> Float[Array, "term"]:
    """The weights of `TERMS` for the field of view nearest in width, by ratio; the narrower of two equally near ones.

    Args:
      score: see `estimation.estimators.Estimator`.
      degrees: width of the field of view; `None` for the paper's.

    Raises:
      InputError: the weights are not by degrees, or a term is missing or unknown.
    """
    if not all(isinstance(terms, Mapping) for terms in score.values()):
        raise InputError(f"the network's score is {short(score)}; nest it under the degrees: {{'90': {{...}}}}")
    wanted = PAPER_DEGREES if degrees is None else degrees
    terms = score[min(score, key=lambda learned: (abs(math.log(float(learned) / wanted)), float(learned)))]
    if {*terms} != {*TERMS}:
        raise InputError(
            f"the network's score has the terms {', '.join(terms)}; expected {', '.join(TERMS)}; train the score anew "
            "(dc2g train --target steps)"
        )
    return jnp.asarray([terms[term] for term in TERMS], jnp.float32)


@struct.dataclass
class LearnedScore(SubgoalPlanner):
    """Heads for the candidate with the lowest score, or for the goal once it is reachable.

    Candidates are poses that reveal something: in each square of 8 cells a side, the pose with the lowest sum of the
    cost and the terms that differ within a square. The score is the cost of a search from there, in cells of
    cost-to-go:

        score = cost + weights * terms

    `cost` is the estimator's cost-to-go: the mean of its last answers to the map and to its mirror image, which it is
    given in turn. While only free and occupied cells have been observed, the estimator is not asked and `cost` is 0. In
    a town (see `estimation.extents.TownWindow`) it is given the surroundings of the robot. The terms are:

    - `actions` to the pose, and `log_actions`, the logarithm of one more;
    - `gain`, the cells newly seen there as a share of the field of view, and `log_gain`, the logarithm of their number;
    - `kept`, 1 for the last choice, so that choices are stable;
    - `unseen_R`, the share of unobserved cells in the square of radius R around the pose; `free_ahead`, of free cells
      in that of radius 4 around the cell 6 ahead; `frontier`, frontier cells in that of radius 3, per cell of its side;
    - `straight_ahead`, cells ahead of the robot along its heading; `winding`, actions divided by 4 more than the
      Manhattan distance.

    The weights are learned from searches, see `training.score`. The robot chooses again only after it has seen
    something new, so exploration ends.

    Attributes:
      rules: field of view and poses of a goal.
      weights: weight of each of `TERMS`.
      estimator: estimator of the cost-to-go, in cells; `None` to do without.
      summary: summary of its outcomes, such as a quantile, see `planning.selection`.
      replan_fraction: share of the cells in the field of view that must be newly seen before the planner chooses again;
        it also does so when its subgoal reveals nothing more.
      terms: names of the terms, in the order of the weights.
    """

    rules: Rules = struct.field(pytree_node=False)
    weights: Float[Array, "term"]
    estimator: Estimator | None = None
    summary: Callable[[Array], Array] = struct.field(pytree_node=False, default=mean_outcome)
    replan_fraction: float = struct.field(pytree_node=False, default=1 / 3)
    batch_per_core: ClassVar[int] = 16
    terms: ClassVar[tuple[str, ...]] = TERMS

    @property
    def knows_outside(self) -> bool:  # type: ignore[override]
        """See `Planner`: if its estimator, if any, does."""
        return self.estimator is None or trait(self.estimator, "knows_outside")

    def init(self, world: World) -> ScoredChoice:
        """Nothing is reachable before the first observation. The estimator initializes its own state."""
        nothing, batch = jnp.zeros_like(world.goals), world.goals.shape[2:]
        squares = (-(-world.height // SIDE) * -(-world.width // SIDE), *batch)
        zero = jnp.zeros(squares, jnp.int32)
        value = zero.astype(jnp.float32)
        terms = jnp.zeros((len(TERMS), *squares), jnp.float32)
        prior = jnp.full((1, world.height, world.width, *batch), self._extent(world).prior, jnp.float32)
        state = () if self.estimator is None else self.estimator.init(world)
        return ScoredChoice(
            nothing, every_heading(nothing), nothing,
            Candidates(Pose(zero, zero, zero), zero != 0, value, terms, value),
            (prior, prior), jnp.zeros(batch, jnp.int32), state,
        )  # fmt: skip

    def _extent(self, world: World) -> Extent:
        """The part of the map that the estimator is given; a world stands for a belief at the start of an episode."""
        side = trait(self.estimator, "side")
        if side is None or max(world.height, world.width) <= side:
            return trait(self.estimator, "extent")
        zooms = in_town(world) if isinstance(world, Belief) else jnp.zeros(world.goals.shape[2:], bool)
        return TownWindow(zooms, side)

    def look(self, belief: Belief, state: ScoredChoice) -> tuple[Bool[Array, "*batch"], Any]:
        """Whether the estimator is asked; whether a choice is due, reachable cells, and poses that reveal something."""
        due, looked = super().look(belief, state)
        return due & self._readable(belief, belief.seen), looked

    def _readable(self, belief: Belief, cells: Board) -> Bool[Array, "*batch"]:
        """Whether there is an estimator that predicts something from these observed cells."""
        if self.estimator is None:
            return jnp.zeros(belief.pose.x.shape, bool)
        every = jnp.bool_(not trait(self.estimator, "needs_classes"))
        plain = functools.reduce(jnp.bitwise_or, map(belief.of_class, PLAIN_CLASSES))
        return ~bitboard.is_empty(cells & ~plain) | every

    def ask(self, belief: Belief, state: ScoredChoice) -> Estimates:
        """The estimator's answer to the map or its mirror image, in turn."""
        if self.estimator is None:
            return state.estimates[0]
        part, mirror = self._extent(belief).part(observed_terrain(belief), belief.pose), state.choices % 2 == 1
        answer = summarized(self.estimator, self.summary, jnp.where(mirror, part[:, ::-1], part), state.estimator)
        return jnp.where(mirror, answer[:, :, ::-1], answer)

    def candidates(
        self, belief: Belief, reachable: Board, revealing: PoseSet, kept: PoseSet, cost: Float[Array, "h w *batch"]
    ) -> Candidates:
        """The candidates and their scores.

        Args:
          belief: belief of the robot.
          reachable: reachable cells.
          revealing: poses to choose from.
          kept: the pose chosen last.
          cost: cost-to-go of every cell.
        """
        width, sensing = belief.width, self.rules.sensing
        distance = apart(lambda pose, free: search.distances(pose, free, width), belief.pose, reachable)
        gain = sensing.count_seen(frontiers.unseen(belief), belief.opaque, width)
        known = distance, gain, poses.unpack(kept, width)
        terms_of = functools.partial(_pose_terms, len(sensing.offsets[0]))
        of_a_pose = self.weights[: len(POSE_TERMS)]
        partial_score = apart(lambda cost, *known: cost + _weighted(of_a_pose, terms_of(*known)), cost, *known)
        eligible = poses.unpack(revealing, width) & (distance >= 0)
        pose, present = apart(_best_of_squares, eligible, partial_score)
        flat = (pose.heading * belief.height + pose.y) * width + pose.x
        own = terms_of(*(jnp.take_along_axis(each.reshape(-1, *flat.shape[1:]), flat, axis=0) for each in known))
        terms = jnp.concatenate([jnp.stack(own), apart(_area_terms, belief, reachable, pose, own[0])])
        costs = at_cells(cost, pose.x, pose.y)
        return Candidates(pose, present, costs, terms, costs + _weighted(self.weights, terms))

    def choose(self, inputs: tuple[Belief, Board, PoseSet], state: ScoredChoice, ask: Ask) -> ScoredChoice:
        """The candidate with the lowest score; none if a score is NaN."""
        belief, reachable, revealing = inputs
        estimates = state.estimates
        if self.estimator is not None:
            known = self._readable(belief, belief.seen)
            knew = self._readable(belief, state.chosen_from) & (state.choices > 0)
            merged = self._extent(belief).merged(ask(belief, state), belief.pose, estimates[0])
            latest = jnp.where(known, merged, estimates[0])
            # The first estimate stands for both views.
            estimates = latest, jnp.where(known & knew, estimates[0], latest)
        found = self.candidates(belief, reachable, revealing, state.subgoals, mean_of(estimates)[0])
        valid = jnp.all(~found.present | (found.score == found.score), axis=0)
        order = jnp.where(found.present, _as_integers(found.score), jnp.iinfo(jnp.int32).max)
        best = jnp.argmin(order, axis=0).astype(jnp.int32)[None]
        pose = jax.tree.map(lambda values: jnp.take_along_axis(values, best, axis=0)[0], found.pose)
        chosen = poses.only(pose, *reachable.shape[:2])
        chosen = jnp.where(valid & jnp.any(found.present, axis=0), chosen, jnp.uint32(0))
        return ScoredChoice(reachable, chosen, belief.seen, found, estimates, state.choices + 1, state.estimator)

    def conclude(self, belief: Belief, state: ScoredChoice, looked: Any, ask: Ask) -> tuple[Assessment, ScoredChoice]:
        """Head for the chosen pose, or for the goal. Candidates and scores are those of the choice."""
        _, (due, reachable, revealing) = looked
        state = update_where(functools.partial(self.choose, ask=ask), due, (belief, reachable, revealing), state)
        plan = explore_or_finish(belief, reachable, state.subgoals & revealing, self.rules)
        penalty = _weighted(self.weights[_REVEALS], state.candidates.terms[_REVEALS])
        candidates, score, penalty = _on_map(belief, state.candidates, penalty)
        assessment = Assessment(plan, reachable, candidates & revealing, score)
        if self.estimator is not None:
            assessment = dataclasses.replace(assessment, cost_to_go=mean_of(state.estimates)[0], penalty=penalty)
        return assessment, state._replace(reachable=reachable)


def _on_map(
    belief: Belief, found: Candidates, penalty: Float[Array, "square *batch"]
) -> tuple[PoseSet, Float[Array, "h w *batch"], Float[Array, "h w *batch"]]:
    """The candidates as a set of poses, and for each cell, the score and penalty of its square's candidate."""
    height, width, batch = belief.height, belief.width, belief.pose.x.shape
    rows, columns = (
        jnp.arange(size).reshape(*shape, *(1 for _ in batch)) for size, shape in ((height, (-1, 1)), (width, (1, -1)))
    )

    def on_map(values: Array) -> Array:
        squares = values.reshape(-(-height // SIDE), 1, -(-width // SIDE), 1, *batch)
        cells = jnp.broadcast_to(squares, (squares.shape[0], SIDE, squares.shape[2], SIDE, *batch))
        return cells.reshape(squares.shape[0] * SIDE, squares.shape[2] * SIDE, *batch)[:height, :width]

    here = on_map(found.present) & (on_map(found.pose.x) == columns) & (on_map(found.pose.y) == rows)
    headings = on_map(found.pose.heading)
    candidates = poses.pack(jnp.stack([here & (headings == heading) for heading in range(HEADINGS)]))
    return candidates, on_map(found.score), on_map(penalty)
