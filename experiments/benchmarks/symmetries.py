"""Extra steps in all eight symmetries of the test houses: `python -m experiments.benchmarks.symmetries`.

A rule that prefers left to right gives other figures in mirrored houses. The mean over the symmetries does not depend
on how the houses happen to lie.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from dc2g_jax._src.estimation.checkpoints import network_in_folder
from dc2g_jax._src.grid.poses import FORWARD
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.houses import House, HouseDataset, open_dataset
from dc2g_jax._src.readers.starts import Start, sample_starts, why_no_episode
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.rollouts.results import Results
from dc2g_jax._src.runtime.progress import EpisodeProgress

PLANNERS = ("frontier", "dc2g")


def transformed(house: House, starts: Sequence[Start], turns: int, mirror: bool) -> tuple[House, list[Start]]:
    """A house and starts in it, turned counterclockwise by quarter turns and then mirrored left to right."""

    def of(grid: np.ndarray) -> np.ndarray:
        turned = np.rot90(grid, turns)
        return turned[:, ::-1] if mirror else turned

    places = of(np.arange(house.terrain.size).reshape(house.terrain.shape))
    new = []
    for start in starts:
        y, x = np.argwhere(places == start.y * house.terrain.shape[1] + start.x)[0]
        dx, dy = FORWARD[start.heading]
        for _ in range(turns):
            dx, dy = dy, -dx
        heading = FORWARD.index((-dx if mirror else dx, dy))
        new.append(start._replace(x=int(x), y=int(y), heading=heading))
    return House(house.name, house.split, np.ascontiguousarray(of(house.terrain))), new


def main() -> None:
    """Run frontier exploration and DC2G in every symmetry, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", help="folder of the published houses")
    parser.add_argument("--starts-per-house", type=int, default=10)
    options = parser.parse_args()
    dataset = open_dataset(options.dataset)
    houses = [house for house in dataset.houses if house.split == "test" and why_no_episode(house) is None]
    starts = sample_starts(houses, options.starts_per_house, seed=0)
    network = network_in_folder()
    print("turns mirror " + " ".join(f"{name:>9}" for name in PLANNERS))
    means = []
    for mirror in (False, True):
        for turns in range(4):
            pairs = [transformed(one, [s for s in starts if s.house == one.name], turns, mirror) for one in houses]
            seen_so = HouseDataset(dataset.name, dataset.source, tuple(house for house, _ in pairs))
            runner = Runner(seen_so, SETTINGS["paper"], progress=EpisodeProgress())
            results = runner.run([start for _, own in pairs for start in own], PLANNERS, network)
            means.append([np.mean(Results(results).array("extra")[name]) for name in PLANNERS])
            print(f"{turns:5d} {mirror!s:>6} " + " ".join(f"{mean:9.1f}" for mean in means[-1]), flush=True)
    print(f"{'mean':>12} " + " ".join(f"{mean:9.1f}" for mean in np.mean(means, axis=0)))


if __name__ == "__main__":
    main()
