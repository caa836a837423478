"""Every house of a dataset as a small map: `dc2g draw dataset --dataset FOLDER`."""

import dataclasses
import sys
from typing import Literal

from tqdm import tqdm

from dc2g_jax._src.cli.options import DatasetOptions, OutOptions
from dc2g_jax._src.cli.outputs import output_folder, print_files
from dc2g_jax._src.figures.contact_sheets import contact_pages, plot_contact_page
from dc2g_jax._src.readers.houses import open_dataset
from dc2g_jax._src.runtime.errors import InputError


@dataclasses.dataclass(frozen=True)
class Options(DatasetOptions, OutOptions):
    """Draw contact sheets of a dataset: every house as a small map with its name, by group. Pages are PNG, SVG, PDF.

    Attributes:
      splits: splits to draw.
    """

    splits: tuple[Literal["train", "val", "test"], ...] = ("train", "val", "test")


def main(options: Options) -> None:
    """Draw all pages."""
    dataset = open_dataset(options.dataset)
    houses = [house for house in dataset.houses if house.split in options.splits]
    if not houses:
        raise InputError(f"{dataset.name}: has no houses in {' or '.join(options.splits)}; give other --splits")
    out = output_folder(options, "draw_dataset")
    pages = contact_pages(houses)
    title = f"{dataset.name}: {len(houses)} houses"
    for number, rows in enumerate(tqdm(pages, desc="drawing", unit="page", file=sys.stderr), 1):
        plot_contact_page(out / f"page-{number}", title, f"page {number} of {len(pages)}", rows)
    print(f"{title}, pages: {len(pages)}")
    print_files(out)
