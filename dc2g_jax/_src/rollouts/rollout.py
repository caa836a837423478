"""Rollouts of many episodes: a queue of episodes served by a fixed number of slots, each with one robot.

When a robot finishes, its slot takes the next episode of the queue. So the batch stays full, and no time is spent on
finished robots. Every device serves its own queue. Results do not depend on the slot, the order or the device.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.sharding import Mesh
from jaxtyping import Array, Bool, Int, Int8

from dc2g_jax._src.grid import bitboard, gridworld
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import Pose
from dc2g_jax._src.grid.sensing import Kernel
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.planning.planners import EXPLORE, GAVE_UP, Plan, Planner, PlannerLike, asks, sensing_of
from dc2g_jax._src.runtime.devices import deal, dealt_counts, gather, mesh_of, on_each, platform, replicate, serve_paced
from dc2g_jax._src.runtime.programs import ONE_OPERATION_OPTIONS, jit, one_operation

#: Step limit of an episode in the published results.
STEP_LIMIT = 500

#: Planner steps of the first call on the device.
_FIRST_STEPS = 16

#: Decisions of a robot before it is the next one's turn, if it does not ask.
_DECISIONS_PER_TURN = 32

#: The action recorded after the end of an episode.
NO_ACTION = -1

#: Least length of a queue.
_LEAST_CAPACITY = 512

#: Words of one board of each of an accelerator's robots, in all: those of 65,536 robots on maps of 50 x 50 cells.
_ACCELERATOR_WORDS = 65536 * 100

#: Share of an accelerator's slots that are refilled together. Refilling takes as long as a step there, so slots wait.
_REFILLED_TOGETHER = 1 / 32


@struct.dataclass
class Trajectories:
    """Results of a rollout, in the order of the episodes.

    Attributes:
      actions: actions, then `NO_ACTION`, int8; no columns if actions were not kept.
      steps: number of actions.
      success: whether the robot stood on a goal cell at the end.
      mode: plan mode of the last decision; see `planning.planners`.
    """

    actions: Int8[np.ndarray, "episodes kept_steps"]
    steps: Int[np.ndarray, "episodes"]
    success: Bool[np.ndarray, "episodes"]
    mode: Int[np.ndarray, "episodes"]


@struct.dataclass
class _Queue:
    """Waiting episodes, padded to a length shared by many numbers of episodes.

    Attributes:
      worlds: the worlds.
      planner_states: first state of the planner in each world.
      index: index of each episode's world, followed by padding.
      start: first pose of each episode.
      length: number of episodes without padding.
    """

    worlds: World
    planner_states: Any
    index: Int[Array, "rows"]
    start: Pose
    length: Int[Array, ""]


@struct.dataclass
class _Slots:
    """The active robots: one episode per slot, with slots on the last axis.

    Attributes:
      episode: index of the slot's episode.
      active: whether the slot has an episode. The world of an idle slot is empty, so no search runs in it.
      finished: whether the episode has ended and its results are not stored yet.
      success: whether it ended on a goal.
      mode: mode of the last plan.
      world: world of the robot.
      belief: belief of the robot.
      planner_state: state of its planner.
    """

    episode: Int[Array, "slots"]
    active: Bool[Array, "slots"]
    finished: Bool[Array, "slots"]
    success: Bool[Array, "slots"]
    mode: Int[Array, "slots"]
    world: World
    belief: Belief
    planner_state: Any


@struct.dataclass
class _State:
    """The state of a rollout: the robots, the results, and the number of episodes that were started.

    The results are `Trajectories` with a row for each episode of the padded queue. Actions that are not kept are
    `None`: on several CPU devices, jax 0.11 crashes on arrays without elements.
    """

    slots: _Slots
    results: Any
    seated: Int[Array, ""]


def _take(tree: Any, index: Array) -> Any:
    """The members of a batch with these indices."""
    return jax.tree.map(lambda leaf: leaf.at[..., index].get(mode="clip"), tree)


def _robots(queue: _Queue, turn: Int[Array, "slots"], sensing: Kernel) -> _Slots:
    """Robots at the start of the episodes at these indices of the queue; idle ones beyond its end."""
    active = turn < queue.length
    world_index = queue.index.at[turn].get(mode="clip")
    world = _take(queue.worlds, world_index)
    world = jax.tree.map(lambda leaf: jnp.where(active, leaf, jnp.uint32(0)), world)
    return _Slots(
        episode=jnp.where(active, turn, len(queue.index)),
        active=active,
        finished=jnp.zeros_like(active),
        success=jnp.zeros_like(active),
        mode=jnp.full_like(turn, EXPLORE),
        world=world,
        belief=gridworld.reset(world, _take(queue.start, turn), sensing),
        planner_state=_take(queue.planner_states, world_index),
    )


def _seat(state: _State, vacant: Bool[Array, "slots"], queue: _Queue, sensing: Kernel) -> _State:
    """Start the next episode of the queue in every vacant slot; slots beyond its end become idle."""
    new = _robots(queue, state.seated + jnp.cumsum(vacant.astype(jnp.int32)) - 1, sensing)
    return dataclasses.replace(
        state,
        slots=jax.tree.map(lambda fresh, kept: jnp.where(vacant, fresh, kept), new, state.slots),
        seated=state.seated + jnp.sum(vacant & new.active, dtype=jnp.int32),
    )


def _advance(
    state: _State, decide: Callable[[Belief, Any], tuple[Plan, Any]], sensing: Kernel, step_limit: int
) -> _State:
    """One plan-act-observe cycle of every robot."""
    slots, results = state.slots, state.results
    plan, planner_state = decide(slots.belief, slots.planner_state)
    goes_on = slots.active & ~slots.finished
    acts = goes_on & (plan.mode != GAVE_UP)
    belief = gridworld.step(slots.world, slots.belief, plan.action, sensing)
    belief = dataclasses.replace(belief, steps=slots.belief.steps + acts)
    arrives = acts & gridworld.at_goal(slots.world, belief.pose)
    if results.actions is not None:
        # Robots that do not act write out of bounds, so the write is dropped.
        row = jnp.where(acts, slots.episode, len(results.steps))
        kept = results.actions.at[row, slots.belief.steps].set(plan.action.astype(jnp.int8), mode="drop")
        results = dataclasses.replace(results, actions=kept)
    slots = dataclasses.replace(
        slots,
        finished=slots.finished | goes_on & (arrives | ~acts | (belief.steps >= step_limit)),
        success=slots.success | arrives,
        mode=jnp.where(goes_on, plan.mode, slots.mode),
        belief=belief,
        planner_state=planner_state,
    )
    return dataclasses.replace(state, slots=slots, results=results)


def _record(state: _State) -> _State:
    slots, results = state.slots, state.results
    row = jnp.where(slots.finished, slots.episode, len(results.steps))
    return dataclasses.replace(
        state,
        results=dataclasses.replace(
            results,
            steps=results.steps.at[row].set(slots.belief.steps, mode="drop"),
            success=results.success.at[row].set(slots.success, mode="drop"),
            mode=results.mode.at[row].set(slots.mode, mode="drop"),
        ),
    )


def _until_each_asks(planner: PlannerLike, mesh: Mesh) -> bool:
    """Whether robots run one after another, with robots on the first axis of the slots: see `_alone`."""
    return platform(mesh) == "cpu" and asks(planner)


def _alone(
    state: _State, n_steps: Int[Array, ""], queue: _Queue, planner: PlannerLike, sensing: Kernel, step_limit: int
) -> _State:
    """Run robots one after another, each until it asks the estimator, then ask for all of them.

    Args:
      state: robots on the first axis of the slots, each a batch of one.
      n_steps: number of times the estimator is asked at most.
      queue: the waiting episodes.
      planner: the planner.
      sensing: field of view of the robots.
      step_limit: actions after which an episode ends.
    """

    def look(state: _State) -> tuple[Bool[Array, "1"], Any]:
        return planner.look(state.slots.belief, state.slots.planner_state)

    def go_on(state: _State, looked: Any, answer: Any) -> tuple[_State, Any]:
        """One robot, until it asks again or its turn ends."""

        def goes_on(carry: tuple[_State, Any, Array]) -> Bool[Array, ""]:
            state, (asks, _), taken = carry
            return (state.slots.active & ((taken == 0) | ~asks & (taken < _DECISIONS_PER_TURN)))[0]

        def cycle(carry: tuple[_State, Any, Array]) -> tuple[_State, Any, Array]:
            state, looked, taken = carry

            def decide(belief: Belief, planner_state: Any) -> tuple[Plan, Any]:
                assessment, planner_state = planner.conclude(belief, planner_state, looked, lambda *_: answer)
                return assessment.plan, planner_state

            state = _advance(state, decide, sensing, step_limit)
            finished = state.slots.finished
            state = jax.lax.cond(finished[0], lambda: _seat(_record(state), finished, queue, sensing), lambda: state)
            return state, look(state), taken + 1

        return jax.lax.while_loop(goes_on, cycle, (state, looked, jnp.int32(0)))[:2]

    def every_turn(state: _State, looked: Any, answers: Any) -> tuple[_State, Any]:
        def turn(index: Array, carry: tuple[_State, Any]) -> tuple[_State, Any]:
            everyone = carry[0].slots, carry[1]
            slots, looked, answer = jax.tree.map(lambda leaf: leaf[index], (*everyone, answers))
            state, looked = go_on(dataclasses.replace(carry[0], slots=slots), looked, answer)
            slots, looked = jax.tree.map(lambda leaf, own: leaf.at[index].set(own), everyone, (state.slots, looked))
            return dataclasses.replace(state, slots=slots), looked

        return jax.lax.fori_loop(0, len(state.slots.active), turn, (state, looked))

    def ask_and_go_on(carry: tuple[_State, Any, Array]) -> tuple[_State, Any, Array]:
        state, looked, asked = carry
        belief, planner_state = jax.tree.map(
            lambda leaf: jnp.moveaxis(leaf[..., 0], 0, -1), (state.slots.belief, state.slots.planner_state)
        )
        answers = planner.ask(belief, planner_state)
        answers = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0)[..., None], answers)
        return *one_operation(every_turn, state, looked, answers), asked + 1

    def unfinished(carry: tuple[_State, Any, Array]) -> Bool[Array, ""]:
        return (carry[2] < n_steps) & jnp.any(carry[0].slots.active)

    looked = jax.lax.map(lambda slots: look(dataclasses.replace(state, slots=slots)), state.slots)
    return jax.lax.while_loop(unfinished, ask_and_go_on, (state, looked, jnp.int32(0)))[0]


@functools.partial(
    jit,
    static_argnames=("mesh", "sensing", "step_limit"),
    donate_argnames=("states",),
    compiler_options=ONE_OPERATION_OPTIONS,
)
def _run(
    states: _State, n_steps: Int[Array, ""], queues: _Queue, planner: PlannerLike,
    *, mesh: Mesh, sensing: Kernel, step_limit: int,
) -> tuple[_State, Int[Array, "devices"]]:  # fmt: skip
    """Take at most `n_steps` planner steps in every slot of every device, and refill slots as robots finish.

    Returns:
      The state, and the number of finished episodes on each device.
    """

    def run(state: _State, queue: _Queue, n_steps: Int[Array, ""], planner: PlannerLike) -> _State:
        def few_finished(slots: _Slots) -> Bool[Array, ""]:
            if platform(mesh) == "cpu":
                return ~jnp.any(slots.finished)
            enough = max(1, int(slots.finished.size * _REFILLED_TOGETHER))
            return jnp.sum(slots.finished) < jnp.minimum(enough, jnp.sum(slots.active))

        def until_some_finish(carry: tuple[_State, Array]) -> tuple[_State, Array]:
            def go_on(carry: tuple[_State, Array]) -> Bool[Array, ""]:
                return (carry[1] < n_steps) & few_finished(carry[0].slots)

            def cycle(carry: tuple[_State, Array]) -> tuple[_State, Array]:
                return _advance(carry[0], planner.plan, sensing, step_limit), carry[1] + 1

            state, cycles = jax.lax.while_loop(go_on, cycle, carry)
            return _seat(_record(state), state.slots.finished, queue, sensing), cycles

        def go_on(carry: tuple[_State, Array]) -> Bool[Array, ""]:
            return (carry[1] < n_steps) & jnp.any(carry[0].slots.active)

        return jax.lax.while_loop(go_on, until_some_finish, (state, jnp.int32(0)))[0]

    def own(dealt: tuple[_State, _Queue], n_steps: Int[Array, ""], planner: PlannerLike) -> _State:
        if _until_each_asks(planner, mesh):
            return _alone(dealt[0], n_steps, dealt[1], planner, sensing, step_limit)
        return one_operation(run, *dealt, n_steps, planner)

    states = on_each(own, mesh, (states, queues), n_steps, planner)
    return states, states.seated - jnp.sum(states.slots.active.reshape(mesh.size, -1), axis=-1)


@functools.partial(jit, static_argnames=("mesh", "sensing", "n_slots", "kept_steps"))
def _first_states(
    planner: PlannerLike, worlds: World, index: Int[Array, "devices rows"], start: Pose, lengths: Int[Array, "devices"],
    *, mesh: Mesh, sensing: Kernel, n_slots: int, kept_steps: int | None,
) -> tuple[_Queue, _State]:  # fmt: skip
    """The queue of each device, and its slots with the first episodes."""

    def first(own: tuple[Array, Pose, Array], planner: PlannerLike, worlds: World) -> tuple[_Queue, _State]:
        queue = _Queue(worlds, planner.init(worlds), *own)
        rows = len(queue.index)
        actions = None if kept_steps is None else jnp.full((rows, kept_steps), NO_ACTION, jnp.int8)
        begun: list[Any] = [jnp.zeros(rows, jnp.int32), jnp.zeros(rows, bool), jnp.full(rows, EXPLORE, jnp.int32)]
        results: Any = Trajectories(actions, *begun)  # type: ignore[arg-type]
        turns = jnp.arange(n_slots, dtype=jnp.int32)
        if _until_each_asks(planner, mesh):
            slots = jax.lax.map(lambda turn: _robots(queue, turn, sensing), turns[:, None])
        else:
            slots = _robots(queue, turns, sensing)
        return queue, _State(slots, results, seated=jnp.sum(slots.active, dtype=jnp.int32))

    return on_each(first, mesh, (index, start, lengths), planner, worlds)


def _default_slots(planner: PlannerLike, worlds: World, platform: str) -> int:
    if platform != "cpu":
        n_words, height = worlds.goals.shape[:2]
        return max(1, 1 << (_ACCELERATOR_WORDS // (n_words * height)).bit_length() >> 1)
    return getattr(planner, "batch_per_core", Planner.batch_per_core)


def rollout(
    planner: PlannerLike,
    worlds: World,
    index: Int[Array | np.ndarray, "episodes"],
    start: Pose,
    *,
    sensing: Kernel | None = None,
    step_limit: int = STEP_LIMIT,
    slots: int | None = None,
    devices: Sequence[jax.Device] | None = None,
    keep_actions: bool = True,
    on_progress: Callable[[int], None] | None = None,
) -> Trajectories:
    """Run every episode to its end: the goal, giving up, or the step limit.

    Args:
      planner: planner of the robots.
      worlds: stack of worlds of one size, along the last axis.
      index: index of each episode's world in the stack, int32.
      start: first pose of each episode. Poses are not checked, and no goal need be in reach; `datasets.check_starts`
        checks starts in houses, and `rollouts.episodes_from` makes arrays of them.
      sensing: field of view of the robots; `None` for that of the planner's rules. Planners without rules need one.
      step_limit: actions after which an episode ends without success.
      slots: number of robots simulated side by side on each device; `None` for the default of the device.
      devices: devices to run on; `None` for all, see `runtime.devices.use_devices`.
      keep_actions: whether to keep the actions, one byte per episode and step.
      on_progress: called between calls of the device with the number of finished episodes.

    Returns:
      Results in the order of the episodes, as NumPy arrays.

    Raises:
      InputError: `worlds` is no such stack, or the field of view is missing or not that of the planner's rules.
    """
    words = bitboard.word_count(worlds.width)
    gridworld.check_axes("goals of the stacked worlds", worlds.goals.shape, words, "h", "worlds")
    sensing = sensing_of(planner, sensing)
    n_episodes = len(index)
    if n_episodes == 0:
        empty = np.zeros(0, np.int32)
        return Trajectories(np.zeros((0, step_limit if keep_actions else 0), np.int8), empty, empty.astype(bool), empty)
    mesh = mesh_of(devices)
    # Rounding up to a power of two lets many numbers of episodes share a compiled program.
    capacity = max(_LEAST_CAPACITY, 1 << (-(-n_episodes // mesh.size) - 1).bit_length())
    if slots is None:
        slots = _default_slots(planner, worlds, platform(mesh))
    slots = min(slots, capacity)
    planner, worlds = replicate((planner, worlds), mesh)
    queues, states = _first_states(
        planner, worlds, *deal((index, start), n_episodes, mesh, capacity), dealt_counts(n_episodes, mesh), mesh=mesh,
        sensing=sensing, n_slots=slots, kept_steps=step_limit if keep_actions else None,
    )  # fmt: skip
    go_on = functools.partial(_run, queues=queues, planner=planner, mesh=mesh, sensing=sensing, step_limit=step_limit)
    states = serve_paced(states, go_on, n_episodes, on_progress, first_steps=_FIRST_STEPS)
    done: Trajectories = gather(states.results, n_episodes)
    return done if keep_actions else dataclasses.replace(done, actions=np.zeros((n_episodes, 0), np.int8))
