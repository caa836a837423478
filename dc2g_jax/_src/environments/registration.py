"""Registration of the environments with Gymnasium."""

import gymnasium

#: Gymnasium's name of the environment.
GYMNASIUM_ID = "dc2g_jax/FrontDoor-v0"

_MODULE = "dc2g_jax._src.environments.gymnasium_env"


def register() -> None:
    """Register the environment, single and vectorized, unless it is registered."""
    if GYMNASIUM_ID not in gymnasium.registry:
        gymnasium.register(
            GYMNASIUM_ID, entry_point=f"{_MODULE}:FrontDoorEnv", vector_entry_point=f"{_MODULE}:FrontDoorVectorEnv"
        )
