"""The search for a front door as an environment for learning: pure functions in the manner of gymnax and PureJaxRL.

Written for one robot; `jax.vmap` makes it many, and a whole training loop fits into one `jax.jit`:

    environment, params = front_door(houses)
    observation, state = environment.reset(key, params)
    observation, state, reward, done, info = environment.step(key, state, action, params)

An episode starts on the road of a random house (`dc2g_jax.datasets.starts.start_cells`), in a random heading. Every
action costs 1, so the return is minus the number of steps. The episode terminates when the robot stands on a front
door after an action, and is truncated at the step limit. Actions are those of `dc2g_jax.grid.poses`: 0 forward, 1 turn
left, 2 turn right. A planner never drives against an obstacle; a learner does, and the robot then stays where it is.
"""

import dataclasses
import numbers
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt8

from dc2g_jax.datasets.houses import House, stack_worlds
from dc2g_jax.datasets.starts import start_cells, why_no_episode
from dc2g_jax.errors import InputError
from dc2g_jax.grid import bitboard, gridworld
from dc2g_jax.grid.gridworld import Belief
from dc2g_jax.grid.poses import ACTION_LETTERS, HEADINGS, Pose, moved
from dc2g_jax.grid.sensing import MAX_SENSING_RANGE, Kernel, field_of_view
from dc2g_jax.grid.terrain import OUTSIDE
from dc2g_jax.grid.world import World, unpack_classes
from dc2g_jax.rollouts.rollout import NO_ACTION, STEP_LIMIT

#: Reward of every action.
STEP_REWARD = -1.0

#: Reach of the field of view in cells where nothing else is said, as in the paper.
SENSING_RANGE = 8

# A field of view grows with the square of its range; steps are counted in 32 bits.
_MAX_STEP_LIMIT = 2**31 - 1


@struct.dataclass
class Params:
    """Where episodes take place. Values, not settings: a program is compiled once for all of the same shapes.

    Attributes:
      worlds: the houses, stacked along the last axis.
      start_cells: cells that episodes may start on, house after house, as row times width plus column, int32.
      first_start: index of each house's first cell in `start_cells`, int32.
      start_count: number of each house's cells in `start_cells`, at least 1, int32.
      step_limit: actions after which an episode is truncated, int32.
    """

    worlds: World
    start_cells: Int[Array, "cells"]
    first_start: Int[Array, "houses"]
    start_count: Int[Array, "houses"]
    step_limit: Int[Array, ""]


@struct.dataclass
class Observation:
    """What the robot knows.

    Attributes:
      terrain: observed class indices (see `dc2g_jax.grid.terrain`), 0 where nothing has been observed.
      pose: where the robot is: column and row in cells, heading in quarter turns.
    """

    terrain: UInt8[Array, "h w"]
    pose: Pose


