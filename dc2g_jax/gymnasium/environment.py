"""The search for a front door as Gymnasium environments: a single one, and a vectorized one in one compiled call.

    import dc2g_jax.gymnasium  # registers the environments

    gymnasium.make("dc2g_jax/FrontDoor-v0", dataset="procedural", split="train")
    gymnasium.make_vec("dc2g_jax/FrontDoor-v0", num_envs=256, vectorization_mode="vector_entry_point")

Both wrap `dc2g_jax.environments.FrontDoor` and take the same options. They need the extra `gym`.

An observation is a dictionary: `terrain`, uint8 [h w], holds the class index of every observed cell (see
`dc2g_jax.grid.CLASS_NAMES`) and 0 elsewhere; `pose`, int32 [3], is column, row and heading (0 = +x, 1 = +y, 2 = -x,
3 = -y; y grows downward). Actions: 0 forward one cell, 1 turn left, 2 turn right. The reward of every action is -1.
"""

import functools
import os
import sys
from collections.abc import Mapping
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space, iterate
from jaxtyping import Array, Float, Int, UInt8

from dc2g_jax.datasets import HouseDataset, Start, check_starts, open_dataset, usable_houses, why_no_episode
from dc2g_jax.environments import FrontDoor, Observation, Params, State, image, make_env
from dc2g_jax.grid import CLASS_NAMES, HEADINGS, Pose, make_pose
from dc2g_jax.runtime import InputError, check_name, check_number, jit

#: Sizes in pixels: the longer side of a picture (about), the side of a cell and the length of the robot (at least).
_PICTURE, _CELL, _ROBOT = 400, 4, 18

#: The process that imported this module, and with it JAX.
_IMPORTED_BY = os.getpid()

_START = ("house", "x", "y", "heading")
_ACTIONS = "give 0 (forward), 1 (turn left) or 2 (turn right)"


