"""Episodes recorded from the authors' code: all of them where they lie beside the repository, or else a sample."""

import csv
from pathlib import Path

import numpy as np

from tests.support.places import ROOT, SHARED

SAMPLE = ROOT / "tests" / "data" / "golden"
GOLDEN = SHARED / "golden" if (SHARED / "golden").is_dir() else SAMPLE

Table = list[dict[str, str]]
Arrays = dict[str, np.ndarray]


def read_table(path: Path) -> Table:
    """The rows of a CSV file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def read_arrays(path: Path) -> Arrays:
    """The arrays of an `.npz` file."""
    with np.load(path) as file:
        return dict(file)
