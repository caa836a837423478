"""Checks that planners and estimators keep to their protocols, run on a few small built-in worlds."""

import functools
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from dc2g_jax._src.estimation.estimators import Estimator, trait
from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.gridworld import Belief, belief_from_map
from dc2g_jax._src.grid.ground import connected_to_goal
from dc2g_jax._src.grid.poses import ACTION_LETTERS, HEADINGS, Pose, every_heading, make_pose
from dc2g_jax._src.grid.sensing import Kernel, field_of_view
from dc2g_jax._src.grid.terrain import DRIVEWAY, FRONT_DOOR, GRASS, HOUSE, PATH, ROAD, SIDEWALK, UNKNOWN
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, MODE_NAMES, Plan, Planner, PlannerLike, sensing_of
from dc2g_jax._src.rollouts.results import action_letters
from dc2g_jax._src.rollouts.rollout import STEP_LIMIT, rollout
from dc2g_jax._src.runtime.errors import InputError, short
from dc2g_jax._src.runtime.programs import jit

#: Range of the field of view in cells, for planners without rules.
_SENSING_RANGE = 5

#: First poses in each world: column, row, heading.
_STARTS = ((2, 7, 0), (20, 7, 2), (5, 11, 1))

#: Slots of the batch, fewer than episodes: robots also start while others are under way.
_SLOTS = 4

#: Decisions of each robot that are made twice.
_MADE_TWICE = 4

#: Largest relative and absolute difference of two estimates that count as equal.
_ROUNDING = 1e-3

#: Values that can be leaves of a planner or an estimator.
_ARRAYS = (jax.Array, np.ndarray, np.generic, int, float)


def _robots() -> tuple[World, Int[np.ndarray, "episodes"], Pose]:
    """Worlds, and the index of the world and the first pose of episodes in each of them.

    A street with a house and a side street, its mirror image, where robots start on the mirrored columns, and the
    street with the door walled in.
    """
    street = np.full((12, 40), GRASS, np.uint8)
    street[6], street[7], street[8:, 5] = SIDEWALK, ROAD, DRIVEWAY
    street[1, 32:38], street[2:6, 35] = HOUSE, PATH
    street[1, 35] = FRONT_DOOR
    shut = street.copy()
    shut[2, 35] = HOUSE
    maps = np.stack([street, street[:, ::-1], shut], axis=-1)
    width, n_worlds = maps.shape[1:]
    x, y, heading = np.tile(np.array(_STARTS).T, n_worlds)
    world = np.repeat(np.arange(n_worlds, dtype=np.int32), len(_STARTS))
    x = np.where(world == 1, width - 1 - x, x)
    return World.from_terrain(maps), world, make_pose(x, y, heading)


def _one(tree: Any, index: Any) -> Any:
    return jax.tree.map(lambda leaf: leaf[..., index], tree)


# --- structure, shapes and dtypes ---------------------------------------------------------------------


def _check_tree(kind: str, tested: Any, *methods: str) -> str:
    """Check that a planner or an estimator has its methods and can be an argument of compiled programs; its name."""
    who = f"{kind} {(tested if isinstance(tested, type) else type(tested)).__name__}"
    if isinstance(tested, type):
        raise InputError(f"{who}: is a class; expected an instance of it, such as {tested.__name__}(...)")
    for method in methods:
        if not callable(getattr(tested, method, None)):
            raise InputError(f"{who}: has no method {method}; expected the methods {' and '.join(methods)}")
    for path, leaf in jax.tree_util.tree_leaves_with_path(tested):
        if leaf is tested:
            raise InputError(f"{who}: is no pytree; expected a class decorated with flax.struct.dataclass")
        if not isinstance(leaf, _ARRAYS):
            raise InputError(
                f"{who}: {_name(path)} is {short(leaf)}; expected an array, or a static field: "
                "struct.field(pytree_node=False)"
            )
    return who


def _name(path: tuple[Any, ...]) -> str:
    """The name of a leaf, such as `.rules`; of a tree that is a leaf itself, `the value`."""
    return jax.tree_util.keystr(path) or "the value"


