"""Families of maps, gathered into one dataset to run planners in all of them: `dc2g compare`."""

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dc2g_jax._src.readers.houses import NAMED, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import usable_houses
from dc2g_jax._src.runtime.errors import InputError

#: The name of the family of published houses.
PUBLISHED = "published"

#: Families of `dc2g compare` unless others are chosen, one of them for robots that see all around. Those of extracts
#: need their files.
FAMILIES: tuple[str, ...] = (PUBLISHED, *NAMED, "offices@360")


def family_of(house: str) -> str:
    """The family of a house of `gather`."""
    return house.partition("/")[0]


def field_of_view_of(family: str) -> tuple[str, float | None]:
    """The maps and the field of view in degrees of a family such as `offices@360`; `None` if it names none."""
    found = None if Path(family).exists() else re.fullmatch(r"(.+)@([0-9]+(?:\.[0-9]+)?)", family)
    return (family, None) if found is None else (found[1], float(found[2]))


def gather(locations: Iterable[str], split: str, most_maps: int, most_cells: int) -> HouseDataset:
    """Maps of several families in one dataset, each named `family/house`.

    Args:
      locations: `published` for the published houses, or what `open_dataset` takes; a field of view in degrees may
        follow, as in `offices@360`. A family is called by its dataset's name; the published houses `published`.
      split: `train`, `val` or `test`.
      most_maps: largest number of maps of a family. They are spread evenly over its split.
      most_cells: largest number of cells of a map. Of a family with maps of several sizes, those of the largest size
        are taken: planners are compiled for every size.

    Raises:
      InputError: a dataset cannot be opened, has no usable map in the split, or two have one name.
    """
    families: dict[str, HouseDataset] = {}
    for family in locations:
        location, _ = field_of_view_of(family)
        dataset = open_dataset(None if location == PUBLISHED else location)
        if location == PUBLISHED and dataset.source != "published":
            raise InputError(f"family {PUBLISHED}: is not the published dataset, but {dataset.name}; leave it out")
        name = (PUBLISHED if location == PUBLISHED else dataset.name) + family.removeprefix(location)
        if name in families:
            raise InputError(f"family {name}: two families have this name; leave one out or rename it")
        families[name] = dataset
    houses = []
    for name, dataset in families.items():
        small = [house for house in dataset.houses if house.terrain.size <= most_cells]
        if not small:
            raise InputError(f"family {name}: every map has more than {most_cells} cells; give a larger --most-cells")
        usable = usable_houses(replace(dataset, houses=tuple(small)), split, instead="leave the family out")
        size = max((house.terrain.shape for house in usable), key=math.prod)
        usable = [house for house in usable if house.terrain.shape == size]
        chosen = np.unique(np.linspace(0, len(usable) - 1, most_maps).round().astype(int))
        houses += [replace(usable[number], name=f"{name}/{usable[number].name}") for number in chosen.tolist()]
    return HouseDataset("families", "folder", tuple(houses))
