"""Every house of a dataset as a small map: `python -m experiments.draw_dataset --dataset FOLDER`."""

import dataclasses
import sys
from typing import Literal

from tqdm import tqdm

from dc2g_jax.cli.common import DatasetOption, OutOption, command_line
from dc2g_jax.cli.outputs import CommandOptions, output_folder
from dc2g_jax.datasets.houses import open_dataset
from dc2g_jax.errors import InputError
from dc2g_jax.inspection.contact_sheets import contact_pages, plot_contact_page


@dataclasses.dataclass(frozen=True)
class Options(CommandOptions):
    """Draw contact sheets of a dataset: every house as a small map with its name, by group; pages as PNG and SVG.

    Attributes:
      dataset: folder of houses, or `procedural`; where not given, DC2G_DATA, the cache, or a download.
      splits: which houses.
      out: folder to write to; a new one below outputs/ where not given.
    """

    dataset: DatasetOption = None
    splits: tuple[Literal["train", "val", "test"], ...] = ("train", "val", "test")
    out: OutOption = None


def main(options: Options) -> None:
    """Draw page by page."""
    dataset = open_dataset(options.dataset)
    houses = [house for house in dataset.houses if house.split in options.splits]
    if not houses:
        raise InputError(f"{dataset.name}: has no houses in {' or '.join(options.splits)}; give other --splits")
    out = output_folder(options, "draw_dataset")
    pages = contact_pages(houses)
    title = f"{dataset.name}: {len(houses)} houses"
    for number, rows in enumerate(tqdm(pages, desc="drawing", unit="page", file=sys.stderr), 1):
        plot_contact_page(out / f"page-{number}", title, f"page {number} of {len(pages)}", rows)
    print(f"{title}, pages: {len(pages)}, written to {out}: page-1.png, page-1.svg ...")


if __name__ == "__main__":
    command_line(Options, main)
