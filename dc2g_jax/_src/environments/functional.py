"""The search for a front door as a JAX environment: pure functions with the interface of gymnax 1.0.

Functions take one robot; use `jax.vmap` for batches. A whole training loop fits into one `jax.jit`:

    environment, params = front_door(houses)
    observation, state = environment.reset(key, params)
    observation, state, reward, terminated, truncated, info = environment.step(key, state, action, params)

An episode starts on the road of a random house (`readers.starts.start_cells`), in a random heading. Every
action costs 1, so the return is minus the number of steps. The episode terminates when the robot stands on a front
door after an action, and is truncated at the step limit. Actions are those of `grid.poses`: 0 forward, 1 turn
left, 2 turn right. A robot that drives against an obstacle stays in place. Any other action does nothing;
`jax.experimental.checkify.checkify(..., errors=checkify.index_checks)` reports it as an error.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt8

from dc2g_jax._src.environments import spaces
from dc2g_jax._src.grid import gridworld, sensing
from dc2g_jax._src.grid.gridworld import Belief
from dc2g_jax._src.grid.poses import ACTION_LETTERS, FORWARD, HEADINGS, Pose
from dc2g_jax._src.grid.sensing import PAPER_DEGREES, Kernel, check_degrees, check_sensing_range
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_RGB, OUTSIDE
from dc2g_jax._src.grid.world import World
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset, stack_worlds
from dc2g_jax._src.readers.starts import start_cells, usable_houses, why_no_episode
from dc2g_jax._src.rollouts.rollout import NO_ACTION, STEP_LIMIT
from dc2g_jax._src.runtime.errors import InputError, check_name, check_number

#: Reward of every action.
_STEP_REWARD = -1.0

#: Default range of the field of view in cells, as in the paper.
SENSING_RANGE = 8

#: Steps are counted in signed 32-bit integers.
_MAX_STEP_LIMIT = 2**31 - 1


@struct.dataclass(eq=False)
class Params:
    """Parameters of the environment. They are traced: programs are compiled once for all parameters of equal shapes.

    Compared by identity, so that an environment that holds them is hashable.

    Attributes:
      worlds: the houses, stacked along the last axis.
      start_cells: start cells of episodes, house after house, as row times width plus column, int32.
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
    """The robot's observation.

    Attributes:
      terrain: observed class indices (see `grid.terrain`), 0 for unobserved cells.
      pose: pose of the robot: column and row in cells, heading in quarter turns.
    """

    terrain: UInt8[Array, "h w"]
    pose: Pose


@struct.dataclass
class State:
    """State of an episode.

    Attributes:
      house: index of the house in the stack of worlds, int32.
      belief: what has been observed since the episode began, and the number of actions taken.
      episode_return: sum of the rewards since the episode began, float32.
    """

    house: Int[Array, "*batch"]
    belief: Belief
    episode_return: Float[Array, "*batch"]


