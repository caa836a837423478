"""Long runs in one process: no errors but those for bad input, and memory that stays flat.

    ENDURANCE=1 pytest -n 0 -rP -m release tests/test_endurance.py

makes 100,000 random calls of the online planner, and runs a million episodes of frontier exploration and 20,000 of
`dc2g`; without `ENDURANCE`, a hundredth of them. It says how many there were, and how much memory they took.
"""

import collections
import os

import numpy as np
import pytest

from dc2g_jax._src.estimation.compact_unet import Architecture
from dc2g_jax._src.grid.terrain import CLASS_NAMES, ROAD
from dc2g_jax._src.planning.online import OnlinePlanner
from dc2g_jax._src.planning.rules import SETTINGS
from dc2g_jax._src.readers.starts import sample_starts
from dc2g_jax._src.rollouts.evaluation import Runner
from dc2g_jax._src.runtime.errors import LONGEST_MESSAGE, InputError
from tests.support.houses import DATASET
from tests.support.memory import memory
from tests.support.networks import random_network

pytestmark = pytest.mark.release

#: Share of the calls and episodes.
SHARE = float(os.environ.get("ENDURANCE", "0.01"))

#: Bytes that a process may have more at the end than after a fifth of its work.
MOST_GROWTH = 64 * 2**20


class Growth:
    """Memory between a fifth of some work and its end."""

    def __init__(self, parts: int):
        self._parts, self._done, self._before = parts, 0, 0

    def note(self) -> None:
        """Call this after each part."""
        self._done += 1
        if self._done == max(1, self._parts // 5):
            self._before = memory()

    def check(self, what: str) -> None:
        grown = memory() - self._before
        print(f"{what}: memory grew by {grown / 2**20:.1f} MiB, of {self._before / 2**20:.0f}")
        assert grown < MOST_GROWTH


@pytest.mark.parametrize("planner", ["frontier", "dc2g"])
def test_random_calls_of_the_online_planner(planner):
    largest, rng = (20, 36), np.random.default_rng(0)
    network = None if planner == "frontier" else random_network(Architecture(widths=(4, 4, 4, 4)))
    online = OnlinePlanner(planner, network=network, sensing_range=5, largest=largest)
    count, told = max(10, int(50_000 * SHARE)), collections.Counter[str]()
    growth = Growth(count)
    for _ in range(count):
        slip = int(rng.random() < 0.2)  # some maps are too large, some classes are none, some robots are off the map
        rows, columns = rng.integers(1, np.array(largest) + 1 + slip)
        classes = rng.integers(1, len(CLASS_NAMES) + slip, 1 + rng.integers(6))
        grid = (rng.choice(classes, (rows, columns)) * (rng.random((rows, columns)) < rng.random())).astype(np.uint8)
        x, y, heading = rng.integers(-slip, (columns + slip, rows + slip, 4 + slip)).tolist()
        if not slip:
            grid[y, x] = ROAD
        try:
            message, mode = "", online.plan(grid, (x, y, heading)).mode
        except InputError as error:
            message, mode = str(error), "refused"
        assert message.isprintable()
        assert len(message) <= LONGEST_MESSAGE
        told[mode] += 1
        growth.note()
    assert {"refused", "explore", "to_goal", "gave_up"} <= told.keys()
    growth.check(f"{planner}: {count} calls, {dict(told)}")


@pytest.mark.parametrize(("planner", "episodes"), [("frontier", 1_000_000), ("dc2g", 20_000)])
def test_many_episodes_in_one_process(planner, episodes):
    network = random_network(Architecture(widths=(4, 4, 4, 4)))
    runner = Runner(DATASET, SETTINGS["paper"])
    starts = sample_starts(DATASET.houses, 500, seed=0)
    first = runner.run(starts, [planner], network)
    parts = max(5, int(episodes * SHARE) // len(starts))
    growth = Growth(parts)
    for _ in range(parts):
        assert runner.run(starts, [planner], network) == first
        growth.note()
    growth.check(
        f"{planner}: {(parts + 1) * len(starts)} episodes of {sum(one.steps for one in first) / len(first):.1f} steps"
    )
