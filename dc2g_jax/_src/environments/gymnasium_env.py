"""The search for a front door as Gymnasium environments: a single one, and a vectorized one in one compiled call.

    import dc2g_jax.gymnasium  # registers the environments

    gymnasium.make("dc2g_jax/FrontDoor-v0", dataset="procedural", split="train")
    gymnasium.make_vec("dc2g_jax/FrontDoor-v0", num_envs=256, vectorization_mode="vector_entry_point")

Both wrap `environments.functional.FrontDoor` and take the same options. They need the extra `gym`.

An observation is a dictionary: `terrain`, uint8 [h w], holds the class index of every observed cell (see
`grid.terrain`) and 0 elsewhere; `pose`, int32 [3], is column, row and heading (0 = +x, 1 = +y, 2 = -x, 3 = -y;
y grows downward). Actions: 0 forward one cell, 1 turn left, 2 turn right. The reward of every action is -1.
"""

import functools
import os
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8
from PIL import Image, ImageDraw

from dc2g_jax._src.environments.functional import FrontDoor, Observation, Params, State, observe, whole_number
from dc2g_jax._src.environments.task import FrontDoorTask
from dc2g_jax._src.errors import InputError
from dc2g_jax._src.grid.poses import FORWARD, HEADINGS, Pose
from dc2g_jax._src.grid.terrain import CLASS_NAMES, FIGURE_RGB
from dc2g_jax._src.programs import jit

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.utils import seeding
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space, iterate
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"dc2g_jax._src.environments.gymnasium_env needs {error.name}, which is not installed; "
        'install the extra: pip install "dc2g_jax[gym]"',
        name=error.name,
    ) from None

#: Approximate length of the longer side of a rendered frame, pixels.
_FRAME_SIDE = 400

#: Color of the robot in a frame, RGB; no class has it.
RENDERED_ROBOT_COLOR = (240, 228, 66)

#: Least half-length of the robot in a frame, pixels.
_RENDERED_ROBOT_RADIUS = 9

#: The process that imported this module, and with it JAX.
_IMPORTED_BY = os.getpid()

_ACTIONS = "give 0 (forward), 1 (turn left) or 2 (turn right)"


class FrontDoorEnv(gymnasium.Env[dict[str, np.ndarray], np.int64]):
    """The search for a front door by one robot, as a Gymnasium environment.

    Observations, actions and rewards are described in the module's documentation. An episode is terminated when the
    robot reaches a front door, and truncated at the step limit.

    Args:
      render_mode: `rgb_array` or `None`.
      **options: `dataset`, `split`, `sensing_range`, `step_limit` and `cells` of
        `environments.task.FrontDoorTask`.

    Raises:
      InputError: an option or the dataset is invalid.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, *, render_mode: str | None = None, **options: Any):
        _leave_forks()
        self._task = FrontDoorTask(**options)
        self.render_mode = _checked_render_mode(render_mode)
        self.observation_space = _observation_space(self._task)
        self.action_space = spaces.Discrete(FrontDoor.num_actions)
        self._key: Array | None = None
        self._observation: Observation | None = None
        self._state: State | None = None

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
        if seed is not None or self._key is None:
            self._key = _keys([self.np_random])[0]
        task = self._task
        if options:
            house, pose = jax.tree.map(lambda leaf: leaf[0], task.starts(options, 1))
            self._observation, self._state = _start(house, pose, task.params, task.environment)
        else:
            self._key, self._observation, self._state = _reset(self._key, task.params, task.environment)
        return self._seen(), self._info()

    def step(self, action: np.int64 | int) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Take one action. `terminated`: a front door is reached; `truncated`: the step limit is reached."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("the episode has ended or none has begun; call reset() first")
        if not self.action_space.contains(action):
            raise InputError(f"action is {action!r}; {_ACTIONS}")
        task = self._task
        self._observation, self._state, reward, terminated, truncated = _advance(
            self._state, np.int32(action), task.params, task.environment
        )
        outcome = self._seen(), float(reward), bool(terminated), bool(truncated), self._info()
        if terminated or truncated:
            self._state = None
        return outcome

    def render(self) -> UInt8[np.ndarray, "height width 3"] | None:
        """An image of the robot's belief, or `None` without render mode."""
        if self.render_mode is None or self._observation is None:
            return None
        return frame(**self._seen())

    def _seen(self) -> dict[str, np.ndarray]:
        assert self._observation is not None
        return _to_numpy(self._observation)

    def _info(self) -> dict[str, Any]:
        assert self._state is not None
        return {"house": self._task.names[int(self._state.house)]}