@dataclasses.dataclass(frozen=True)
class FrontDoor:
    """The environment: search for a front door of a random house on the paper's gridworld.

    Observation, action, reward and end of an episode are described in the module's documentation. Hashable, so it can
    be a static argument of `jit`.

    Attributes:
      sensing: the robot's field of view.
      default_params: the parameters that `reset` and `step` use if none are given.
      autoreset: whether `step` begins a new episode where one ends.
    """

    sensing: Kernel
    default_params: Params | None = dataclasses.field(default=None, repr=False)
    autoreset: bool = dataclasses.field(default=True, repr=False)
    name: ClassVar[str] = "FrontDoor-v0"
    num_actions: ClassVar[int] = len(ACTION_LETTERS)

    def action_space(self, params: Params | None = None) -> spaces.Discrete:
        """The actions, which are the same for all parameters."""
        del params
        return spaces.Discrete(self.num_actions)

    def observation_space(self, params: Params | None = None) -> spaces.Dict:
        """The observations: `terrain`, whose shape is that of the houses, and `pose`."""
        worlds = self._or_default(params).worlds
        terrain = spaces.Box(0, len(CLASS_NAMES) - 1, (worlds.height, worlds.width), jnp.uint8)
        bounds = {"x": worlds.width, "y": worlds.height, "heading": HEADINGS}
        pose = spaces.Dict({name: spaces.Discrete(bound) for name, bound in bounds.items()}, Pose)
        return spaces.Dict({"terrain": terrain, "pose": pose}, Observation)

    def start(self, house: Int[Array, ""], pose: Pose, params: Params) -> tuple[Observation, State]:
        """Begin an episode in a given house at a given pose.

        Args:
          house: index of the house in the stack of worlds.
          pose: first pose, on a traversable cell other than a front door.
          params: parameters of the environment.
        """
        belief = gridworld.reset(_world(params, house), pose, self.sensing)
        state = State(house=house, belief=belief, episode_return=jnp.zeros((), jnp.float32))
        return observe(state), state

    def reset(self, key: PRNGKeyArray, params: Params | None = None) -> tuple[Observation, State]:
        """Begin an episode in a random house, on a random start cell, in a random heading."""
        params = self._or_default(params)
        house_key, cell_key, heading_key = jax.random.split(key, 3)
        house = jax.random.randint(house_key, (), 0, len(params.start_count), jnp.int32)
        number = jax.random.randint(cell_key, (), 0, params.start_count[house], jnp.int32)
        y, x = jnp.divmod(params.start_cells[params.first_start[house] + number], params.worlds.width)
        heading = jax.random.randint(heading_key, (), 0, HEADINGS, jnp.int32)
        return self.start(house, Pose(x=x, y=y, heading=heading), params)

    def advance(
        self, state: State, action: int | Int[Array, "*batch"], params: Params
    ) -> tuple[State, Float[Array, "*batch"], Bool[Array, "*batch"], Bool[Array, "*batch"]]:
        """Take one action of one robot or of a batch, without a reset at the end of an episode.

        Returns:
          State; reward; `terminated`, whether the robot stands on a front door; and `truncated`, whether it does not
          and has reached the step limit.
        """
        # Unknown actions do nothing, and `checkify` sees that their index is out of bounds.
        known = jnp.arange(self.num_actions, dtype=jnp.int32).at[action]
        action = known.get(mode="fill", fill_value=NO_ACTION, wrap_negative_indices=False)
        world = _world(params, state.house)
        belief = gridworld.step(world, state.belief, action, self.sensing)
        reward = jnp.full(action.shape, _STEP_REWARD, jnp.float32)
        terminated = gridworld.at_goal(world, belief.pose)
        truncated = ~terminated & (belief.steps >= params.step_limit)
        state = State(house=state.house, belief=belief, episode_return=state.episode_return + reward)
        return state, reward, terminated, truncated

    def step(
        self, key: PRNGKeyArray, state: State, action: int | Int[Array, ""], params: Params | None = None
    ) -> tuple[Observation, State, Float[Array, ""], Bool[Array, ""], Bool[Array, ""], dict[str, Any]]:
        """Take one action. With `autoreset`, begin a new episode if it ends the current one.

        Args:
          key: random key of the new episode.
          state: state of the current episode.
          action: 0 forward, 1 turn left, 2 turn right.
          params: parameters of the environment.

        Returns:
          Observation and state, those of the new episode if one begins; reward; `terminated` and `truncated`, see
          `advance`; and information about the current episode: `final_observation`, `terminated`, `truncated`,
          `episode_return` and `episode_length`. The last two count the episode so far if it continues.
        """
        params = self._or_default(params)
        last, reward, terminated, truncated = self.advance(state, action, params)
        state = last
        if self.autoreset:
            done = terminated | truncated
            state = jax.tree.map(lambda new, old: jnp.where(done, new, old), self.reset(key, params)[1], last)
        info = {
            "final_observation": observe(last),
            "terminated": terminated,
            "truncated": truncated,
            "episode_return": last.episode_return,
            "episode_length": last.belief.steps,
        }
        return observe(state), state, reward, terminated, truncated, info

    def _or_default(self, params: Params | None) -> Params:
        params = self.default_params if params is None else params
        if params is None:
            raise InputError("no params are given, and the environment has no default_params; give those of front_door")
        return params


def front_door(
    houses: Sequence[House],
    *,
    sensing_range: int = SENSING_RANGE,
    field_of_view: float = PAPER_DEGREES,
    step_limit: int = STEP_LIMIT,
    autoreset: bool = True,
) -> tuple[FrontDoor, Params]:
    """The environment, and its parameters for a set of houses.

    Args:
      houses: houses of equal size; each is drawn with equal probability.
      sensing_range: range of the field of view, in cells.
      field_of_view: width of the field of view in degrees, 1 to 360.
      step_limit: actions after which an episode is truncated.
      autoreset: whether `step` begins a new episode where one ends; otherwise the robot stays in the old one.

    Raises:
      InputError: there are no houses, no episode can be run in one of them (leave out those for which `why_no_episode`
        gives a reason), their sizes differ, or a number is out of bounds.
    """
    check_sensing_range("sensing_range", sensing_range)
    check_degrees("field of view", field_of_view)
    check_number("step_limit", step_limit, whole=True, least=1, most=_MAX_STEP_LIMIT)
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
        step_limit=jnp.int32(step_limit),
    )
    return FrontDoor(sensing.field_of_view(int(sensing_range), field_of_view), params, autoreset), params


