"""Observation masks: what robots have seen at moments of rollouts, instead of the hand-drawn masks of Algorithm 1."""

import functools
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Float, Int, Int8, UInt8, UInt32

from dc2g_jax._src.estimation.estimators import Estimator, ExactCostToGo, world_cost_to_go
from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.bitboard import Board
from dc2g_jax._src.grid.gridworld import Belief, belief_of
from dc2g_jax._src.grid.poses import HEADINGS, Pose, PoseSet, every_heading
from dc2g_jax._src.grid.sensing import PAPER_DEGREES, Kernel, covered, field_of_view, kernel_runs
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import DC2G, Ask, Assessment, Planner, PlannerLike
from dc2g_jax._src.planning.rules import Rules, nearest_goal
from dc2g_jax._src.rollouts.rollout import rollout
from dc2g_jax._src.runtime.devices import deal, gather, mesh_of, on_each, replicate
from dc2g_jax._src.runtime.errors import InputError
from dc2g_jax._src.runtime.programs import jit

_EPISODES_PER_CALL = 128

#: Errors of the leading planners: standard deviations of the logarithm of the cost-to-go's error.
_NOISE = (0.2, 0.5, 1.0)

#: Number of planners of `leading_planners`.
LEADERS = 1 + len(_NOISE)


def _smooth_noise(rng: np.random.Generator, height: int, width: int) -> Float[np.ndarray, "h w"]:
    """A smooth random field of zero mean and unit standard deviation, float32."""
    coarse = rng.standard_normal((8, 8)).astype(np.float32)
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return (field - field.mean()) / field.std()


@functools.cache
def _rings(ranges: tuple[int, ...], degrees: float) -> tuple[Kernel, ...]:
    """For each of ascending ranges, the offsets that a robot with the range before it does not see."""
    kernels = [field_of_view(one, degrees).offsets for one in ranges]
    less = [((),) * HEADINGS, *kernels[:-1]]
    return tuple(
        Kernel(radius, tuple(tuple(sorted({*own} - {*inner})) for own, inner in zip(offsets, nearer, strict=True)))
        for radius, offsets, nearer in zip(ranges, kernels, less, strict=True)
    )


@struct.dataclass
class View:
    """The field of view of one of several ranges. Which one is data, so all of them are one program.

    Attributes:
      number: index of the range.
      ranges: the ranges, ascending, in cells.
      degrees: width of the field of view, the same for all ranges.
    """

    number: Int[Array, ""]
    ranges: tuple[int, ...] = struct.field(pytree_node=False)
    degrees: float = struct.field(pytree_node=False, default=PAPER_DEGREES)

    @property
    def widest(self) -> Kernel:
        """The field of view of the largest range."""
        return field_of_view(self.ranges[-1], self.degrees)

    @property
    def offsets(self) -> tuple[tuple[tuple[int, int], ...], ...]:
        """Those of the largest range."""
        return self.widest.offsets

    def visible(self, pose: Pose, opaque: Board, width: int | Int[Array, ""]) -> Board:
        """See `grid.sensing.Kernel.visible`."""
        radius = self.widest.radius
        tables = [kernel_runs(Kernel(radius, field_of_view(one, self.degrees).offsets)) for one in self.ranges]
        # Some ranges have fewer runs than others; empty runs make up for it.
        empty = np.zeros_like(tables[0][0]) - np.array([0, 1], np.int32)[:, None, None]
        together = itertools.zip_longest(*tables, fillvalue=empty)
        runs = [jnp.asarray(np.array(of_all))[self.number] for of_all in together]
        return covered(pose, radius, runs, opaque.shape[0], opaque.shape[1], width)

    def poses_that_see(self, targets: Board, opaque: Board) -> PoseSet:
        """See `grid.sensing.Kernel.poses_that_see`."""
        seeing = [ring.poses_that_see(targets, opaque) for ring in _rings(self.ranges, self.degrees)]
        within = [jnp.where(index <= self.number, poses, 0) for index, poses in enumerate(seeing)]
        return functools.reduce(jnp.bitwise_or, within)


