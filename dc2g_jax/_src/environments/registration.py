"""Registration of the environment with Gymnasium, without importing it, in either order of the imports.

Since version 1.0, Gymnasium does not discover plug-ins. So `import dc2g_jax` registers the environment at once if
Gymnasium is already imported, and otherwise as soon as it is.
"""

import importlib.machinery
import sys
from types import ModuleType

#: Gymnasium's name of the environment.
GYMNASIUM_ID = "dc2g_jax/FrontDoor-v0"

_MODULE = "dc2g_jax._src.environments.gymnasium_env"


def register_with_gymnasium() -> None:
    """Register the environment now if Gymnasium is loaded, else when it is imported."""
    if sys.modules.get("gymnasium") is not None:
        _register()
    elif _AfterGymnasium not in sys.meta_path:
        sys.meta_path.insert(0, _AfterGymnasium)


def _register() -> None:
    from gymnasium.envs import registration

    if GYMNASIUM_ID not in registration.registry:
        registration.register(
            GYMNASIUM_ID, entry_point=f"{_MODULE}:FrontDoorEnv", vector_entry_point=f"{_MODULE}:FrontDoorVectorEnv"
        )


class _AfterGymnasium:
    """A module finder that loads Gymnasium as Python does, then registers the environment."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> importlib.machinery.ModuleSpec | None:
        """How to load Gymnasium; `None` for other modules, which are left to later finders."""
        spec = importlib.machinery.PathFinder.find_spec(name) if name == "gymnasium" else None
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                _register()

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec
