"""Training sets, saved in the folder of the training so that they are collected only once."""

import functools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from dc2g_jax._src.errors import InputError, short
from dc2g_jax._src.estimation.estimators import NetworkCostToGo
from dc2g_jax._src.estimation.weights import read_safetensors, write_safetensors
from dc2g_jax._src.readers.houses import HouseDataset, tell_on_stderr
from dc2g_jax._src.training.cost_to_go_data import (
    DataConfig,
    check_masks,
    observation_masks,
    training_houses,
    training_set,
)
from dc2g_jax._src.training.masks import Masks, by_house
from dc2g_jax._src.training.pairs import TrainingSet

#: Collects an object with arrays as attributes. Takes a function to report the finished and the total number of parts.
Collect = Callable[[Callable[[int, int], None]], object]


def kept_arrays(path: Path, names: Sequence[str], collect: Collect, *, unit: str) -> dict[str, np.ndarray]:
    """Arrays from a file, collected and saved there the first time.

    Args:
      path: the file.
      names: names of the arrays.
      collect: collects an object that has the arrays as attributes.
      unit: unit of the progress bar.

    Raises:
      InputError: the file cannot be read.
    """
    if path.exists():
        remedy = "delete it to collect its contents anew"
        found = read_safetensors(path, remedy)
        if set(found) != set(names):
            raise InputError(f"{path}: has the arrays {short(sorted(found))}, not {', '.join(names)}; {remedy}")
        return found
    with tqdm(desc=path.stem, unit=unit, file=sys.stderr) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        collected = collect(show)
    arrays = {name: np.asarray(getattr(collected, name)) for name in names}
    write_safetensors(path, arrays)
    return arrays


def open_training_set(
    folder: Path, dataset: HouseDataset, config: DataConfig, network: NetworkCostToGo | None = None
) -> TrainingSet:
    """The training set of the compact network. Its masks are saved in `folder`.

    Args:
      folder: folder for the masks.
      dataset: the houses.
      config: configuration of the training set.
      network: if given, masks of robots that this network leads are added.

    Raises:
      InputError: no house can be trained on, or saved masks cannot be read or belong to other houses.
    """
    houses, n_own = training_houses(dataset, config)

    def kept_masks(name: str, leader: NetworkCostToGo | None = None) -> Masks:
        collect = functools.partial(observation_masks, config, houses, n_own, network=leader)
        masks = Masks(**kept_arrays(folder / name, Masks._fields, collect, unit="rollout"))
        check_masks(masks, houses, str(folder / name))
        return masks

    parts = [kept_masks("masks.safetensors")]
    if network is not None:
        parts.append(kept_masks("masks_of_network.safetensors", network))
    data = training_set(houses, n_own, by_house(parts))
    tell_on_stderr(
        f"Training on {n_own} houses of the dataset ({dataset.name}) and {config.extra_houses} more that are drawn: "
        f"{len(data.mask_world)} observation masks, {int(data.n_own)} of the dataset's houses"
    )
    return data
