"""Contact sheets: every house of a dataset as a small map, by group, on one or more pages."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dc2g_jax._src.figures.results_figures import PAGE_WIDTH, class_patch, map_image, save_figure, whole_pixels
from dc2g_jax._src.grid.ground import pieces
from dc2g_jax._src.grid.terrain import FRONT_DOOR
from dc2g_jax._src.readers.houses import House, group_of
from dc2g_jax._src.readers.starts import why_no_episode

#: Inches: height of a page, its margin, side of a map's space, gaps between and below maps, headline, head and foot.
_PAGE_HEIGHT, _MARGIN = 9.6, 0.05
_SIDE, _BETWEEN, _NAME, _HEADLINE, _HEAD, _FOOT = 0.837, 0.05, 0.24, 0.24, 0.26, 0.42
_COLUMNS = int((PAGE_WIDTH - 2 * _MARGIN + _BETWEEN) / (_SIDE + _BETWEEN))
_DPI = 300

#: Group -> headline, in the order of the sheets.
_GROUPS = {
    "train": "training",
    "val": "validation",
    "same_neighborhood": "test, same neighborhood as training",
    "new_neighborhood": "test, new neighborhood",
    "urban": "test, urban",
    "test": "test",
}


class _SheetRow(NamedTuple):
    """A row of maps.

    Attributes:
      headline: headline above the row, empty except in the first row of a group.
      houses: houses of the row.
    """

    headline: str
    houses: Sequence[House]

    @property
    def height(self) -> float:
        """Height of the row, inches."""
        return (_HEADLINE if self.headline else 0.0) + _SIDE + _NAME


def contact_pages(houses: Sequence[House]) -> list[list[_SheetRow]]:
    """Rows of houses by page. Houses are ordered by group and name."""
    by_group: dict[str, list[House]] = {group: [] for group in _GROUPS}
    for house in sorted(houses, key=lambda house: house.name):
        by_group.setdefault(group_of(house) or house.split, []).append(house)
    room = _PAGE_HEIGHT - _HEAD - _FOOT
    pages: list[list[_SheetRow]] = [[]]
    for group, own in by_group.items():
        for first in range(0, len(own), _COLUMNS):
            headline = "" if first else f"{_GROUPS.get(group, group)}: {len(own)}"
            row = _SheetRow(headline, own[first : first + _COLUMNS])
            if pages[-1] and sum(above.height for above in pages[-1]) + row.height > room:
                pages.append([])
            pages[-1].append(row)
    return pages


def _draw_house(axes: Axes, house: House) -> None:
    """Draw a house, with one mark per door."""
    terrain = house.terrain
    axes.imshow(map_image(terrain, np.ones(terrain.shape, bool)), interpolation="nearest", aspect="auto")
    doors = pieces(terrain == FRONT_DOOR)
    axes.plot(
        [door.x for door in doors], [door.y for door in doors], "*", color="white", markersize=4.5,
        markeredgecolor="black", markeredgewidth=0.5,
    )  # fmt: skip
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set(color="#999999", linewidth=0.4)


def _doubt(house: House) -> str:
    """A short reason why no episode can be run in a house; empty if one can."""
    if why_no_episode(house) is None:
        return ""
    return "door cut off" if np.any(house.terrain == FRONT_DOOR) else "no front door"


def _map_axes(figure: Figure, house: House, x: float, y: float) -> Axes:
    """Axes of a map around a point of a page, in inches from the upper left corner.

    They are as large as possible, at whole pixels so that all cells have the same size.
    """
    height, width = house.terrain.shape
    page_height = float(figure.get_figheight())
    cell = whole_pixels(_SIDE / max(height, width), _DPI)
    left = round((x - cell * width / 2) * _DPI) / _DPI
    bottom = round((page_height - y - cell * height / 2) * _DPI) / _DPI
    return figure.add_axes(
        (left / PAGE_WIDTH, bottom / page_height, cell * width / PAGE_WIDTH, cell * height / page_height)
    )


def plot_contact_page(path: str | Path, title: str, number: str, rows: Sequence[_SheetRow]) -> list[Path]:
    """Draw a page of houses of any sizes. A star marks a door; text below a map says why no episode can be run in it.

    Args:
      path: output path without ending.
      title: description of the houses.
      number: description of the page, such as its number.
      rows: one page of `contact_pages`.

    Returns:
      The files written: PNG, SVG and PDF.
    """
    height = _HEAD + sum(row.height for row in rows) + _FOOT
    figure = Figure(figsize=(PAGE_WIDTH, height))

    def write(x: float, y: float, text: str, **style: Any) -> None:
        """Write at a position in inches from the upper left corner."""
        figure.text(x / PAGE_WIDTH, 1 - y / height, text, va="center", **style)

    write(_MARGIN, _HEAD / 2, title, fontsize=9, fontweight="bold")
    write(PAGE_WIDTH - _MARGIN, _HEAD / 2, number, ha="right", fontsize=7.5, color="#555555")
    y = _HEAD
    for row in rows:
        if row.headline:
            write(_MARGIN, y + 0.55 * _HEADLINE, row.headline, fontsize=8)
            y += _HEADLINE
        for place, house in enumerate(row.houses):
            middle = _MARGIN + place * (_SIDE + _BETWEEN) + _SIDE / 2
            _draw_house(_map_axes(figure, house, middle, y + _SIDE / 2), house)
            write(middle, y + _SIDE + 0.07, house.name, ha="center", fontsize=7)
            write(middle, y + _SIDE + 0.175, _doubt(house), ha="center", fontsize=7, color="#b03000")
        y += _SIDE + _NAME
    classes = np.unique(np.concatenate([house.terrain.ravel() for row in rows for house in row.houses]))
    figure.legend(
        handles=[class_patch(index) for index in classes.tolist()], loc="lower left", bbox_to_anchor=(0, 0), ncols=8,
        frameon=False, fontsize=7, handlelength=1.1, columnspacing=1.1, borderaxespad=0.1, labelspacing=0.3,
    )  # fmt: skip
    return save_figure(figure, path, dpi=_DPI)
