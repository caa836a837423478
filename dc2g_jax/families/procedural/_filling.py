"""Filled polygons, pixel for pixel as OpenCV 5 draws them, whatever is installed: houses must not depend on it."""

from typing import Any

import numpy as np
import numpy.typing as npt
from jaxtyping import Bool, Int, UInt8

#: Columns of a span are counted in parts of a pixel.
_PART_BITS = 16

Integers = npt.NDArray[np.int64]


def fill_polygons(
    canvas: UInt8[np.ndarray, "h w"], points: Int[np.ndarray, "n 2"], sizes: Int[np.ndarray, "k"]
) -> None:
    """Set the pixels of polygons to 1: of each its outline, and its inside by the even-odd rule.

    `points` are the corners (column, row) of one polygon after the other, which may lie outside the image; `sizes` are
    their numbers.
    """
    size = np.array(canvas.shape[::-1])
    corners = points.T.astype(np.int64)
    before = np.arange(len(points)) - 1
    before[np.cumsum(sizes) - sizes] += sizes
    edges = np.stack([corners[:, before], corners])
    clipped, visible = _clip(edges, size)
    _draw_lines(canvas, clipped[..., visible])
    _fill_spans(canvas, edges, clipped, np.repeat(np.arange(len(sizes)), sizes))


def _runs(first: Any, counts: Integers) -> tuple[Integers, Integers]:
    """`counts` consecutive numbers from each of `first` on, and before them the index of the run each belongs to."""
    run = np.repeat(np.arange(len(counts)), counts)
    return run, np.arange(len(run)) + np.repeat(first - np.cumsum(counts) + counts, counts)


def _divide(numerator: Integers, denominator: Integers) -> Integers:
    """Quotients rounded toward zero; of a division by zero the numerator."""
    quotient = np.abs(numerator) // np.maximum(np.abs(denominator), 1)
    return np.where((numerator < 0) == (denominator < 0), quotient, -quotient)


def _clip(
    edges: Int[np.ndarray, "end axis n"], size: Int[np.ndarray, "axis"]
) -> tuple[Int[np.ndarray, "end axis n"], Bool[np.ndarray, "n"]]:
    """Edges cut off at the image's border, and which of them lie in the image then (Cohen and Sutherland)."""
    edges, last = edges.copy(), size[:, None] - 1
    visible = np.all((edges >= 0) & (edges <= last), axis=(0, 1))
    if visible.all():  # saves time
        return edges, visible
    for axis in (1, 0):
        beside = np.any(np.all(edges < 0, axis=0) | np.all(edges > last, axis=0), axis=0)
        for end in (0, 1):
            border = np.where(beside, edges[end, axis], np.clip(edges[end, axis], 0, last[axis]))
            along, across = edges[1] - edges[0] if axis else (edges[1] - edges[0])[::-1]
            edges[end, 1 - axis] += _divide((border - edges[end, axis]) * along, across)
            edges[end, axis] = border
    return edges, np.all((edges >= 0) & (edges <= last), axis=(0, 1))


def _draw_lines(canvas: UInt8[np.ndarray, "h w"], lines: Int[np.ndarray, "end axis n"]) -> None:
    """Bresenham's lines, from left to right."""
    (x, y), (x1, y1) = np.where(lines[0, 0] > lines[1, 0], lines[::-1], lines)
    dx, dy = x1 - x, y1 - y
    longer, shorter = np.maximum(dx, np.abs(dy)), np.minimum(dx, np.abs(dy))
    line, pixel = _runs(0, longer + 1)
    aside = (2 * shorter[line] * pixel + longer[line] - 1) // np.maximum(2 * longer[line], 1)
    steep = (np.abs(dy) > dx)[line]
    right, down = np.where(steep, aside, pixel), np.where(steep, pixel, aside)
    canvas[y[line] + np.sign(dy)[line] * down, x[line] + right] = 1


def _fill_spans(
    canvas: UInt8[np.ndarray, "h w"],
    edges: Int[np.ndarray, "end axis n"],
    clipped: Int[np.ndarray, "end axis n"],
    polygon: Int[np.ndarray, "n"],
) -> None:
    """Fill rows of each polygon between its first and second edge, its third and fourth, and so on."""
    height, width = canvas.shape
    rows, x = edges[:, 1], clipped[:, 0] << _PART_BITS
    known = np.where(clipped[0, 1] == clipped[1, 1], rows, clipped[:, 1])
    slope = _divide(x[1] - x[0], known[1] - known[0])
    upper = np.argmin(rows, axis=0)
    each = np.arange(len(polygon))
    top = rows[upper, each]
    x_at_top = x[upper, each] + (top - known[upper, each]) * slope
    first = np.maximum(top, 0)
    edge, row = _runs(first, np.maximum(np.minimum(rows.max(axis=0), height) - first, 0))
    at = x_at_top[edge] + (row - top[edge]) * slope[edge]
    order = np.lexsort((at, polygon[edge] * height + row))
    left, right = at[order].reshape(-1, 2).T
    left = np.maximum((left + (1 << _PART_BITS) - 1) >> _PART_BITS, 0)
    right = np.minimum(right >> _PART_BITS, width - 1)
    span, column = _runs(left, np.maximum(right - left + 1, 0))
    canvas[row[order][::2][span], column] = 1