@struct.dataclass
class State:
    """An episode under way.

    Attributes:
      house: index of the house in the stack of worlds, int32.
      belief: what has been observed since the episode began, and the number of actions taken.
      episode_return: sum of the rewards since the episode began, float32.
    """

    house: Int[Array, ""]
    belief: Belief
    episode_return: Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class FrontDoor:
    """The environment. Hashable, so a static value under `jit`.

    Attributes:
      sensing: the robot's field of view.
    """

    sensing: Kernel
    num_actions: ClassVar[int] = len(ACTION_LETTERS)

    def observation_shape(self, params: Params) -> tuple[int, int]:
        """Rows and columns of an observation's terrain."""
        return params.worlds.height, params.worlds.width

    def start(self, house: Int[Array, ""], pose: Pose, params: Params) -> tuple[Observation, State]:
        """Begin an episode in a given house at a given pose.

        Args:
          house: index of the house in the stack of worlds.
          pose: first pose, on a traversable cell other than a front door.
          params: where episodes take place.
        """
        belief = gridworld.reset(_world(params, house), pose, self.sensing)
        state = State(house=house, belief=belief, episode_return=jnp.zeros((), jnp.float32))
        return observe(state), state

    def reset(self, key: PRNGKeyArray, params: Params) -> tuple[Observation, State]:
        """Begin an episode in a random house, on a random one of its start cells, in a random heading."""
        house_key, cell_key, heading_key = jax.random.split(key, 3)
        house = jax.random.randint(house_key, (), 0, len(params.start_count), jnp.int32)
        number = jax.random.randint(cell_key, (), 0, params.start_count[house], jnp.int32)
        y, x = jnp.divmod(params.start_cells[params.first_start[house] + number], params.worlds.width)
        heading = jax.random.randint(heading_key, (), 0, HEADINGS, jnp.int32)
        return self.start(house, Pose(x=x, y=y, heading=heading), params)

    def advance(
        self, state: State, action: Int[Array, ""], params: Params
    ) -> tuple[State, Float[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
        """Take one action, and leave it at that where the episode ends.

        Returns:
          State, reward, whether the robot stands on a front door (terminated), and whether it does not but
          has used up its steps (truncated).
        """
        world = _world(params, state.house)
        ahead = moved(state.belief.pose, action, world.height, world.width)
        # The robot bumps into what it cannot drive on.
        action = jnp.where(bitboard.contains(world.traversable, ahead.x, ahead.y), action, NO_ACTION)
        belief = gridworld.step(world, state.belief, action, self.sensing)
        reward = jnp.full((), STEP_REWARD, jnp.float32)
        terminated = gridworld.at_goal(world, belief.pose)
        truncated = ~terminated & (belief.steps >= params.step_limit)
        state = State(house=state.house, belief=belief, episode_return=state.episode_return + reward)
        return state, reward, terminated, truncated

    def step(
        self, key: PRNGKeyArray, state: State, action: Int[Array, ""], params: Params
    ) -> tuple[Observation, State, Float[Array, ""], Bool[Array, ""], dict[str, Any]]:
        """Take one action, and begin the next episode where it ends this one.

        Args:
          key: used where a new episode begins.
          state: the episode under way.
          action: 0 forward, 1 turn left, 2 turn right.
          params: where episodes take place.

        Returns:
          Observation and state, which are those of the new episode where one begins; reward; whether the old episode
          has ended; and more about the old one: `final_observation`, `terminated`, `truncated`, `episode_return` and
          `episode_length`, the latter two so far where it goes on.
        """
        last, reward, terminated, truncated = self.advance(state, action, params)
        done = terminated | truncated
        state = jax.tree.map(lambda new, old: jnp.where(done, new, old), self.reset(key, params)[1], last)
        info = {
            "final_observation": observe(last),
            "terminated": terminated,
            "truncated": truncated,
            "episode_return": last.episode_return,
            "episode_length": last.belief.steps,
        }
        return observe(state), state, reward, done, info


def front_door(
    houses: Sequence[House], *, sensing_range: int = SENSING_RANGE, step_limit: int = STEP_LIMIT
) -> tuple[FrontDoor, Params]:
    """The environment in a set of houses.

    Args:
      houses: where episodes take place, each as often as any other; all of one size.
      sensing_range: reach of the 90-degree field of view, in cells.
      step_limit: actions after which an episode is truncated.

    Raises:
      InputError: there is no house, no episode can be run in one of them (leave out those for which `why_no_episode`
        gives a reason), they differ in size, or a number is out of bounds.
    """
    if not houses:
        raise InputError("houses: there are none; give at least one")
    for house in houses:
        if reason := why_no_episode(house):
            raise InputError(f"house {house.name}: no episode can be run in it: {reason}; leave it out")
    cells = [np.flatnonzero(start_cells(house.terrain)) for house in houses]
    counts = np.array([len(own) for own in cells])
    params = Params(
        worlds=stack_worlds(houses),
        start_cells=jnp.asarray(np.concatenate(cells), jnp.int32),
        first_start=jnp.asarray(np.cumsum(counts) - counts, jnp.int32),
        start_count=jnp.asarray(counts, jnp.int32),
        step_limit=jnp.int32(whole_number("step_limit", step_limit, 1, _MAX_STEP_LIMIT)),
    )
    sensing = field_of_view(whole_number("sensing_range", sensing_range, 1, MAX_SENSING_RANGE))
    return FrontDoor(sensing), params


def whole_number(name: str, value: object, low: int, high: int | None = None) -> int:
    """A number of the user's within bounds, or an InputError that names it."""
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not whole or int(value) < low or (high is not None and int(value) > high):  # type: ignore[call-overload]
        bounds = f"of at least {low}" if high is None else f"from {low} to {high}"
        raise InputError(f"{name} is {value!r}; give a whole number {bounds}")
    return int(value)  # type: ignore[call-overload]


def observe(state: State) -> Observation:
    """What the robot knows."""
    belief = state.belief
    # Every word is read for 32 cells. XLA would work it out anew for each of them, but not so a reduction, which makes
    # a step four times faster where the final observation is used.
    classes = jnp.bitwise_or.reduce(jnp.stack([belief.classes, jnp.zeros_like(belief.classes)]))
    return Observation(terrain=unpack_classes(classes, belief.width), pose=belief.pose)


def egocentric(observation: Observation, radius: int) -> UInt8[Array, "side side"]:
    """An observation as the robot sees it: itself in the middle, ahead is up, left is left.

    Args:
      observation: what the robot knows.
      radius: cells shown in each direction, of which the square has 2 `radius` + 1 a side.

    Returns:
      Class indices, 0 where nothing has been observed, `dc2g_jax.grid.terrain.OUTSIDE` beyond the map.
    """
    side = 2 * radius + 1
    framed = jnp.pad(observation.terrain, radius, constant_values=OUTSIDE)
    square = jax.lax.dynamic_slice(framed, (observation.pose.y, observation.pose.x), (side, side))
    # Heading 0 looks to the right of the map: a quarter turn counterclockwise turns that up.
    return jax.lax.select_n(observation.pose.heading, *(jnp.rot90(square, turns) for turns in (1, 2, 3, 0)))


def _world(params: Params, house: Int[Array, ""]) -> World:
    """One house of the stack."""
    return jax.tree.map(lambda leaf: leaf.at[..., house].get(mode="promise_in_bounds"), params.worlds)