class FrontDoorVectorEnv(gymnasium.vector.VectorEnv[dict[str, np.ndarray], np.ndarray, np.ndarray]):
    """The vectorized search for a front door: many robots in separate episodes, stepped by one compiled call.

    Robot `i` has the same episodes as a `FrontDoorEnv` with seed `seed + i`. When an episode ends, the next begins in
    the same step (`AutoresetMode.SAME_STEP`): the observation is the first of the new episode, and the last of the old
    episode is `final_obs` in the infos.

    Args:
      num_envs: number of robots.
      render_mode: see `FrontDoorEnv`.
      **options: see `FrontDoorEnv`.
    """

    metadata = {**FrontDoorEnv.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int, *, render_mode: str | None = None, **options: Any):
        self.num_envs = whole_number("num_envs", num_envs, 1)
        self._task = FrontDoorTask(**options)
        self.render_mode = _checked_render_mode(render_mode)
        self.single_observation_space = _observation_space(self._task)
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
            self._keys = _keys(seeding.np_random(seed + robot)[0] for robot in range(self.num_envs))
        task = self._task
        if options:
            houses, poses = task.starts(options, self.num_envs)
            self._observations, self._states = _start_all(houses, poses, task.params, task.environment)
        else:
            self._keys, self._observations, self._states = _reset_all(self._keys, task.params, task.environment)
        return _to_numpy(self._observations), self._infos()

    def step(
        self, actions: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one action of every robot, and begin the next episode where one has ended."""
        if self._states is None:
            raise gymnasium.error.ResetNeeded("no episode has begun; call reset() first")
        task, houses = self._task, np.asarray(self._states.house)
        self._keys, self._observations, self._states, rewards, info = _step_all(
            self._keys, self._states, self._checked(actions), task.params, task.environment
        )
        terminated, truncated = np.array(info["terminated"]), np.array(info["truncated"])
        infos = self._infos()
        if np.any(done := terminated | truncated):
            last = np.full(self.num_envs, None, object)
            last[done] = list(iterate(self.observation_space, _to_numpy(info["final_observation"], done)))
            final = {"house": np.where(done, task.names[houses], None), "_house": done.copy()}
            infos |= {"final_obs": last, "_final_obs": done, "final_info": final, "_final_info": done.copy()}
        return _to_numpy(self._observations), np.array(rewards, np.float64), terminated, truncated, infos

    def render(self) -> tuple[UInt8[np.ndarray, "height width 3"], ...] | None:
        """An image of each robot's belief, or `None` without render mode."""
        if self.render_mode is None or self._observations is None:
            return None
        return tuple(frame(**seen) for seen in iterate(self.observation_space, _to_numpy(self._observations)))

    def _checked(self, actions: np.ndarray | Sequence[int]) -> Int[np.ndarray, "robots"]:
        chosen = np.asarray(actions)
        if chosen.shape != (self.num_envs,) or chosen.dtype.kind not in "iu":
            raise InputError(
                f"actions have shape {chosen.shape} and type {chosen.dtype}; give {self.num_envs} whole numbers"
            )
        if len(wrong := chosen[(chosen < 0) | (chosen >= FrontDoor.num_actions)]):
            raise InputError(f"an action is {wrong[0]}; {_ACTIONS}")
        return chosen.astype(np.int32)

    def _infos(self) -> dict[str, Any]:
        """The infos of `FrontDoorEnv` for every robot, in the format of vector environments."""
        assert self._states is not None
        return {"house": self._task.names[np.asarray(self._states.house)], "_house": np.ones(self.num_envs, bool)}


def _leave_forks() -> None:
    """End a process that was forked from one that uses JAX, where JAX hangs. Gymnasium's `async` forks on Linux."""
    if os.getpid() != _IMPORTED_BY:
        # An exception would not reach the user: Gymnasium tells of the processes' errors only once they have begun.
        sys.exit(
            "error: JAX hangs in forked processes; give make_vec vectorization_mode='vector_entry_point', which is "
            "faster, or vector_kwargs={'context': 'spawn'}"
        )


def _checked_render_mode(mode: str | None) -> str | None:
    if mode not in (None, *FrontDoorEnv.metadata["render_modes"]):
        raise InputError(f"render_mode is {mode!r}; use 'rgb_array' or None")
    return mode


def _observation_space(task: FrontDoorTask) -> gymnasium.Space[Any]:
    height, width = task.params.worlds.height, task.params.worlds.width
    return spaces.Dict(
        {
            "terrain": spaces.Box(0, len(CLASS_NAMES) - 1, (height, width), np.uint8),
            "pose": spaces.MultiDiscrete([width, height, HEADINGS], dtype=np.int32),
        }
    )


def _keys(generators: Iterable[np.random.Generator]) -> Array:
    """The first key of each robot's series of episodes."""
    return jax.vmap(jax.random.key)(np.array([generator.integers(2**31) for generator in generators], np.int32))


def _to_numpy(observation: Observation, chosen: Any = ...) -> dict[str, np.ndarray]:
    """An observation, or the chosen ones of a batch, in Gymnasium's format; copies that the caller owns."""
    pose = observation.pose
    return {
        "terrain": np.array(np.asarray(observation.terrain)[chosen]),
        "pose": np.stack([np.asarray(part)[chosen] for part in (pose.x, pose.y, pose.heading)], axis=-1),
    }


_jit = functools.partial(jit, static_argnames="environment")


@_jit
def _start(house: Int[Array, ""], pose: Pose, params: Params, environment: FrontDoor) -> tuple[Observation, State]:
    return environment.start(house, pose, params)


_start_all = _jit(jax.vmap(_start, in_axes=(0, 0, None, None)))


@_jit
def _reset(key: Array, params: Params, environment: FrontDoor) -> tuple[Array, Observation, State]:
    """Begin an episode; also return the key for the next one."""
    key, own_key = jax.random.split(key)
    return key, *environment.reset(own_key, params)


_reset_all = _jit(jax.vmap(_reset, in_axes=(0, None, None)))


@_jit
def _advance(
    state: State, action: Int[Array, ""], params: Params, environment: FrontDoor
) -> tuple[Observation, State, Array, Array, Array]:
    state, reward, terminated, truncated = environment.advance(state, action, params)
    return observe(state), state, reward, terminated, truncated


@_jit
def _step_all(
    keys: Array, states: State, actions: Int[Array, "robots"], params: Params, environment: FrontDoor
) -> tuple[Array, Observation, State, Float[Array, "robots"], dict[str, Any]]:
    """Step every robot. Keys advance only where an episode ends."""

    def step_one(key: Array, state: State, action: Array) -> tuple[Any, ...]:
        next_key, own_key = jax.random.split(key)
        observation, state, reward, terminated, truncated, info = environment.step(own_key, state, action, params)
        return jnp.where(terminated | truncated, next_key, key), observation, state, reward, info

    return jax.vmap(step_one)(keys, states, actions)


def frame(terrain: UInt8[np.ndarray, "h w"], pose: Int[np.ndarray, "3"]) -> UInt8[np.ndarray, "height width 3"]:
    """An image of a belief in the colors of figures, with unobserved cells as unknown and the robot as a triangle.

    Args:
      terrain: observed class indices.
      pose: column, row and heading.
    """
    scale = max(_FRAME_SIDE // max(terrain.shape), 4)
    picture = Image.fromarray(np.repeat(np.repeat(FIGURE_RGB[terrain], scale, axis=0), scale, axis=1))
    x, y, heading = pose
    ahead = np.array(FORWARD[heading])
    aside = np.array([-ahead[1], ahead[0]])
    corners = np.array([ahead, 0.8 * aside - 0.9 * ahead, -0.8 * aside - 0.9 * ahead])
    middle = np.array([x + 0.5, y + 0.5]) * scale
    triangle = middle + corners * max(0.45 * scale, _RENDERED_ROBOT_RADIUS)
    ImageDraw.Draw(picture).polygon(triangle.ravel().tolist(), fill=RENDERED_ROBOT_COLOR, outline=(34, 34, 34))
    return np.array(picture)
