"""Class images: PNG files whose exact colors stand for terrain classes, and their palettes."""

import difflib
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dc2g_jax._src.files.png import bands, read_png, write_png
from dc2g_jax._src.files.tables import read_table, whole_cell, write_table
from dc2g_jax._src.grid.terrain import CLASS_COLORS, CLASS_NAMES, UNKNOWN
from dc2g_jax._src.runtime.errors import InputError, short

#: The palette of a dataset, in its folder.
PALETTE_FILE = "labels_colors.csv"

#: Names in published palettes that stand for "unknown or not observed".
ALIASES = {"_boundary_": UNKNOWN, "_background_": UNKNOWN}

_NO_ENTRY = 255
_FOREIGN_CLASS = 254

#: Number of colors that a message lists before it only counts the others.
_LISTED_COLORS = 2


@dataclass(frozen=True, eq=False)
class Palette:
    """The colors of a dataset.

    If several classes share a color, the first in file order has it. An unknown class is an error only if a
    pixel has its color, so a palette may list more classes than images use.

    Attributes:
        path: the file it was read from.
        names: n class names, in file order.
        colors: uint8 [n 3], RGB.
    """

    path: Path
    names: tuple[str, ...]
    colors: np.ndarray

    @functools.cached_property
    def class_of_color(self) -> np.ndarray:
        """Terrain class of every RGB color, uint8 [2**24]; 254 for unknown classes, 255 for colors without entry."""
        table = np.full(2**24, _NO_ENTRY, np.uint8)
        known = {**ALIASES, **{name: index for index, name in enumerate(CLASS_NAMES)}}
        for name, code in zip(self.names[::-1], color_codes(self.colors)[::-1], strict=True):
            table[code] = known.get(name, _FOREIGN_CLASS)
        return table

    def classes(self, pixels: np.ndarray) -> np.ndarray:
        """Terrain classes of RGB colors, uint8 [...], as in `class_of_color`, for colors uint8 [... 3 or more]."""
        return self.class_of_color[color_codes(pixels)]

    def color_of_class(self) -> dict[int, tuple[int, int, int]]:
        """RGB color of each terrain class that has one; the first if it has several."""
        classes = self.classes(self.colors).tolist()
        colors = dict(zip(classes[::-1], map(tuple, self.colors[::-1].tolist()), strict=True))
        return {index: color for index, color in colors.items() if index < len(CLASS_NAMES)}

    def nearest(self, color: Sequence[int]) -> tuple[str, tuple[int, int, int]]:
        """Return name and RGB of the entry closest to a color, by Euclidean distance in RGB."""
        difference = self.colors.astype(int) - np.asarray(color, int)
        index = int(np.argmin((difference**2).sum(axis=1)))
        return self.names[index], tuple(self.colors[index].tolist())


def read_palette(csv_path: Path) -> Palette:
    """Read a palette file: CSV with the columns `class`, `r`, `g`, `b`, color values 0 to 255.

    Classes are identified by name, so the order of the rows does not matter.

    Raises:
        InputError: no such file, a column is missing, a value is not a whole number from 0 to 255, or the
            file has no rows.
    """
    csv_path = Path(csv_path)
    rows = read_table(
        csv_path, ("class", "r", "g", "b"), remedy="give the palette, a CSV file with the columns class,r,g,b"
    )
    colors = np.zeros((len(rows), 3), np.uint8)
    for index, (line, row) in enumerate(rows):
        for channel, column in enumerate("rgb"):
            where = f"{csv_path}: line {line}: {column!r} of class {short(row['class'])}"
            colors[index, channel] = whole_cell(where, row[column], 0, 255)
    return Palette(csv_path, tuple(row["class"] for _, row in rows), colors)


