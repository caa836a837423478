"""Planning toward a goal nobody has mapped: Deep Cost-to-Go (DC2G) training and batch evaluation in JAX.

```
import dc2g_jax as dc2g

results = dc2g.evaluate(["frontier", "dc2g"], "procedural", split="val")
print(results)
```

The names below are imported when they are first used, so that `import dc2g_jax` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dc2g_jax.datasets.houses import House as House
    from dc2g_jax.datasets.houses import HouseDataset as HouseDataset
    from dc2g_jax.datasets.houses import open_dataset as open_dataset
    from dc2g_jax.datasets.houses import procedural_dataset as procedural_dataset
    from dc2g_jax.datasets.maps import read_map as read_map
    from dc2g_jax.datasets.starts import Start as Start
    from dc2g_jax.datasets.starts import sample_starts as sample_starts
    from dc2g_jax.environments.task import make_env as make_env
    from dc2g_jax.errors import InputError as InputError
    from dc2g_jax.estimation.checkpoints import load_network as load_network
    from dc2g_jax.estimation.estimators import Estimator as Estimator
    from dc2g_jax.grid.gridworld import Belief as Belief
    from dc2g_jax.grid.gridworld import reset as reset
    from dc2g_jax.grid.gridworld import step as step
    from dc2g_jax.grid.poses import make_pose as make_pose
    from dc2g_jax.grid.world import World as World
    from dc2g_jax.grid.world import world_from_terrain as world_from_terrain
    from dc2g_jax.inspection.figures import plot_results as plot_results
    from dc2g_jax.planning.decisions import Decision as Decision
    from dc2g_jax.planning.named import PLANNERS as PLANNERS
    from dc2g_jax.planning.named import make as make
    from dc2g_jax.planning.online import OnlinePlanner as OnlinePlanner
    from dc2g_jax.planning.planners import Plan as Plan
    from dc2g_jax.planning.planners import Planner as Planner
    from dc2g_jax.planning.rules import SETTINGS as SETTINGS
    from dc2g_jax.planning.rules import Rules as Rules
    from dc2g_jax.programs import jit as jit
    from dc2g_jax.rollouts.evaluation import EpisodeResult as EpisodeResult
    from dc2g_jax.rollouts.evaluation import Results as Results
    from dc2g_jax.rollouts.evaluation import evaluate as evaluate
    from dc2g_jax.rollouts.rollout import rollout as rollout

    __version__: str

#: Public name -> the module that defines it.
_MODULES = {
    # Make, run, compare.
    "make": "planning.named",
    "PLANNERS": "planning.named",
    "evaluate": "rollouts.evaluation",
    "Results": "rollouts.evaluation",
    "EpisodeResult": "rollouts.evaluation",
    "plot_results": "inspection.figures",
    "OnlinePlanner": "planning.online",
    "Decision": "planning.decisions",
    "make_env": "environments.task",
    "load_network": "estimation.checkpoints",
    # Write a planner or an estimator.
    "Planner": "planning.planners",
    "Plan": "planning.planners",
    "Estimator": "estimation.estimators",
    "Rules": "planning.rules",
    "SETTINGS": "planning.rules",
    "jit": "programs",
    # Houses and starts.
    "open_dataset": "datasets.houses",
    "procedural_dataset": "datasets.houses",
    "read_map": "datasets.maps",
    "sample_starts": "datasets.starts",
    "HouseDataset": "datasets.houses",
    "House": "datasets.houses",
    "Start": "datasets.starts",
    # The gridworld.
    "World": "grid.world",
    "world_from_terrain": "grid.world",
    "Belief": "grid.gridworld",
    "reset": "grid.gridworld",
    "step": "grid.gridworld",
    "make_pose": "grid.poses",
    "rollout": "rollouts.rollout",
    "InputError": "errors",
}

__all__ = ["__version__", *_MODULES]


def __getattr__(name: str) -> Any:
    """Import a public name from its module when it is first asked for."""
    if name == "__version__":
        from importlib.metadata import version

        found: Any = version(__name__)
    elif name in _MODULES:
        found = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
