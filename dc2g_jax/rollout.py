"""Many episodes at once: a queue of episodes served by a fixed number of slots, each holding one robot.

As soon as a robot has finished, its slot takes the next episode of the queue, so the batch stays full and no time is
spent on finished robots while others walk on. What an episode gives does not depend on the slot or the order.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Int, Int8

from dc2g_jax import gridworld
from dc2g_jax.grid.poses import Pose
from dc2g_jax.grid.sensing import Kernel
from dc2g_jax.grid.world import World
from dc2g_jax.gridworld import Belief
from dc2g_jax.planning.planners import EXPLORE, GAVE_UP, Planner

#: Step limit of an episode in the published results.
STEP_LIMIT = 500

#: Planner steps taken on the device between two looks at the progress.
_STEPS_PER_CALL = 64

#: The action recorded after the end of an episode.
NO_ACTION = -1


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
      actions: actions taken, then `NO_ACTION`, int8.
      steps: number of actions taken.
      success: did the robot stand on a goal cell at the end?
      mode: plan mode of the last decision; see `dc2g_jax.planning.planners`.
    """

    actions: Int8[np.ndarray, "episodes step_limit"]
    steps: Int[np.ndarray, "episodes"]
    success: Bool[np.ndarray, "episodes"]
    mode: Int[np.ndarray, "episodes"]


@struct.dataclass
class _Slots:
    """The robots under way: one episode a slot."""

    episode: Int[Array, "slots"]
    active: Bool[Array, "slots"]
    world: World
    belief: Belief
    planner_state: Any


@struct.dataclass
class _Results:
    """Results so far. One row more than there are episodes takes what idle slots write."""

    actions: Int8[Array, "rows step_limit"]
    steps: Int[Array, "rows"]
    success: Bool[Array, "rows"]
    mode: Int[Array, "rows"]


def _take(tree: Any, index: Array) -> Any:
    return jax.tree.map(lambda leaf: leaf[index], tree)


def _select(mask: Bool[Array, "slots"], new: Any, old: Any) -> Any:
    """Per slot the new value where the mask says so."""

    def choose(n: Array, o: Array) -> Array:
        return jnp.where(mask.reshape(mask.shape + (1,) * (n.ndim - 1)), n, o)

    return jax.tree.map(choose, new, old)


def _seat(
    slots: _Slots, vacant: Bool[Array, "slots"], first_waiting: Array, episodes: Episodes, worlds: World,
    planner_states: Any, sensing: Kernel,
) -> tuple[_Slots, Array]:  # fmt: skip
    """Give every vacant slot the next episode of the queue; those left over fall idle."""
    n_episodes = len(episodes)
    turn = first_waiting + jnp.cumsum(vacant.astype(jnp.int32)) - 1
    seated = vacant & (turn < n_episodes)
    episode = jnp.where(seated, turn, n_episodes)
    queue_index = jnp.minimum(episode, n_episodes - 1)
    world_index = episodes.world[queue_index]
    world = _take(worlds, world_index)
    belief = jax.vmap(functools.partial(gridworld.reset, sensing=sensing))(world, _take(episodes.start, queue_index))
    # An idle robot knows nothing, so its searches end before they begin.
    idle = vacant & ~seated
    belief = _select(~idle, belief, jax.tree.map(jnp.zeros_like, belief))
    new = _Slots(
        episode=episode,
        active=seated,
        world=world,
        belief=belief,
        planner_state=_take(planner_states, world_index),
    )
    return _select(vacant, new, slots), first_waiting + jnp.sum(seated, dtype=jnp.int32)


def _advance(
    slots: _Slots, results: _Results, planner: Planner, sensing: Kernel, step_limit: int
) -> tuple[_Slots, _Results, Bool[Array, "slots"]]:
    """One plan-act-observe cycle of every robot. Also returns which robots have just finished."""
    plan, planner_state = jax.vmap(planner.plan)(slots.belief, slots.planner_state)
    acts = slots.active & (plan.mode != GAVE_UP)
    stepped = jax.vmap(functools.partial(gridworld.step, sensing=sensing))(slots.world, slots.belief, plan.action)
    belief = _select(acts, stepped, slots.belief)
    success = acts & jax.vmap(gridworld.at_goal)(slots.world, belief.pose)
    finished = slots.active & (success | (plan.mode == GAVE_UP) | (belief.steps >= step_limit))
    # Robots that did not act write out of bounds, which drops the write.
    row = jnp.where(acts, slots.episode, results.actions.shape[0])
    written = _Results(
        actions=results.actions.at[row, slots.belief.steps].set(plan.action.astype(jnp.int8), mode="drop"),
        steps=results.steps.at[slots.episode].set(belief.steps),
        success=results.success.at[slots.episode].set(success),
        mode=results.mode.at[slots.episode].set(plan.mode),
    )
    updated = _Slots(
        episode=slots.episode,
        active=slots.active,
        world=slots.world,
        belief=belief,
        planner_state=planner_state,
    )
    return updated, written, finished