def read_class_image(png_path: Path, palette: Palette, *, size: tuple[int, int] | None = None) -> np.ndarray:
    """Read a palette or RGB PNG as terrain classes, uint8 [H W].

    Colors are exact. An alpha channel must be opaque everywhere.

    Args:
        png_path: the file.
        palette: classes of the colors.
        size: width and height that the image must have; `None` for any.

    Raises:
        InputError: the file is not an intact PNG with 8-bit colors, or a pixel has a color that is not in the
            palette or belongs to an unknown class.
    """
    png_path = Path(png_path)
    picture = read_png(png_path, ("palette", "8-bit RGB", "8-bit RGBA"), "colors that stand for classes", size=size)
    classes = np.empty((picture.height, picture.width), np.uint8)
    for rows, band in bands(picture):
        pixels = np.asarray(band.convert("RGBA"))
        if pixels[..., 3].min() < 255:
            raise InputError(f"{png_path}: has pixels that are not opaque; export it without transparency")
        classes[rows] = palette.classes(pixels)
        if np.max(classes[rows]) >= _FOREIGN_CLASS:
            raise InputError(f"{png_path}: {_explain_color(palette, pixels[..., :3], classes[rows], rows.start)}")
    return classes


def check_classes(where: str, classes: npt.ArrayLike) -> np.ndarray:
    """Return an array as terrain classes, uint8 [H W].

    Raises:
        InputError: it is no class image; `where` begins the message.
    """
    array = np.asarray(classes)
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"{where}: a class image has shape [H W], not {list(array.shape)}; pass one image")
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{where}: holds {array.dtype}; pass class indices, whole numbers")
    foreign = (array < 0) | (array >= len(CLASS_NAMES))
    if np.any(foreign):
        y, x = (int(value) for value in np.argwhere(foreign)[0])
        raise InputError(
            f"{where}: holds {array[y, x]} at column {x}, row {y}; pass class indices from 0 to {len(CLASS_NAMES) - 1}"
        )
    return array.astype(np.uint8)


def write_class_image(png_path: Path, classes: np.ndarray) -> None:
    """Write terrain classes, uint8 [H W], as an RGB PNG in the published colors.

    Raises:
        InputError: the array is not two-dimensional or has an invalid class index.
        OSError: the file cannot be written.
    """
    write_png(png_path, CLASS_COLORS[check_classes(str(png_path), classes)])


def write_palette(folder: Path) -> None:
    """Write the palette of the published colors to a folder, as `PALETTE_FILE`.

    Raises:
        OSError: the file cannot be written.
    """
    rows = ((name, *color) for name, color in zip(CLASS_NAMES, CLASS_COLORS.tolist(), strict=True))
    write_table(folder / PALETTE_FILE, ("class", "r", "g", "b"), rows)


def color_codes(colors: np.ndarray) -> np.ndarray:
    """RGB colors, uint8 [... 3 or more], as one integer each."""
    return colors[..., :3].astype(np.int32) @ np.array([1 << 16, 1 << 8, 1], np.int32)


def _explain_color(palette: Palette, colors: np.ndarray, classes: np.ndarray, top: int) -> str:
    """A message about the pixels without class in some rows of an image, from row `top` on."""
    y, x = (int(value) for value in np.argwhere(classes >= _FOREIGN_CLASS)[0])
    if classes[y, x] == _FOREIGN_CLASS:
        name, known = palette.nearest(colors[y, x].tolist())[0], CLASS_NAMES[1:]
        close = difflib.get_close_matches(name, known, n=1)
        remedy = f"rename it to {close[0] if close else 'one of: ' + ', '.join(known)}"
        return f"pixel x={x}, y={top + y} is {short(name)} in {palette.path.name}, which is no class; {remedy}"
    rows, columns = np.nonzero(classes == _NO_ENTRY)
    _, first, counts = np.unique(color_codes(colors[rows, columns]), return_index=True, return_counts=True)
    listed = []
    for index in np.argsort(-counts, kind="stable")[:_LISTED_COLORS]:
        x, y, others = int(columns[first[index]]), int(rows[first[index]]), int(counts[index]) - 1
        color = tuple(colors[y, x].tolist())
        name, nearest = palette.nearest(color)
        more = f" and {others} more" if others else ""
        listed.append(f"{color} at x={x}, y={top + y}{more} (nearest: {short(name)} {nearest})")
    if len(counts) > len(listed):
        listed.append(f"and {len(counts) - len(listed)} other colors")
    return f"{', '.join(listed)} not in {palette.path.name}; add classes to it, or repaint exactly, without smoothing"
