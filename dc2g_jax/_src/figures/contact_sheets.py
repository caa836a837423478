"""Contact sheets: every house of a dataset as a small map, by group, on one or more pages."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dc2g_jax._src.figures.results_figures import PAGE_WIDTH, class_patch, map_image, save_figure
from dc2g_jax._src.grid.ground import pieces
from dc2g_jax._src.grid.terrain import FRONT_DOOR
from dc2g_jax._src.readers.houses import House, group_of
from dc2g_jax._src.readers.starts import why_no_episode

#: Rows of a page, and maps in a row.
_ROWS, _COLUMNS = 8, 8

#: Group -> headline, in the order of the sheets.
_GROUPS = {
    "train": "training",
    "val": "validation",
    "same_neighborhood": "test, same neighborhood as training",
    "new_neighborhood": "test, new neighborhood",
    "urban": "test, urban",
    "test": "test",
}

#: The headline of a row, empty except in the first one of a group, and its houses.
Row = tuple[str, Sequence[House]]


def contact_pages(houses: Sequence[House]) -> list[list[Row]]:
    """Rows of houses by page. Houses are ordered by group and name."""
    by_group: dict[str, list[House]] = {group: [] for group in _GROUPS}
    for house in sorted(houses, key=lambda house: house.name):
        by_group.setdefault(group_of(house), []).append(house)
    rows: list[Row] = [
        ("" if first else f"{_GROUPS.get(group, group)}: {len(own)}", own[first : first + _COLUMNS])
        for group, own in by_group.items()
        for first in range(0, len(own), _COLUMNS)
    ]
    return [rows[first : first + _ROWS] for first in range(0, len(rows), _ROWS)]


def _draw_house(axes: Axes, house: House) -> None:
    """Draw a house, with one mark per door, its name, and a short reason if no episode can be run in it."""
    terrain = house.terrain
    axes.imshow(map_image(terrain, np.ones(terrain.shape, bool)), interpolation="nearest")
    doors = pieces(terrain == FRONT_DOOR)
    axes.plot(
        [door.x for door in doors], [door.y for door in doors], "*", color="white", markersize=4.5,
        markeredgecolor="black", markeredgewidth=0.5,
    )  # fmt: skip
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color="#999999", linewidth=0.4)
    doubt = "" if why_no_episode(house) is None else "\ndoor cut off" if doors else "\nno front door"
    axes.set_xlabel(house.name + doubt, fontsize=7, labelpad=1.5, color="#b03000" if doubt else "black")


def plot_contact_page(path: str | Path, title: str, number: str, rows: Sequence[Row]) -> None:
    """Draw one of `contact_pages`, with houses of any sizes, and write it as PNG, SVG and PDF.

    A star marks a door; text below a map says why no episode can be run in it.
    """
    figure = Figure(figsize=(PAGE_WIDTH, 1.12 * len(rows) + 0.7), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.02)  # type: ignore[union-attr, call-arg]
    figure.suptitle(f"{title}, {number}", fontsize=9, fontweight="bold")
    for panels, (headline, houses) in zip(figure.subplots(len(rows), _COLUMNS, squeeze=False), rows, strict=True):
        if headline:
            panels[0].set_title(" ", fontsize=8)  # makes room for a line that is longer than the map is wide
            panels[0].text(0, 1.06, headline, fontsize=8, in_layout=False, transform=panels[0].transAxes)
        for axes, house in zip(panels, houses, strict=False):
            _draw_house(axes, house)
        for axes in panels[len(houses) :]:
            axes.set_axis_off()
    classes = np.unique(np.concatenate([house.terrain.ravel() for _, houses in rows for house in houses]))
    figure.legend(
        handles=[class_patch(index) for index in classes.tolist()], loc="outside lower left", ncols=8, frameon=False,
        fontsize=7, handlelength=1.1, columnspacing=1.1, labelspacing=0.3,
    )  # fmt: skip
    save_figure(figure, path, dpi=300)
