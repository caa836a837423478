"""What installed packages add to `dc2g_jax` by entry points, so that nothing here has to know of them.

Groups: `dc2g_jax.commands` (tables of commands, see `cli.commands.COMMANDS`), `dc2g_jax.datasets` (functions that
return a `HouseDataset`, by the word that stands for it; they get what `open_dataset` was given as `cells` and `split`,
which maps on grids of their own may ignore), `dc2g_jax.training_houses` (functions of a number and a seed that return
class indices of so many houses to train on), `dc2g_jax.training_maps` (functions of a number, a seed and a side that
return class indices of so many maps of that many cells a side), `dc2g_jax.dataset_folders` (functions that return the
`HouseDataset` in a folder, or `None` if the folder has another layout), `dc2g_jax.planners` (classes that are called
with the rules) and `dc2g_jax.network_planners` (called with the rules and `estimator=`).
"""

import importlib.metadata


def plugins(group: str) -> dict[str, importlib.metadata.EntryPoint]:
    """The entry points of a group by name, in the order of their names."""
    found = importlib.metadata.entry_points(group=f"dc2g_jax.{group}")
    return {point.name: point for point in sorted(found, key=lambda point: point.name)}
