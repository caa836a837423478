"""The environment with flat observations, for PureJaxRL's training loops and for gymnax's own wrappers."""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from dc2g_jax._src.environments import spaces
from dc2g_jax._src.environments.functional import FrontDoor, Observation, Params, State, one_hot_view
from dc2g_jax._src.grid.terrain import OUTSIDE


@dataclasses.dataclass(frozen=True)
class FlattenObservation:
    """`FrontDoor` with flat observations.

    An observation is the egocentric view (`environments.functional.one_hot_view`) as one row of ones and
    zeros, float32. This replaces PureJaxRL's `FlattenObservationWrapper`.

    Attributes:
      environment: the environment.
      radius: cells seen in each direction.
      six_values: whether `step` gives the six values of gymnax 1.0, for its own wrappers, as in
        `LogWrapper(FlattenObservation(env, six_values=True))`; else the five of versions before, as in PureJaxRL.
    """

    environment: FrontDoor
    radius: int = 8
    six_values: bool = False

    def __getattr__(self, name: str) -> Any:
        """Everything else is the environment's: `name`, `num_actions`, `default_params`, `action_space`."""
        if name.startswith("__"):  # not while a copy is made
            raise AttributeError(name)
        return getattr(self.environment, name)

    def observation_space(self, params: Params | None = None) -> spaces.Box:
        """The flat observations, which have the same shape for all parameters."""
        del params
        return spaces.Box(0.0, 1.0, ((2 * self.radius + 1) ** 2 * (OUTSIDE + 1),))

    def reset(self, key: PRNGKeyArray, params: Params | None = None) -> tuple[Float[Array, "inputs"], State]:
        """Begin an episode, see `FrontDoor.reset`."""
        observation, state = self.environment.reset(key, params)
        return self._flat(observation), state

    def step(
        self, key: PRNGKeyArray, state: State, action: int | Int[Array, ""], params: Params | None = None
    ) -> (
        tuple[Float[Array, "inputs"], State, Float[Array, ""], Bool[Array, ""], dict[str, Any]]
        | tuple[Float[Array, "inputs"], State, Float[Array, ""], Bool[Array, ""], Bool[Array, ""], dict[str, Any]]
    ):
        """Take one action, see `FrontDoor.step`.

        Returns:
          Observation; state; reward; whether the episode has ended, as one value or as `terminated` and `truncated`;
          and information about it. With one value the final observation is left out, because PureJaxRL keeps the
          information of all steps.
        """
        observation, state, reward, terminated, truncated, info = self.environment.step(key, state, action, params)
        if self.six_values:
            info["final_observation"] = self._flat(info["final_observation"])
            return self._flat(observation), state, reward, terminated, truncated, info
        del info["final_observation"]
        return self._flat(observation), state, reward, terminated | truncated, info

    def _flat(self, observation: Observation) -> Float[Array, "inputs"]:
        return jnp.ravel(one_hot_view(observation, self.radius))
