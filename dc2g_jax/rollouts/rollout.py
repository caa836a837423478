"""Many episodes at once: a queue of episodes served by a fixed number of slots, each holding one robot.

As soon as a robot has finished, its slot takes the next episode of the queue, so the batch stays full and no time is
spent on finished robots while others walk on. On a CPU every core serves a queue of its own. What an episode gives does
not depend on the slot, the order or the core.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int, Int8

from dc2g_jax.grid import gridworld
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.sensing import Kernel
from dc2g_jax.grid.world import World
from dc2g_jax.planning.planners import EXPLORE, GAVE_UP, Planner
from dc2g_jax.programs import jit
from dc2g_jax.rollouts.devices import ONE_CORE, Report, every_device, serve_paced, share_out

#: Step limit of an episode in the published results.
STEP_LIMIT = 500

#: Planner steps taken on the device by the first call that takes any.
_FIRST_STEPS = 16

#: The action recorded after the end of an episode.
NO_ACTION = -1

#: Robots side by side on an accelerator.
_ACCELERATOR_SLOTS = 16384

#: Words of a board of 100 x 100 cells: the boards of many robots on larger maps do not stay in a core's caches.
_LARGEST_CACHED_BOARD = 400


@struct.dataclass
class Episodes:
    """What to run.

    Attributes:
      world: index of each episode's world in the stack of worlds, int32.
      start: first pose of each episode.
    """

    world: Int[Array, "episodes"]
    start: Pose

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.world)


@struct.dataclass
class Trajectories:
    """What came of it, in the order of the episodes.

    Attributes:
      actions: actions taken, then `NO_ACTION`, int8; no columns where they were not to be kept.
      steps: number of actions taken.
      success: did the robot stand on a goal cell at the end?
      mode: plan mode of the last decision; see `dc2g_jax.planning.planners`.
    """

    actions: Int8[np.ndarray, "episodes kept_steps"]
    steps: Int[np.ndarray, "episodes"]
    success: Bool[np.ndarray, "episodes"]
    mode: Int[np.ndarray, "episodes"]


@struct.dataclass
class _Queue:
    """Episodes waiting to be served, padded to a length that many numbers of episodes share.

    Attributes:
      worlds: the worlds.
      planner_states: the planner's first state in each of them.
      episodes: the episodes, and padding.
      length: how many are not padding.
    """

    worlds: World
    planner_states: Any
    episodes: Episodes
    length: Int[Array, ""]


@struct.dataclass
class _Slots:
    """The robots under way: one episode a slot, slots on the last axis.

    Attributes:
      episode: whose robot it is.
      active: does it have an episode? An idle slot's world is empty, so that nothing is searched in it.
      finished: has the episode just ended?
      success: did it end on a goal?
      mode: mode of the last plan.
      world: where the robot is.
      belief: what it knows.
      planner_state: what its planner keeps.
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
class _Results:
    """Results so far, a row an episode of the padded queue."""

    actions: Int8[Array, "rows kept_steps"]
    steps: Int[Array, "rows"]
    success: Bool[Array, "rows"]
    mode: Int[Array, "rows"]


@struct.dataclass
class _State:
    """All that changes: the robots, the results, and how many episodes have been seated."""

    slots: _Slots
    results: _Results
    seated: Int[Array, ""]


def _take(tree: Any, index: Array) -> Any:
    """The members of a batch with these indices."""
    return jax.tree.map(lambda leaf: leaf.at[..., index].get(mode="clip"), tree)


def _robots(queue: _Queue, turn: Int[Array, "slots"], sensing: Kernel) -> _Slots:
    """Robots at the start of the episodes with these places in the queue; idle ones beyond its end."""
    active = turn < queue.length
    world_index = queue.episodes.world.at[turn].get(mode="clip")
    world = _take(queue.worlds, world_index)
    world = jax.tree.map(lambda leaf: jnp.where(active, leaf, jnp.uint32(0)), world)
    return _Slots(
        episode=jnp.where(active, turn, len(queue.episodes)),
        active=active,
        finished=jnp.zeros_like(active),
        success=jnp.zeros_like(active),
        mode=jnp.full_like(turn, EXPLORE),
        world=world,
        belief=gridworld.reset(world, _take(queue.episodes.start, turn), sensing),
        planner_state=_take(queue.planner_states, world_index),
    )