@struct.dataclass
class _Guess(Estimator):
    """The exact cost-to-go times an error; or the same cost everywhere, so that the nearest subgoal wins."""

    log_error: Float[Array, "h w"]
    informed: Bool[Array, ""]

    def init(self, world: World) -> Float[Array, "h w *batch"]:
        return world_cost_to_go(world)

    def estimate(
        self, terrain: UInt8[Array, "h w *batch"], state: Float[Array, "h w *batch"]
    ) -> Float[Array, "1 h w *batch"]:
        costs = ExactCostToGo(self.log_error).estimate(terrain, state)
        return jnp.where(self.informed, costs, 0.0)


@struct.dataclass
class _Leader(Planner):
    """Explores with the field of view of one of several ranges, led by a guess of the cost-to-go.

    The rollout's field of view must be the widest. The planner keeps the cells that its robot has seen itself.
    """

    guess: _Guess
    view: View
    batch_per_core: ClassVar[int] = DC2G.batch_per_core

    @property
    def _planner(self) -> DC2G:
        sensing: Any = self.view
        # DC2G only takes poses that reveal something, and these are the poses of the complete rules.
        return DC2G(self.guess, Rules(sensing, lambda _, reachable: every_heading(reachable), nearest_goal))

    def _own(self, belief: Belief, state: Any) -> tuple[Belief, Any]:
        """What the robot knows with its own field of view, and the state of the planner."""
        seen, planner_state = state
        seen = seen | self.view.visible(belief.pose, belief.opaque, belief.width)
        return belief_of(belief, belief.pose, belief.steps, seen), planner_state

    def init(self, world: World) -> tuple[Board, Any]:
        return jnp.zeros_like(world.traversable), self._planner.init(world)

    def look(self, belief: Belief, state: Any) -> tuple[Bool[Array, "*batch"], Any]:
        return self._planner.look(*self._own(belief, state))

    def ask(self, belief: Belief, state: Any) -> Float[Array, "h w *batch"]:
        return self._planner.ask(*self._own(belief, state))

    def conclude(self, belief: Belief, state: Any, looked: Any, ask: Ask) -> tuple[Assessment, Any]:
        own, planner_state = self._own(belief, state)
        assessment, planner_state = self._planner.conclude(own, planner_state, looked, lambda *_: ask(belief, state))
        return assessment, (own.seen, planner_state)


def leading_planners(view: View, height: int, width: int, *, seed: int) -> list[Planner]:
    """Planners whose robots explore about as well as those that will use the network, in diverse ways.

    These are frontier exploration, and DC2G with the exact cost-to-go times smooth log-normal errors of increasing
    size. They are one program, for all ranges of the view, whose widest is the field of view of the rollout.

    Args:
      view: field of view of the robots.
      height: rows of the maps.
      width: columns of the maps.
      seed: seed of the errors.
    """
    rng = np.random.default_rng([seed, view.ranges[int(view.number)]])
    errors = [noise * _smooth_noise(rng, height, width) for noise in _NOISE]
    guesses = [(np.zeros((height, width), np.float32), False), *((error, True) for error in errors)]
    return [_Leader(_Guess(jnp.asarray(error), jnp.asarray(informed)), view) for error, informed in guesses]


class Masks(NamedTuple):
    """Observation masks and their worlds.

    Attributes:
      boards: observed cells.
      world: index of each mask's world.
    """

    boards: UInt32[np.ndarray, "masks n_words h"]
    world: Int[np.ndarray, "masks"]


@struct.dataclass
class Moments:
    """Moments of one episode.

    Attributes:
      seen: board of the cells observed so far.
      exploring: whether no goal is reachable yet, so that a planner would ask for a cost-to-go.
    """

    seen: UInt32[Array, "*batch n_words h"]
    exploring: Bool[Array, "*batch"]


