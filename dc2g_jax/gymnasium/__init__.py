"""The Gymnasium environment `dc2g_jax/FrontDoor-v0`, which this import registers, and its wrappers (extra `gym`)."""

from dc2g_jax.runtime import require_extra

require_extra("gymnasium", extra="gym")

import gymnasium  # noqa: E402

from dc2g_jax.gymnasium.wrappers import (  # noqa: E402
    EgocentricObservation as EgocentricObservation,
    EgocentricVectorObservation as EgocentricVectorObservation,
)

#: Gymnasium's name of the environment.
GYMNASIUM_ID = "dc2g_jax/FrontDoor-v0"

if GYMNASIUM_ID not in gymnasium.registry:
    gymnasium.register(
        GYMNASIUM_ID,
        entry_point="dc2g_jax.gymnasium.environment:FrontDoorEnv",
        vector_entry_point="dc2g_jax.gymnasium.environment:FrontDoorVectorEnv",
    )