def make_env(
    name: str = FrontDoor.name,
    *,
    dataset: str | os.PathLike[str] | HouseDataset | None = None,
    split: str = "train",
    sensing_range: int = SENSING_RANGE,
    field_of_view: float = PAPER_DEGREES,
    step_limit: int = STEP_LIMIT,
    autoreset: bool = True,
    cells: int = 50,
) -> tuple[FrontDoor, Params]:
    """Make a functional environment and its parameters, as `gymnax.make` does.

    ```
    env, params = dc2g_jax.make_env("FrontDoor-v0", dataset="procedural")
    observation, state = env.reset(key, params)
    observation, state, reward, terminated, truncated, info = env.step(key, state, action, params)
    ```

    Args:
      name: `FrontDoor-v0`.
      dataset: folder of houses, the word `procedural`, or an open dataset; `None` for the published houses, see
        `readers.houses.open_dataset`.
      split: `train`, `val` or `test`. Houses in which no episode can be run are left out.
      sensing_range: range of the field of view, in cells.
      field_of_view: width of the field of view in degrees, 1 to 360.
      step_limit: actions after which an episode is truncated.
      autoreset: whether `step` begins a new episode where one ends.
      cells: side length of the square maps, if `dataset` is not open yet.

    Raises:
      InputError: an option or the dataset is invalid.
    """
    check_name("environment", name, [FrontDoor.name])
    dataset = dataset if isinstance(dataset, HouseDataset) else open_dataset(dataset, cells=cells)
    houses = usable_houses(dataset, split, instead="raise cells or use another split")
    return front_door(
        houses, sensing_range=sensing_range, field_of_view=field_of_view, step_limit=step_limit, autoreset=autoreset
    )


def observe(state: State) -> Observation:
    """The observation in a state."""
    belief = state.belief
    # Each word holds 32 cells. XLA would recompute a word for each of them, but it does not recompute a reduction. This
    # makes a step four times faster if the final observation is used.
    classes = jnp.bitwise_or.reduce(jnp.stack([belief.classes, jnp.zeros_like(belief.classes)]))
    return Observation(terrain=dataclasses.replace(belief, classes=classes).terrain, pose=belief.pose)


def egocentric(observation: Observation, radius: int) -> UInt8[Array, "side side"]:
    """The egocentric view of an observation: the robot in the middle, looking up.

    Args:
      observation: observation of the robot.
      radius: cells shown in each direction; the square has sides of 2 `radius` + 1 cells.

    Returns:
      Class indices, 0 for unobserved cells, `grid.terrain.OUTSIDE` beyond the map.
    """
    side = 2 * radius + 1
    framed = jnp.pad(observation.terrain, radius, constant_values=OUTSIDE)
    square = jax.lax.dynamic_slice(framed, (observation.pose.y, observation.pose.x), (side, side))
    # Heading 0 points to the right of the map; a quarter turn counterclockwise makes it point up.
    return jax.lax.select_n(observation.pose.heading, *(jnp.rot90(square, turns) for turns in (1, 2, 3, 0)))


def one_hot_view(observation: Observation, radius: int) -> Float[Array, "class side side"]:
    """The egocentric view (see `egocentric`) as one plane of ones and zeros per class, the last for `OUTSIDE`."""
    return jax.nn.one_hot(egocentric(observation, radius), OUTSIDE + 1, axis=0)


def image(observation: Observation, pixels: int = 8, length: float = 1.0) -> UInt8[Array, "height width 3"]:
    """A picture of an observation: classes in the colors of the figures, and the robot as a black triangle.

    Pure, so `jax.vmap` draws a batch.

    Args:
      observation: observation of the robot.
      pixels: side length of a cell.
      length: length of the triangle, in cells.

    Raises:
      InputError: `pixels` is not a positive whole number.
    """
    check_number("pixels", pixels, whole=True, least=1)
    cells = jnp.asarray(FIGURE_RGB)[observation.terrain]
    picture = jnp.repeat(jnp.repeat(cells, pixels, axis=0), pixels, axis=1)
    pose, forward = observation.pose, jnp.asarray(FORWARD)[observation.pose.heading]
    y, x = ((jnp.arange(side) + 0.5) / pixels - 0.5 for side in picture.shape[:2])
    x, y = (x - pose.x) / length, (y[:, None] - pose.y) / length
    ahead, aside = forward[0] * x + forward[1] * y, forward[0] * y - forward[1] * x
    robot = (jnp.abs(ahead) < 0.5) & (2 * jnp.abs(aside) < 0.5 - ahead)
    return jnp.where(robot[..., None], jnp.uint8(0), picture)


def _world(params: Params, house: Int[Array, "*batch"]) -> World:
    return jax.tree.map(lambda leaf: leaf.at[..., house].get(mode="promise_in_bounds"), params.worlds)