def _traced(who: str, method: str, of: str, tested: Any, *arguments: Any) -> Any:
    """Types of what a method returns, without computing it, checked to be all that it does."""

    def call(tested: Any, *arguments: Any) -> Any:
        before: Any = jax.tree.flatten((tested, arguments))
        answer = getattr(tested, method)(*arguments)
        after: Any = jax.tree.flatten((tested, arguments))
        if before[1] != after[1] or any(one is not other for one, other in zip(before[0], after[0], strict=True)):
            raise InputError(f"{who}: {method} changes its arguments or itself; expected a pure function")
        return answer

    try:
        return jax.eval_shape(call, tested, *arguments)
    except InputError:
        raise
    except Exception as error:
        first_line = str(error).partition("\n")[0]
        branches = isinstance(error, jax.errors.TracerBoolConversionError)
        remedy = "; use jnp.where or jax.lax.cond instead of if, and, or" if branches else ""
        raise InputError(f"{who}: {method} for {of} raises {type(error).__name__}: {first_line}{remedy}") from error


def _types(tree: Any, weak: bool = False) -> dict[str, str]:
    """Name -> dtype and shape of every leaf; with `weak`, also whether its dtype is weak."""
    return {
        _name(path): f"{leaf.dtype}{list(leaf.shape)}{' (weakly typed)' if weak and leaf.weak_type else ''}"
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree)
    }


def _expect(who: str, what: str, expected: dict[str, str], found: dict[str, str]) -> None:
    for name in expected | found:
        wanted, got = expected.get(name, "no such value"), found.get(name, "missing")
        if wanted != got:
            raise InputError(f"{who}: {what}, {name} is {got}; expected {wanted}")


def _check_states(who: str, tested: Any, world: World, worlds: World) -> tuple[Any, Any]:
    """Types of the first state of one robot and of a batch, checked to have the batch axis last."""
    one, many = (_traced(who, "init", of, tested, given) for of, given in (("one robot", world), ("a batch", worlds)))
    count = worlds.goals.shape[-1]
    expected = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*leaf.shape, count), leaf.dtype), one)
    _expect(who, "state of a batch", _types(expected), _types(many))
    return one, many


def _check_plan(who: str, of: str, planner: PlannerLike, belief: Belief, state: Any) -> None:
    """Check types of the plan and of the state after it, for one robot or a batch."""
    answer = _traced(who, "plan", of, planner, belief, state)
    if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], Plan)):
        raise InputError(f"{who}: plan returns {short(type(answer).__name__)}; expected a tuple of a Plan and a state")
    number = belief.pose.x
    expected = Plan(number, number, number, subgoals=jax.eval_shape(every_heading, belief.seen))
    _expect(who, f"plan of {of}", _types(expected), _types(answer[0]))
    _expect(who, f"state of {of} after a step", _types(state, weak=True), _types(answer[1], weak=True))
    structures: list[Any] = [jax.tree.structure(one) for one in (state, answer[1])]
    if structures[0] != structures[1]:
        raise InputError(f"{who}: the state of {of} has another structure after a step; expected that of init")


# --- planners -----------------------------------------------------------------------------------------


def _differing(one: Any, other: Any) -> str | None:
    """The name of the first leaf that differs in some bit."""

    def bits(leaf: Array) -> bytes:
        keys = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if keys else leaf).tobytes()

    leaves = zip(jax.tree_util.tree_leaves_with_path(one), jax.tree.leaves(other), strict=True)
    return next((_name(path) for (path, leaf), again in leaves if bits(leaf) != bits(again)), None)


