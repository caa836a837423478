"""Take the sample of the recorded episodes that lies in `tests/data/golden`.

`python -m tests.golden_sample --from ../shared/golden` writes it anew. It has the layout of its source, so tests read
either; its README says what it leaves out.
"""

import argparse
import csv
from pathlib import Path

import numpy as np

from dc2g_jax._src.grid.terrain import FRONT_DOOR, HOUSE, ROAD, TRAVERSABLE
from tests.support.golden import SAMPLE, Arrays, Table, read_arrays, read_table


def ground_plan(terrain: np.ndarray) -> np.ndarray:
    """The grid with doors, `road` for all other ground and `house` for the rest: frontier and oracle see no more."""
    ground = np.where(TRAVERSABLE[terrain], ROAD, HOUSE)
    return np.where(terrain == FRONT_DOOR, FRONT_DOOR, ground).astype(np.uint8)


def chosen_houses(episodes: Table, states: Arrays) -> list[str]:
    """One house of each neighborhood: that with the most recorded moments of its rarer sensing range, then of both."""
    sensing_ranges = np.unique(states["range"])

    def moments(house: str) -> tuple[int, int]:
        counts = [int(np.sum(states["range"][states["house"] == house] == one)) for one in sensing_ranges]
        return min(counts), sum(counts)

    houses = sorted({row["house"] for row in episodes})
    neighborhoods = dict.fromkeys(house[:4] for house in houses)
    return [max((house for house in houses if house.startswith(name)), key=moments) for name in neighborhoods]


def sample(source: Path) -> tuple[Table, Arrays, Arrays]:
    """All episodes in the chosen houses, their grids, and the moments inside episodes."""
    episodes = read_table(source / "episodes.csv")
    grids, states = read_arrays(source / "grids.npz"), read_arrays(source / "states.npz")
    houses = chosen_houses(episodes, states)
    rows = np.isin(grids["house"], houses)
    plans = {
        "house": grids["house"][rows],
        "terrain": ground_plan(grids["terrain"][rows]),
        "class_names": grids["class_names"],
    }
    moments = {name: values[np.isin(states["house"], houses)] for name, values in states.items()}
    return [row for row in episodes if row["house"] in houses], plans, moments


def write(source: Path) -> None:
    """Write the sample of a folder of recorded episodes."""
    episodes, grids, states = sample(source)
    with (SAMPLE / "episodes.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, list(episodes[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(episodes)
    np.savez_compressed(SAMPLE / "grids.npz", **grids)
    np.savez_compressed(SAMPLE / "states.npz", **states)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--from", dest="source", type=Path, required=True, help="the folder of all recorded episodes")
    write(parser.parse_args().source)
