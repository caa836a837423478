"""Contact sheets: every house of a dataset as a small map, by group, on one or more pages."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dc2g_jax.datasets.houses import House, group_of
from dc2g_jax.datasets.starts import why_no_episode
from dc2g_jax.grid.ground import pieces
from dc2g_jax.grid.terrain import FRONT_DOOR
from dc2g_jax.inspection.figures import PAGE_WIDTH, class_patch, map_image, save_figure, whole_pixels

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


class SheetRow(NamedTuple):
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


def contact_pages(houses: Sequence[House]) -> list[list[SheetRow]]:
    """Rows of houses by page. Houses are ordered by group and name."""
    by_group: dict[str, list[House]] = {group: [] for group in _GROUPS}
    for house in sorted(houses, key=lambda house: house.name):
        by_group.setdefault(group_of(house) or house.split, []).append(house)
    room = _PAGE_HEIGHT - _HEAD - _FOOT
    pages: list[list[SheetRow]] = [[]]
    for group, own in by_group.items():
        for first in range(0, len(own), _COLUMNS):
            headline = "" if first else f"{_GROUPS.get(group, group)}: {len(own)}"
            row = SheetRow(headline, own[first : first + _COLUMNS])
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


class _Page:
    """An empty page with its head.

    Args:
      title: text at the left of the head.
      number: text at the right of the head.
      height: height of all rows, inches.
    """

    def __init__(self, title: str, number: str, height: float):
        self._height = _HEAD + height + _FOOT
        self.figure = Figure(figsize=(PAGE_WIDTH, self._height))
        self._text(_MARGIN, _HEAD / 2, title, fontsize=9, fontweight="bold")
        self._text(PAGE_WIDTH - _MARGIN, _HEAD / 2, number, ha="right", fontsize=7.5, color="#555555")

    def _text(self, x: float, y: float, text: str, **style: Any) -> None:
        """Draw text at a position in inches from the upper left corner."""
        self.figure.text(x / PAGE_WIDTH, 1 - y / self._height, text, va="center", **style)

    def draw(self, row: SheetRow, y: float) -> None:
        """Draw a row whose upper edge is `y` inches below that of the page."""
        if row.headline:
            self._text(_MARGIN, y + 0.55 * _HEADLINE, row.headline, fontsize=8)
            y += _HEADLINE
        for place, house in enumerate(row.houses):
            middle = _MARGIN + place * (_SIDE + _BETWEEN) + _SIDE / 2
            _draw_house(self._map_axes(house, middle, y + _SIDE / 2), house)
            self._text(middle, y + _SIDE + 0.07, house.name, ha="center", fontsize=7)
            self._text(middle, y + _SIDE + 0.175, _doubt(house), ha="center", fontsize=7, color="#b03000")

    def _map_axes(self, house: House, x: float, y: float) -> Axes:
        """Axes of a map around a point, as large as possible, at whole pixels so that all cells have the same size."""
        height, width = house.terrain.shape
        cell = whole_pixels(_SIDE / max(height, width), _DPI)
        left = round((x - cell * width / 2) * _DPI) / _DPI
        bottom = round((self._height - y - cell * height / 2) * _DPI) / _DPI
        return self.figure.add_axes(
            (left / PAGE_WIDTH, bottom / self._height, cell * width / PAGE_WIDTH, cell * height / self._height)
        )


def plot_contact_page(path: str | Path, title: str, number: str, rows: Sequence[SheetRow]) -> list[Path]:
    """Draw a page of houses of any sizes. A star marks a door; text below a map says why no episode can be run in it.

    Args:
      path: output path without ending.
      title: description of the houses.
      number: description of the page, such as its number.
      rows: one page of `contact_pages`.

    Returns:
      The files written: PNG, SVG and PDF.
    """
    page = _Page(title, number, sum(row.height for row in rows))
    y = _HEAD
    for row in rows:
        page.draw(row, y)
        y += row.height
    classes = np.unique(np.concatenate([house.terrain.ravel() for row in rows for house in row.houses]))
    page.figure.legend(
        handles=[class_patch(index) for index in classes.tolist()], loc="lower left", bbox_to_anchor=(0, 0), ncols=8,
        frameon=False, fontsize=7, handlelength=1.1, columnspacing=1.1, borderaxespad=0.1, labelspacing=0.3,
    )  # fmt: skip
    return save_figure(page.figure, path, dpi=_DPI)