class _Alone:
    """Runs episodes of one robot without a batch, and checks every decision."""

    def __init__(self, who: str, planner: PlannerLike, sensing: Kernel):
        self._who, self._planner = who, planner

        def stepped(world: World, belief: Belief, action: Array) -> tuple[Belief, Array, Array]:
            """The next belief, whether something was revealed, and whether the robot is at a goal."""
            after = gridworld.step(world, belief, action, sensing)
            return after, jnp.any(after.seen != belief.seen), gridworld.at_goal(world, after.pose)

        # Two programs: the second is traced anew.
        self._decide, self._decide_again = (
            jit(lambda planner, belief, state: planner.plan(belief, state)) for _ in range(2)
        )
        self._init = jit(lambda planner, world: planner.init(world))
        self._reset = jit(lambda world, pose: gridworld.reset(world, pose, sensing))
        self._step = jit(stepped)

    def actions(self, place: str, world: World, start: Pose, ground: int) -> str:
        """The actions of an episode as letters. No shortest plan has more actions than poses on the `ground`."""
        belief, state = self._reset(world, start), self._init(self._planner, world)
        letters, unrevealing, patience = "", 0, HEADINGS * ground
        while len(letters) < STEP_LIMIT:
            where = f"{place}, decision {len(letters) + 1}"
            before = self._planner, belief, state
            plan, state = self._decide(*before)
            if len(letters) < _MADE_TWICE:
                different = _differing((plan, state), self._decide_again(*before))
                if different is not None:
                    raise InputError(
                        f"{self._who}: {where}: {different} differs between two calls with the same inputs; expected "
                        "a pure function, with random keys in its state"
                    )
            action, mode = int(plan.action), int(plan.mode)
            if not 0 <= mode < len(MODE_NAMES):
                raise InputError(f"{self._who}: {where}: mode is {mode}; expected 0 to {len(MODE_NAMES) - 1}")
            if mode == GAVE_UP:
                return letters
            if not 0 <= action < len(ACTION_LETTERS):
                raise InputError(f"{self._who}: {where}: action is {action}; expected 0 to {len(ACTION_LETTERS) - 1}")
            belief, reveals, at_goal = self._step(world, belief, plan.action)
            letters += ACTION_LETTERS[action]
            if at_goal:
                return letters
            unrevealing = 0 if reveals or mode != EXPLORE else unrevealing + 1
            if unrevealing > patience:
                raise InputError(
                    f"{self._who}: {where}: the last {unrevealing} actions explored and revealed nothing; expected "
                    f"something new within {patience}, or giving up"
                )
        raise InputError(
            f"{self._who}: {place} has not ended after {STEP_LIMIT} actions (mode {MODE_NAMES[mode]}); expected a goal "
            "or giving up"
        )


def check_planner(planner: PlannerLike) -> None:
    """Check that a planner keeps to the protocol `Planner`, on a few small built-in worlds.

    ```
    dc2g_jax.check_planner(MyPlanner(dc2g_jax.SETTINGS["paper"].rules()))
    ```

    It checks, in this order:

    - The planner is a pytree of arrays and static fields, with its methods.
    - Its estimator, if it has one: see `check_estimator`.
    - Plans and states have the shapes and dtypes of the protocol, with batch axes last. A state keeps structure,
      shapes and dtypes (weak ones too) from step to step, so nothing is compiled again.
    - `init` and `plan` are pure: they change no input, and the same inputs give the same outputs, to the bit.
    - Modes and actions exist.
    - Every episode ends at a goal or by giving up, within 500 actions. Exploration reveals something at least once in
      as many actions as the ground has poses.
    - In a batch, every robot acts as alone.

    Frontier exploration by the authors' published rules does not pass: between two poses that reveal nothing it can
    turn back and forth without an end. All shipped planners pass with the paper's rules.

    Args:
      planner: the planner. Robots have the field of view of its `rules`; of 5 cells if it has none.

    Raises:
      InputError: the first of these that does not hold, with what was expected and what was found.
    """
    who = _check_tree("planner", planner, "init", "plan")
    batch = getattr(planner, "batch_per_core", Planner.batch_per_core)
    if not (isinstance(batch, int) and batch > 0):
        raise InputError(f"{who}: batch_per_core is {short(batch)}; expected a number of robots, 1 or more")
    if getattr(planner, "estimator", None) is not None:
        check_estimator(planner.estimator)
    sensing = sensing_of(planner) if hasattr(planner, "rules") else field_of_view(_SENSING_RANGE)
    worlds, index, starts = _robots()
    robots_worlds = _one(worlds, index)
    one_world, one_start = _one((robots_worlds, starts), 0)
    states = _check_states(who, planner, one_world, robots_worlds)
    many = f"a batch of {len(index)}"
    for of, world, start, state in (
        ("one robot", one_world, one_start, states[0]),
        (many, robots_worlds, starts, states[1]),
    ):
        belief = jax.eval_shape(lambda world, start: gridworld.reset(world, start, sensing), world, start)
        _check_plan(who, of, planner, belief, state)

    alone = _Alone(who, planner, sensing)
    ground = bitboard.count(worlds.traversable).tolist()
    acted = []
    for number, place in enumerate(index.tolist()):
        world, start = _one(worlds, place), _one(starts, number)
        acted.append(alone.actions(f"episode {number}", world, start, ground[place]))
    done = rollout(planner, worlds, index, starts, sensing=sensing, slots=_SLOTS, devices=jax.local_devices()[:1])
    for number, letters in enumerate(acted):
        in_batch = action_letters(done, number)
        if letters != in_batch:
            pairs = enumerate(itertools.zip_longest(letters, in_batch, fillvalue="none"), start=1)
            decision, (expected, found) = next(pair for pair in pairs if pair[1][0] != pair[1][1])
            raise InputError(
                f"{who}: episode {number}, decision {decision}: in {many} the robot's action is {found}; expected "
                f"{expected}, as alone"
            )


