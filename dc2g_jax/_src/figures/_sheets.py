"""Figures of map panels placed at whole pixels, and outlines of cells."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.textpath import TextPath

from dc2g_jax._src.figures.results_figures import PAGE_WIDTH

#: Inches: largest height of a panel; the space left of the panels, between them and between their titles, above them
#: for a title and for its second line, for the color bars and a line of the legend. And pixels per inch.
_TALLEST = 2.2
_LEFT, _GAP, _TITLE_GAP, _TITLE, _TITLE_LINE, _BARS, _LINE = 0.3, 0.06, 0.14, 0.2, 0.12, 0.48, 0.15
DPI = 300

#: Width of an entry of the legend, inches.
_ENTRY = 0.8

FONT, _SMALL = 7.5, 7.0


class Sheet(NamedTuple):
    """A figure of map panels, placed at whole pixels so that every cell has the same size.

    Attributes:
      figure: the figure.
      width: width of a panel, inches.
      height: height of a panel, inches.
      rows: number of rows of panels.
      row: distance from one row of panels to the next, inches; their titles are between them.
      column: distance from one column of panels to the next, inches.
      lines: number of lines of the panels' titles, see `_title_lines`.
    """

    figure: Figure
    width: float
    height: float
    rows: int
    row: float
    column: float
    lines: int

    def panel(self, row: int, column: int, title: str = "", color: str = "black") -> Axes:
        """The panel in a row and a column."""
        x = _LEFT + column * self.column + (self.column - _GAP - self.width) / 2
        axes = self._axes(x, (row + 1) * self.row - self.height, self.width, self.height)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set(color="#888888", linewidth=0.5)
        self.title(axes, title, color)
        return axes

    def title(self, axes: Axes, title: str, color: str = "black") -> None:
        """Set the title of a panel."""
        axes.set_title("\n".join(_title_lines(title, self.lines)), fontsize=FONT, pad=4, color=color)

    def bar(self, place: float, colors: ScalarMappable, title: str, **options: Any) -> None:
        """Add a color bar below the panels, in the left half of the page (`place` 0) or in the right half (1)."""
        width = float(self.figure.get_figwidth())
        length = min(2.2, 0.38 * width)
        x = (0.25 + 0.5 * place) * width - length / 2
        axes = self._axes(x, self.rows * self.row + 0.09, length, 0.08)
        bar = self.figure.colorbar(colors, cax=axes, orientation="horizontal", **options)
        bar.outline.set_linewidth(0.5)  # type: ignore[operator]
        axes.tick_params(labelsize=_SMALL, length=2, width=0.5, pad=1.5)
        axes.set_xlabel(title, fontsize=_SMALL, labelpad=1)

    def _axes(self, x: float, y: float, width: float, height: float) -> Axes:
        """Axes at a position in inches from the upper left corner, moved to whole pixels."""
        dpi = float(self.figure.dpi)
        x, y = round(x * dpi) / dpi, round(y * dpi) / dpi
        total_width, total_height = self.figure.get_size_inches()
        rectangle = (x / total_width, 1 - (y + height) / total_height, width / total_width, height / total_height)
        return self.figure.add_axes(rectangle)


def _title_lines(title: str, count: int) -> list[str]:
    """A title on one line, or broken after its colon on two."""
    return [title] if count == 1 else title.replace(": ", ":\n").split("\n")


def _inches(text: str) -> float:
    """Width of a title, inches."""
    return float(TextPath((0, 0), text, size=FONT).get_extents().width) / 72 if text else 0.0


def most_columns(panels: int, shape: tuple[int, ...]) -> int:
    """The number of columns that makes panels largest; of several, the largest."""
    height, width = shape
    return max(
        range(1, panels + 1), key=lambda columns: (min(PAGE_WIDTH / columns / width, _TALLEST / height), columns)
    )


def empty_sheet(
    shape: tuple[int, ...], rows: int, columns: int, entries: Sequence[Any], titles: Sequence[str], dpi: int = DPI
) -> Sheet:
    """An empty sheet of panels for maps of a shape, with its legend.

    Titles that would touch their neighbors are broken after the colon. `dpi` is that of the figure as it is written.
    """
    height, width = shape
    room = (PAGE_WIDTH - _LEFT - columns * _GAP) / columns
    pixels = min(room / width, _TALLEST / height) * dpi
    # Whole pixels, so that cells look alike; those of less than four cannot be told from others anyway.
    scale = (math.floor(pixels) if pixels >= 4 else pixels) / dpi
    panel_width, panel_height = scale * width, scale * height
    lines = 1 if max(map(_inches, titles)) + _TITLE_GAP <= panel_width + _GAP else 2
    widest = max(_inches(line) for title in titles for line in _title_lines(title, lines))
    column = max(panel_width + _GAP, widest + _TITLE_GAP)
    page_width = max(_LEFT + columns * column, 3.5)
    legend_columns = min(len(entries), int(page_width / _ENTRY))
    foot = _BARS + _LINE * -(-len(entries) // legend_columns)
    row = panel_height + _TITLE + (lines - 1) * _TITLE_LINE
    page = np.ceil(np.array([page_width, rows * row + foot]) * dpi)
    figure = Figure(figsize=tuple(page / dpi), dpi=dpi)
    figure.legend(
        handles=list(entries), loc="lower center", bbox_to_anchor=(0.5, 0), borderaxespad=0.1, ncols=legend_columns,
        frameon=False, fontsize=_SMALL, handlelength=1.1, handletextpad=0.5, columnspacing=1.2, labelspacing=0.35,
    )  # fmt: skip
    return Sheet(figure, panel_width, panel_height, rows, row, column, lines)


def spread(last: int, count: int, turn: int | None = None) -> list[int]:
    """Numbers from 0 to `last`, both included, evenly spaced, at most `count`; those before the last end at `turn`."""
    chosen = np.linspace(0, last, count) if turn is None else np.append(np.linspace(0, turn, count - 1), last)
    return np.unique(chosen.round().astype(int)).tolist()


def cell_rim(cells: Bool[np.ndarray, "h w"] | Int[np.ndarray, "h w"]) -> list[Any]:
    """The edges between cells of different values, each as its two ends."""
    y, x = np.nonzero(cells[:, 1:] != cells[:, :-1])
    upright = np.stack([np.stack([x + 0.5, y - 0.5], -1), np.stack([x + 0.5, y + 0.5], -1)], 1)
    y, x = np.nonzero(cells[1:] != cells[:-1])
    level = np.stack([np.stack([x - 0.5, y + 0.5], -1), np.stack([x + 0.5, y + 0.5], -1)], 1)
    return list(np.concatenate([upright, level]))