def _seat(state: _State, vacant: Bool[Array, "slots"], queue: _Queue, sensing: Kernel) -> _State:
    """Give every vacant slot the next episode of the queue; those left over fall idle."""
    new = _robots(queue, state.seated + jnp.cumsum(vacant.astype(jnp.int32)) - 1, sensing)
    return dataclasses.replace(
        state,
        slots=jax.tree.map(lambda fresh, kept: jnp.where(vacant, fresh, kept), new, state.slots),
        seated=state.seated + jnp.sum(vacant & new.active, dtype=jnp.int32),
    )


def _advance(state: _State, planner: Planner, sensing: Kernel, step_limit: int) -> _State:
    """One plan-act-observe cycle of every robot."""
    slots, results = state.slots, state.results
    plan, planner_state = planner.plan(slots.belief, slots.planner_state)
    acts = slots.active & (plan.mode != GAVE_UP)
    belief = gridworld.step(slots.world, slots.belief, plan.action, sensing)
    belief = dataclasses.replace(belief, steps=slots.belief.steps + acts)
    success = acts & gridworld.at_goal(slots.world, belief.pose)
    # Robots that do not act write beyond the last row, which drops the write.
    row = jnp.where(acts, slots.episode, results.actions.shape[0])
    action = plan.action.astype(jnp.int8)
    slots = dataclasses.replace(
        slots,
        finished=slots.active & (success | ~acts | (belief.steps >= step_limit)),
        success=success,
        mode=plan.mode,
        belief=belief,
        planner_state=planner_state,
    )
    actions = results.actions.at[row, slots.belief.steps - 1].set(action, mode="drop")
    return dataclasses.replace(state, slots=slots, results=dataclasses.replace(results, actions=actions))


def _record(state: _State) -> _State:
    """Note how the finished episodes ended."""
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


def _run(
    state: _State, n_steps: Int[Array, ""], queue: _Queue, planner: Planner, *, sensing: Kernel, step_limit: int
) -> _State:
    """At most `n_steps` planner steps of every slot, refilled from the queue as robots finish."""

    def until_one_finishes(carry: tuple[_State, Array]) -> tuple[_State, Array]:
        def go_on(carry: tuple[_State, Array]) -> Bool[Array, ""]:
            return (carry[1] < n_steps) & ~jnp.any(carry[0].slots.finished)

        def cycle(carry: tuple[_State, Array]) -> tuple[_State, Array]:
            return _advance(carry[0], planner, sensing, step_limit), carry[1] + 1

        state, cycles = jax.lax.while_loop(go_on, cycle, carry)
        return _seat(_record(state), state.slots.finished, queue, sensing), cycles

    def go_on(carry: tuple[_State, Array]) -> Bool[Array, ""]:
        return (carry[1] < n_steps) & jnp.any(carry[0].slots.active)

    return jax.lax.while_loop(go_on, until_one_finishes, (state, jnp.int32(0)))[0]


def _finished(state: _State) -> Int[Array, ""]:
    """How many episodes have ended."""
    return state.seated - jnp.sum(state.slots.active)


def _first_state(
    planner: Planner, worlds: World, episodes: Episodes, length: Int[Array, ""],
    *, sensing: Kernel, n_slots: int, kept_steps: int,
) -> tuple[_Queue, _State]:  # fmt: skip
    """The queue, and the slots with its first episodes seated."""
    queue = _Queue(worlds=worlds, planner_states=planner.init(worlds), episodes=episodes, length=length)
    rows = len(episodes)
    results = _Results(
        actions=jnp.full((rows, kept_steps), NO_ACTION, jnp.int8),
        steps=jnp.zeros(rows, jnp.int32),
        success=jnp.zeros(rows, bool),
        mode=jnp.full(rows, EXPLORE, jnp.int32),
    )
    slots = _robots(queue, jnp.arange(n_slots, dtype=jnp.int32), sensing)
    return queue, _State(slots, results, seated=jnp.sum(slots.active, dtype=jnp.int32))