@functools.partial(jax.jit, static_argnames=("sensing", "step_limit"), donate_argnames=("slots", "results"))
def _run(
    planner: Planner, worlds: World, episodes: Episodes, planner_states: Any, slots: _Slots, results: _Results,
    first_waiting: Array, *, sensing: Kernel, step_limit: int,
) -> tuple[_Slots, _Results, Array]:  # fmt: skip
    """At most `_STEPS_PER_CALL` planner steps of every slot, refilled from the queue as robots finish."""

    def cycle(carry: tuple[_Slots, _Results, Array, Array]) -> tuple[_Slots, _Results, Array, Array]:
        slots, results, first_waiting, cycles = carry
        slots, results, finished = _advance(slots, results, planner, sensing, step_limit)
        slots, first_waiting = jax.lax.cond(
            jnp.any(finished),
            lambda: _seat(slots, finished, first_waiting, episodes, worlds, planner_states, sensing),
            lambda: (slots, first_waiting),
        )
        return slots, results, first_waiting, cycles + 1

    def go_on(carry: tuple[_Slots, _Results, Array, Array]) -> Bool[Array, ""]:
        return jnp.any(carry[0].active) & (carry[3] < _STEPS_PER_CALL)

    return jax.lax.while_loop(go_on, cycle, (slots, results, first_waiting, jnp.int32(0)))[:3]


@functools.partial(jax.jit, static_argnames=("sensing", "n_slots"))
def _first_slots(
    planner: Planner, worlds: World, episodes: Episodes, *, sensing: Kernel, n_slots: int
) -> tuple[Any, _Slots, Array]:
    """Planner states of every world, and the slots with the first episodes seated."""
    planner_states = jax.vmap(planner.init)(worlds)
    nobody = jnp.zeros(n_slots, jnp.int32)
    world = _take(worlds, nobody)
    start = _take(episodes.start, nobody)
    empty = _Slots(
        episode=nobody,
        active=jnp.zeros(n_slots, bool),
        world=world,
        belief=jax.vmap(functools.partial(gridworld.reset, sensing=sensing))(world, start),
        planner_state=_take(planner_states, nobody),
    )
    everyone = jnp.ones(n_slots, bool)
    slots, first_waiting = _seat(empty, everyone, jnp.int32(0), episodes, worlds, planner_states, sensing)
    return planner_states, slots, first_waiting


def rollout(
    planner: Planner,
    worlds: World,
    episodes: Episodes,
    *,
    sensing: Kernel,
    step_limit: int = STEP_LIMIT,
    slots: int = 128,
    on_progress: Callable[[int], None] | None = None,
) -> Trajectories:
    """Run every episode to its end: the goal, giving up, or the step limit.

    Args:
      planner: decides the actions.
      worlds: stack of worlds of one size.
      episodes: world index and first pose of each episode.
      sensing: the robots' field of view.
      step_limit: actions after which an episode ends without success.
      slots: robots simulated side by side.
      on_progress: called now and then with the number of episodes finished so far.

    Returns:
      Results in the order of the episodes, as NumPy arrays.
    """
    n_episodes = len(episodes)
    if n_episodes == 0:
        empty = np.zeros(0, np.int32)
        return Trajectories(np.zeros((0, step_limit), np.int8), empty, empty.astype(bool), empty)
    slots = min(slots, n_episodes)
    planner_states, state, first_waiting = _first_slots(planner, worlds, episodes, sensing=sensing, n_slots=slots)
    rows = n_episodes + 1
    results = _Results(
        actions=jnp.full((rows, step_limit), NO_ACTION, jnp.int8),
        steps=jnp.zeros(rows, jnp.int32),
        success=jnp.zeros(rows, bool),
        mode=jnp.full(rows, EXPLORE, jnp.int32),
    )
    while True:
        state, results, first_waiting = _run(
            planner, worlds, episodes, planner_states, state, results, first_waiting,
            sensing=sensing, step_limit=step_limit,
        )  # fmt: skip
        under_way = int(jnp.sum(state.active))
        if on_progress is not None:
            on_progress(int(first_waiting) - under_way)
        if under_way == 0:
            break
    return Trajectories(*(np.asarray(leaf)[:n_episodes] for leaf in jax.tree.leaves(results)))
