"""Egocentric observations for Gymnasium, for convolutional policies.

    gymnasium.make("dc2g_jax/FrontDoor-v0") -> EgocentricObservation
    gymnasium.make_vec("dc2g_jax/FrontDoor-v0", ...) -> EgocentricVectorObservation

An observation is then float32 [class side side], ones and zeros. There is one plane for each class of
`dc2g_jax.grid.CLASS_NAMES`, of which the first is for unobserved cells, and one plane for cells beyond the map.
The robot is in the middle and faces up. The side is 2 `radius` + 1 cells.
"""

import functools
from typing import Any

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from jaxtyping import Array, Float

from dc2g_jax.environments import Observation, one_hot_view
from dc2g_jax.grid import CLASS_NAMES, Pose
from dc2g_jax.runtime import check_number, jit


class EgocentricObservation(gymnasium.ObservationWrapper[np.ndarray, np.int64, dict[str, np.ndarray]]):
    """`FrontDoorEnv` with egocentric observations, described in this module.

    Args:
      env: the environment, from Gymnasium's `make`.
      radius: cells seen in each direction.

    Raises:
      InputError: the radius is not a whole number of at least 1.
    """

    def __init__(self, env: gymnasium.Env[dict[str, np.ndarray], np.int64], radius: int = 8):
        super().__init__(env)
        self._radius = radius
        self.observation_space = _space(radius)

    def observation(self, observation: dict[str, np.ndarray]) -> Float[np.ndarray, "class side side"]:
        """The egocentric view of an observation."""
        return np.array(_views(observation, self._radius))


class EgocentricVectorObservation(gymnasium.vector.VectorWrapper):
    """`FrontDoorVectorEnv` with egocentric observations, including final ones in the infos.

    Args:
      env: the environment, from Gymnasium's `make_vec`.
      radius: cells seen in each direction.

    Raises:
      InputError: the radius is not a whole number of at least 1.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], radius: int = 8):
        super().__init__(env)
        self._radius = radius
        self.single_observation_space = _space(radius)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, "robots class side side"], dict[str, Any]]:
        """Begin an episode of every robot."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return np.array(_views(observations, self._radius)), infos

    def step(
        self, actions: np.ndarray
    ) -> tuple[Float[np.ndarray, "robots class side side"], np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take one action of every robot, and begin the next episode where one has ended."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        for robot in np.flatnonzero(infos.get("_final_obs", ())):
            infos["final_obs"][robot] = np.array(_views(infos["final_obs"][robot], self._radius))
        return np.array(_views(observations, self._radius)), rewards, terminated, truncated, infos


def _space(radius: int) -> spaces.Box:
    check_number("radius", radius, whole=True, least=1)
    side = 2 * radius + 1
    return spaces.Box(0.0, 1.0, (len(CLASS_NAMES) + 1, side, side), np.float32)


@functools.partial(jit, static_argnames="radius")
def _views(observations: dict[str, Array], radius: int) -> Float[Array, "*robots class side side"]:
    """The egocentric views of one observation or of a batch."""

    def view(terrain: Array, pose: Array) -> Array:
        return one_hot_view(Observation(terrain, Pose(*pose)), radius)

    view = jax.vmap(view) if observations["pose"].ndim == 2 else view
    return view(observations["terrain"], observations["pose"])