@functools.cache
def _programs(platform: str) -> tuple[Callable[..., tuple[_Queue, _State]], Callable[..., _State]]:
    """`_first_state` and `_run`, compiled for a kind of device."""
    options = ONE_CORE if platform == "cpu" else {}
    return (
        jit(_first_state, static_argnames=("sensing", "n_slots", "kept_steps"), compiler_options=options),
        jit(_run, static_argnames=("sensing", "step_limit"), donate_argnames=("state",), compiler_options=options),
    )


def _default_slots(planner: Planner, worlds: World, platform: str) -> int:
    """As many robots side by side as suit a device."""
    if platform != "cpu":
        return _ACCELERATOR_SLOTS
    n_words, height = worlds.goals.shape[:2]
    cached = n_words * height <= _LARGEST_CACHED_BOARD
    return planner.robots_a_core if cached else planner.robots_on_large_maps


def rollout(
    planner: Planner,
    worlds: World,
    episodes: Episodes,
    *,
    sensing: Kernel,
    step_limit: int = STEP_LIMIT,
    slots: int | None = None,
    devices: Sequence[jax.Device] | None = None,
    keep_actions: bool = True,
    on_progress: Callable[[int], None] | None = None,
) -> Trajectories:
    """Run every episode to its end: the goal, giving up, or the step limit.

    Args:
      planner: decides the actions.
      worlds: stack of worlds of one size, along the last axis.
      episodes: world index and first pose of each episode.
      sensing: the robots' field of view.
      step_limit: actions after which an episode ends without success.
      slots: robots simulated side by side on each device; `None` for as many as suit it.
      devices: where to run; a device that is named twice serves two queues at once, which makes use of two cores of a
        CPU. `None` for every accelerator, or every core.
      keep_actions: keep the actions? They take a byte an episode and step.
      on_progress: called now and then with the number of episodes finished so far.

    Returns:
      Results in the order of the episodes, as NumPy arrays.
    """
    kept_steps = step_limit if keep_actions else 0
    n_episodes = len(episodes)
    if n_episodes == 0:
        empty = np.zeros(0, np.int32)
        return Trajectories(np.zeros((0, kept_steps), np.int8), empty, empty.astype(bool), empty)
    devices = every_device() if devices is None else devices
    devices = devices[:n_episodes]
    # One shape, and so one compiled program, for all numbers of episodes up to the next power of two.
    capacity = 1 << (-(-n_episodes // len(devices)) - 1).bit_length()
    if slots is None:
        slots = _default_slots(planner, worlds, devices[0].platform)
    slots = min(slots, capacity)
    first_state, run = _programs(devices[0].platform)

    def serve(device: jax.Device, own: Int[np.ndarray, "own"], report: Report) -> _Results:
        """Run some of the episodes on one device."""
        some = jax.tree.map(lambda leaf: np.asarray(leaf)[np.resize(own, capacity)], episodes)
        own_planner, own_worlds, some = jax.device_put((planner, worlds, some), device)
        queue, state = first_state(
            own_planner, own_worlds, some, jnp.int32(len(own)), sensing=sensing, n_slots=slots, kept_steps=kept_steps
        )
        go_on = functools.partial(run, queue=queue, planner=own_planner, sensing=sensing, step_limit=step_limit)
        state = serve_paced(state, go_on, _finished, len(own), report, first_steps=_FIRST_STEPS)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(own)], state.results)

    return Trajectories(*jax.tree.leaves(share_out(n_episodes, devices, serve, on_progress)))
