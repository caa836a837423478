"""The environment for learning agents, for JAX and Gymnasium."""

from dc2g_jax._src.environments.functional import (
    FrontDoor as FrontDoor,
    Observation as Observation,
    Params as Params,
    State as State,
    egocentric as egocentric,
    front_door as front_door,
    image as image,
    make_env as make_env,
    observe as observe,
    one_hot_view as one_hot_view,
)
from dc2g_jax._src.environments.wrappers import FlattenObservation as FlattenObservation