def moments_along(
    world: World, start: Pose, actions: Int8[Array, "t"], times: Int[Array, "k"], *, sensing: Kernel | View
) -> Moments:
    """The cells that a robot that takes `actions` from `start` has seen after `times[k]` actions.

    Path and sensor are independent: any kernel may be used along any path.

    Args:
      world: the map.
      start: first pose.
      actions: actions taken; actions beyond the largest of `times` have no effect.
      times: numbers of actions, each from 0 to `len(actions)`.
      sensing: field of view.
    """

    def look(carry: tuple[Pose, Array], action: Array) -> tuple[tuple[Pose, Array], tuple[Pose, Array]]:
        pose, seen = carry
        pose = gridworld.move(world, pose, action)
        seen = seen | sensing.visible(pose, world.opaque, world.width)
        return (pose, seen), (pose, seen)

    first = (start, sensing.visible(start, world.opaque, world.width))
    _, (poses, seen) = jax.lax.scan(look, first, actions.astype(jnp.int32))
    poses, seen = jax.tree.map(lambda one, rest: jnp.concatenate([one[None], rest])[times], first, (poses, seen))

    def out_of_reach(pose: Pose, seen: UInt32[Array, "n_words h"]) -> Bool[Array, ""]:
        robot = bitboard.single(pose.x, pose.y, *seen.shape)
        reachable = bitboard.flood(robot, world.traversable & seen)
        return ~bitboard.intersects(reachable, world.goals)

    return Moments(seen=seen, exploring=jax.vmap(out_of_reach)(poses, seen))


@functools.partial(jit, static_argnames=("mesh", "sensing"))
def _moments(
    dealt: tuple[Int[Array, "devices own"], Pose, Int8[Array, "devices own t"], Int[Array, "devices own k"]],
    worlds: World,
    view: View | None,
    *,
    mesh: Mesh,
    sensing: Kernel,
) -> Moments:
    """What was seen in episodes, from their actions, at some of their moments."""

    def own(part: tuple[Array, Pose, Array, Array], worlds: World, view: View | None) -> Moments:
        own_worlds = jax.tree.map(lambda leaf: leaf[..., part[0]], worlds)
        along = jax.vmap(functools.partial(moments_along, sensing=view or sensing), in_axes=(-1, 0, 0, 0))
        return along(own_worlds, *part[1:])

    return on_each(own, mesh, dealt, worlds, view)


def collect_masks(
    planner: PlannerLike,
    worlds: World,
    index: Int[Array, "episodes"],
    start: Pose,
    *,
    sensing: Kernel,
    per_episode: int,
    seed: int,
    view: View | None = None,
    step_limit: int = 300,
) -> Masks:
    """Run a planner and collect the observed cells of its robots at random moments without a reachable goal.

    Args:
      planner: planner of the robots.
      worlds: stack of worlds of one size.
      index: index of each episode's world, of one at least.
      start: first pose of each episode.
      sensing: field of view of the robots.
      per_episode: moments sampled from each episode; those with a reachable goal are dropped.
      seed: seed of the moments.
      view: field of view of planners which have their own, see `leading_planners`; `None` for `sensing`.
      step_limit: actions after which an episode ends.
    """
    done = rollout(planner, worlds, index, start, sensing=sensing, step_limit=step_limit)
    rng = np.random.default_rng(seed)
    times = (rng.random((len(index), per_episode)) * done.steps[:, None]).astype(np.int32)
    boards, owners, mesh = [], [], mesh_of()
    worlds = replicate(worlds, mesh)
    episodes = index, start, done.actions, times
    for first in range(0, len(index), _EPISODES_PER_CALL):
        # The last call repeats the last episode, so that all calls have the same shape.
        part = np.minimum(np.arange(first, first + _EPISODES_PER_CALL), len(index) - 1)
        some = jax.tree.map(lambda leaf, part=part: leaf[part], episodes)
        moments = gather(_moments(deal(some, len(part), mesh), worlds, view, mesh=mesh, sensing=sensing), len(part))
        keep = moments.exploring & (np.arange(first, first + len(part)) < len(index))[:, None]
        boards.append(moments.seen[keep])
        owners.append(np.broadcast_to(np.asarray(some[0])[:, None], keep.shape)[keep])
    return Masks(boards=np.concatenate(boards), world=np.concatenate(owners))


def by_house(parts: Sequence[Masks]) -> Masks:
    """Concatenate collections of masks, ordered by house.

    Raises:
      InputError: there are no masks.
    """
    if not any(len(part.world) for part in parts):
        raise InputError(
            "no mask: wherever a robot starts in these houses, it sees a front door at once, so there is nothing to "
            "learn; give larger houses, or robots that see less far"
        )
    boards, world = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(world, kind="stable")
    return Masks(boards[order], world[order])