# --- estimators ---------------------------------------------------------------------------------------


def check_estimator(estimator: Estimator) -> None:
    """Check that an estimator keeps to the protocol `Estimator`, on a few small built-in worlds.

    ```
    dc2g_jax.check_estimator(MyEstimator())
    ```

    It checks, in this order:

    - The estimator is a pytree of arrays and static fields, with its methods.
    - Estimates are floating-point numbers of the shape `[outcomes h w *batch]`, with one outcome at least. States have
      their batch axes last.
    - `init` and `estimate` are pure: they change no input, and the same inputs give the same estimates.
    - No estimate is NaN, and none is infinite where the robot has seen ground that leads to a goal.
    - In a batch, every estimate is as alone.

    Estimates count as equal up to rounding. Maps are what robots see first, and whole maps.

    Args:
      estimator: the estimator.

    Raises:
      InputError: the first of these that does not hold, with what was expected and what was found.
    """
    who = _check_tree("estimator", estimator, "init", "estimate")
    worlds, index, starts = _robots()
    worlds, count = _one(worlds, index), len(index)
    states = _check_states(who, estimator, _one(worlds, 0), worlds)
    state = jit(lambda estimator, worlds: estimator.init(worlds))(estimator, worlds)
    # Two programs: the second is traced anew.
    estimate, again = (jit(lambda estimator, *arguments: estimator.estimate(*arguments)) for _ in range(2))
    equal = functools.partial(np.allclose, rtol=_ROUNDING, atol=_ROUNDING, equal_nan=True)
    first_views = gridworld.reset(worlds, starts, field_of_view(_SENSING_RANGE))
    for view, belief in (("first view", first_views), ("whole map", belief_from_map(worlds.terrain, starts))):
        terrain = trait(estimator, "extent").part(belief.terrain, belief.pose)
        for of, part, kept in (("one map", _one(terrain, 0), states[0]), (f"{count} maps", terrain, states[1])):
            answer = _traced(who, "estimate", of, estimator, part, kept)
            if not jnp.issubdtype(answer.dtype, jnp.floating) or answer.shape[1:] != part.shape or not answer.shape[0]:
                expected = ", ".join(map(str, ("outcomes", *part.shape)))
                raise InputError(
                    f"{who}: the estimate of {of} is {answer.dtype}{list(answer.shape)}; expected floating-point "
                    f"numbers [{expected}], with one outcome at least"
                )
        costs = np.asarray(estimate(estimator, terrain, state))
        if not equal(costs, np.asarray(again(estimator, terrain, state))):
            raise InputError(f"{who}: estimates of the {view} differ between two calls with the same inputs")
        _check_numbers(who, view, estimator, costs, belief, worlds)
        for number in range(count):
            alone = np.asarray(estimate(estimator, *_one((terrain, state), number)))
            if not equal(costs[..., number], alone):
                raise InputError(
                    f"{who}: {view} of episode {number}: in a batch of {count} the estimate differs by "
                    f"{np.nanmax(np.abs(costs[..., number] - alone)):.3g}; expected that of the map alone"
                )


def _check_numbers(who: str, view: str, estimator: Estimator, costs: np.ndarray, belief: Belief, worlds: World) -> None:
    """Check that no estimate is NaN, and none infinite on observed ground that leads to a goal."""
    terrain = np.asarray(belief.terrain)
    leads = np.stack([connected_to_goal(whole) for whole in np.moveaxis(np.asarray(worlds.terrain), -1, 0)], axis=-1)
    on_ground = jnp.asarray(np.where(leads, terrain, np.uint8(UNKNOWN)))
    needed = np.asarray(trait(estimator, "extent").part(on_ground, belief.pose)) != UNKNOWN
    wrong = np.isnan(costs) | (np.isinf(costs) & needed)
    if wrong.any():
        outcome, y, x, episode = np.argwhere(wrong)[0]
        raise InputError(
            f"{who}: {view} of episode {episode}: the estimate of cell ({x}, {y}), outcome {outcome}, is "
            f"{costs[outcome, y, x, episode]}; expected a finite number"
        )