class FrontDoorVectorEnv(gymnasium.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """The vectorized search for a front door: many robots in separate episodes, stepped by one compiled call.

    Robot `i` has the same episodes as a `FrontDoorEnv` with seed `seed + i`. When an episode ends, the next begins in
    the same step (`AutoresetMode.SAME_STEP`): the observation is the first of the new episode, and the last of the old
    episode is `final_obs` in the infos.

    Args:
      num_envs: number of robots.
      render_mode: see `FrontDoorEnv`.
      dataset: see `dc2g_jax.make_env`, like the rest.
      split: split of the houses.
      cells: side length of the square maps.
      **options: `sensing_range`, `field_of_view` and `step_limit`.

    Raises:
      InputError: an option or the dataset is invalid.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10, "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int,
        *,
        render_mode: str | None = None,
        dataset: str | os.PathLike[str] | HouseDataset | None = None,
        split: str = "train",
        cells: int = 50,
        **options: Any,
    ):
        _leave_forks()
        check_number("num_envs", num_envs, whole=True, least=1)
        if render_mode is not None:
            check_name("render_mode", render_mode, self.metadata["render_modes"], "or None")
        self.num_envs, self.render_mode, self._split = num_envs, render_mode, split
        self._dataset = dataset if isinstance(dataset, HouseDataset) else open_dataset(dataset, cells=cells)
        environment, self._params = make_env(dataset=self._dataset, split=split, **options)
        # Without default parameters, so that equal sensing shares programs.
        autoreset = self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        self._environment = FrontDoor(environment.sensing, autoreset=autoreset)
        self._houses = np.array([house.name for house in usable_houses(self._dataset, split)], object)
        width, height = self._params.worlds.width, self._params.worlds.height
        self.single_observation_space = spaces.Dict(
            {
                "terrain": spaces.Box(0, len(CLASS_NAMES) - 1, (height, width), np.uint8),
                "pose": spaces.MultiDiscrete([width, height, HEADINGS], dtype=np.int32),
            }
        )
        self.single_action_space = spaces.Discrete(FrontDoor.num_actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._keys: Array | None = None
        self._observations: Observation | None = None
        self._states: State | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode of every robot.

        Args:
          seed: robot `i` gets the seed `seed + i`; `None` continues the current series of episodes.
          options: `None` or empty, or starts: `house`, `x`, `y` and `heading`, each one value for all or one per robot.

        Returns:
          Observations, and infos with the houses' names as `house`.

        Raises:
          InputError: an episode cannot start there.
        """
        super().reset(seed=seed)
        if seed is None and self._keys is None:
            seed = int(self.np_random.integers(2**31))
        if seed is not None:
            seeds = [seeding.np_random(seed + robot)[0].integers(2**31) for robot in range(self.num_envs)]
            self._keys = jax.vmap(jax.random.key)(np.array(seeds, np.int32))
        if options:
            self._observations, self._states = _start(*self._starts(options), self._params, self._environment)
        else:
            self._keys, self._observations, self._states = _reset(self._keys, self._params, self._environment)
        return _to_numpy(self._observations), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one action of every robot, and begin the next episode where one has ended."""
        before, chosen = self._infos(), np.asarray(actions)
        if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
            raise InputError(
                f"actions have shape {chosen.shape} and type {chosen.dtype}; give {self.num_envs} whole numbers"
            )
        if len(wrong := chosen[(chosen < 0) | (chosen >= FrontDoor.num_actions)]):
            raise InputError(f"an action is {wrong[0]}; {_ACTIONS}")
        self._keys, self._observations, self._states, rewards, info = _step(
            self._keys, self._states, chosen.astype(np.int32), self._params, self._environment
        )
        terminated, truncated, infos = np.array(info["terminated"]), np.array(info["truncated"]), self._infos()
        done = terminated | truncated
        if np.any(done) and not self._environment.autoreset:
            self._states = None
        elif np.any(done):
            kept = np.full(self.num_envs, None, object)
            kept[done] = list(iterate(self.observation_space, _to_numpy(info["final_observation"], done)))
            final = {"house": np.where(done, before["house"], None), "_house": done.copy()}
            infos |= {"final_obs": kept, "_final_obs": done, "final_info": final, "_final_info": done.copy()}
        return _to_numpy(self._observations), np.array(rewards, np.float64), terminated, truncated, infos

    def render(self) -> tuple[UInt8[np.ndarray, "height width 3"], ...] | None:
        """An image of each robot's belief, or `None` without render mode."""
        if self.render_mode is None or self._observations is None:
            return None
        pixels = max(_PICTURE // max(self._params.worlds.width, self._params.worlds.height), _CELL)
        return tuple(np.array(_draw(self._observations, pixels=pixels)))

    def _infos(self) -> dict[str, Any]:
        """The infos of `FrontDoorEnv` for every robot, in the format of vector environments."""
        if self._states is None:
            raise gymnasium.error.ResetNeeded("the episode has ended or none has begun; call reset() first")
        return {"house": self._houses[np.asarray(self._states.house)], "_house": np.ones(self.num_envs, bool)}

    def _starts(self, options: Mapping[str, Any]) -> tuple[Int[Array, "robots"], Pose]:
        """Index of the house, and pose, of each robot, as options say."""
        for name in options:
            check_name("reset option", name, _START)
        columns = []
        for name in _START:
            if name not in options:
                raise InputError(f"reset options have no {name!r}; a start has {', '.join(_START)}")
            value = options[name]
            columns.append([value] * self.num_envs if np.ndim(value) == 0 else list(value))
            if len(columns[-1]) != self.num_envs:
                raise InputError(
                    f"reset option {name!r} has {len(columns[-1])} values; give one, or one for each of {self.num_envs}"
                )
        table = np.array([self._start(*row) for row in zip(*columns, strict=True)], np.int32)
        house, x, y, heading = jnp.asarray(table).T
        return house, make_pose(x, y, heading)

    def _start(self, name: object, x: Any, y: Any, heading: Any) -> tuple[int, int, int, int]:
        """One checked start, with the index of the house."""
        house = self._dataset.house(str(name))
        if house.split != self._split:
            raise InputError(
                f"house {name} is in split {house.split!r}; make the environment with split={house.split!r}"
            )
        for name, number in (("x", x), ("y", y), ("heading", heading)):
            check_number(name, number, whole=True)
        if reason := why_no_episode(house):
            raise InputError(f"house {house.name}: no episode can be run in it: {reason}; give another house")
        check_starts([Start(house.name, int(x), int(y), int(heading))], self._dataset, lambda _: f"house {house.name}")
        return int(np.flatnonzero(self._houses == house.name)[0]), x, y, heading


class _OneByOne(FrontDoorVectorEnv):
    """Robots whose next episode begins when it is asked for."""

    metadata = {**FrontDoorVectorEnv.metadata, "autoreset_mode": AutoresetMode.DISABLED}  # noqa: RUF012


class FrontDoorEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """The search for a front door by one robot, as a Gymnasium environment.

    Observations, actions and rewards are described in the module's documentation. An episode is terminated when the
    robot reaches a front door, and truncated at the step limit.

    Args:
      render_mode: `rgb_array` or `None`.
      **options: `dataset`, `split`, `sensing_range`, `field_of_view`, `step_limit` and `cells` of `dc2g_jax.make_env`.

    Raises:
      InputError: an option or the dataset is invalid.
    """

    metadata = {name: FrontDoorVectorEnv.metadata[name] for name in ("render_modes", "render_fps")}  # noqa: RUF012

    def __init__(self, *, render_mode: str | None = None, **options: Any):
        self._robots = _OneByOne(1, render_mode=render_mode, **options)
        self.render_mode = render_mode
        self.observation_space: gymnasium.Space[Any] = self._robots.single_observation_space
        self.action_space = self._robots.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Begin an episode at a random or a given start.

        Args:
          seed: begins the series of random episodes of this seed; `None` continues the current series.
          options: `None` or empty, or a start: `house` (a name in the split), `x`, `y` and `heading`.

        Returns:
          Observation, and infos with the house's name as `house`.

        Raises:
          InputError: an episode cannot start there.
        """
        super().reset(seed=seed)
        observations, infos = self._robots.reset(seed=seed, options=options)
        return _of_one(observations), {"house": infos["house"][0]}

    def step(self, action: np.int64 | int) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Take one action. `terminated`: a front door is reached; `truncated`: the step limit is reached."""
        if not self.action_space.contains(action):
            raise InputError(f"action is {action!r}; {_ACTIONS}")
        observations, (reward,), (terminated,), (truncated,), infos = self._robots.step(np.array([action]))
        return _of_one(observations), float(reward), bool(terminated), bool(truncated), {"house": infos["house"][0]}

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """An image of the robot's belief, or `None` without render mode."""
        pictures = self._robots.render()
        return None if pictures is None else pictures[0]


def _leave_forks() -> None:
    """End a process that was forked from one that uses JAX, where JAX hangs. Gymnasium's `async` forks on Linux."""
    if os.getpid() != _IMPORTED_BY:
        # An exception would not reach the user: Gymnasium tells of the processes' errors only once they have begun.
        sys.exit(
            "error: JAX hangs in forked processes; give make_vec vectorization_mode='vector_entry_point', which is "
            "faster, or vector_kwargs={'context': 'spawn'}"
        )


def _to_numpy(observations: Observation, chosen: Any = ...) -> dict[str, np.ndarray]:
    """The chosen observations of a batch in Gymnasium's format; copies that the caller owns."""
    pose = observations.pose
    return {
        "terrain": np.array(np.asarray(observations.terrain)[chosen]),
        "pose": np.stack([np.asarray(part)[chosen] for part in (pose.x, pose.y, pose.heading)], axis=-1),
    }


def _of_one(observations: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The observation of the only robot of a batch."""
    return {name: values[0] for name, values in observations.items()}


_jit = functools.partial(jit, static_argnames="environment")


@_jit
def _start(
    houses: Int[Array, "robots"], poses: Pose, params: Params, environment: FrontDoor
) -> tuple[Observation, State]:
    return jax.vmap(environment.start, in_axes=(0, 0, None))(houses, poses, params)


@_jit
def _reset(keys: Array, params: Params, environment: FrontDoor) -> tuple[Array, Observation, State]:
    """Begin an episode of every robot; also return the keys for the next ones."""
    keys, own_keys = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
    return keys, *jax.vmap(environment.reset, in_axes=(0, None))(own_keys, params)


@_jit
def _step(
    keys: Array, states: State, actions: Int[Array, "robots"], params: Params, environment: FrontDoor
) -> tuple[Array, Observation, State, Float[Array, "robots"], dict[str, Any]]:
    """Step every robot. Keys advance only where the next episode begins."""

    def step_one(key: Array, state: State, action: Array) -> tuple[Any, ...]:
        next_key, own_key = jax.random.split(key)
        observation, state, reward, terminated, truncated, info = environment.step(own_key, state, action, params)
        begins = environment.autoreset & (terminated | truncated)
        return jnp.where(begins, next_key, key), observation, state, reward, info

    return jax.vmap(step_one)(keys, states, actions)


@functools.partial(jit, static_argnames="pixels")
def _draw(observations: Observation, *, pixels: int) -> UInt8[Array, "robots height width 3"]:
    """A picture of each observation."""
    return jax.vmap(lambda observation: image(observation, pixels, max(1.0, _ROBOT / pixels)))(observations)
