"""Observation masks that imitate hand-drawn ones: strokes, blobs and strips (the masks of Algorithm 1).

The paper's masks were not published. Its figures show broad strokes that uncover parts of a map, and the authors'
scripts rotate each mask by quarter turns and invert it.
"""

import cv2
import numpy as np
from jaxtyping import Bool

#: Variants of a drawing: four quarter turns, each as drawn and inverted.
VARIANTS = 8

#: A drawing covers at least this share of the map and leaves at least this share uncovered.
_LEAST_SHARE = 0.1


def _stroke(canvas: np.ndarray, rng: np.random.Generator) -> None:
    """A broad brush led along a bent line."""
    size = len(canvas)
    place, direction = rng.uniform(0, size, 2), rng.uniform(0, 2 * np.pi)
    points = [place]
    for _ in range(rng.integers(3, 9)):
        direction += rng.normal(0, 0.6)
        place = place + size * rng.uniform(0.06, 0.2) * np.array([np.cos(direction), np.sin(direction)])
        points.append(place)
    line = np.array(points).round().astype(np.int32)
    cv2.polylines(canvas, [line], False, 1, thickness=max(1, round(size * rng.uniform(0.06, 0.22))))


def _blob(canvas: np.ndarray, rng: np.random.Generator) -> None:
    """A patch with a round but uneven edge."""
    size, corners = len(canvas), 12
    angles = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    radii = size * rng.uniform(0.1, 0.3) * rng.uniform(0.7, 1.3, corners)
    points = rng.uniform(0.1, 0.9, 2) * size + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cv2.fillPoly(canvas, [points.round().astype(np.int32)], 1)


def _strip(canvas: np.ndarray, rng: np.random.Generator) -> None:
    """A straight band from edge to edge."""
    size, direction = len(canvas), rng.uniform(0, np.pi)
    along = 2 * size * np.array([np.cos(direction), np.sin(direction)])
    middle = rng.uniform(0.15, 0.85, 2) * size
    ends = [tuple(int(value) for value in (middle + sign * along).round()) for sign in (-1, 1)]
    cv2.line(canvas, ends[0], ends[1], 1, thickness=max(1, round(size * rng.uniform(0.1, 0.35))))


def _drawing(size: int, rng: np.random.Generator) -> Bool[np.ndarray, "s s"]:
    """One to four random shapes together."""
    while True:
        canvas = np.zeros((size, size), np.uint8)
        for _ in range(rng.integers(1, 5)):
            (_stroke, _blob, _strip)[rng.integers(3)](canvas, rng)
        if _LEAST_SHARE <= canvas.mean() <= 1 - _LEAST_SHARE:
            return canvas.astype(bool)


def mask_variants(mask: Bool[np.ndarray, "s s"]) -> Bool[np.ndarray, "8 s s"]:
    """A mask rotated by 0 to 3 quarter turns, then the inverse of each."""
    turned = [np.rot90(mask, quarter) for quarter in range(4)]
    return np.stack(turned + [~variant for variant in turned])


def drawn_masks(count: int, size: int, *, seed: int) -> Bool[np.ndarray, "count s s"]:
    """Random drawings in all their variants; true where a cell is observed.

    Args:
      count: number of masks. The last drawing has fewer variants if this is not a multiple of `VARIANTS`.
      size: rows and columns.
      seed: seed of the drawings.
    """
    rng = np.random.default_rng(seed)
    drawings = [mask_variants(_drawing(size, rng)) for _ in range(-(-count // VARIANTS))]
    return np.concatenate([np.zeros((0, size, size), bool), *drawings])[:count]
