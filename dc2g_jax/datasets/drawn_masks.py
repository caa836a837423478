"""Observation masks as a hand would draw them: strokes, blobs and strips (the masks of Algorithm 1).

The paper's own masks were not published; its figures show broad strokes that uncover parts of a map. Whole maps are
among them here: a network that is never shown one draws it as badly as if it had learned nothing, and the paper
judges its network on whole maps.
"""

import cv2
import numpy as np
from jaxtyping import Bool

#: Each drawing is used in the 8 symmetries of the square, covering and uncovering.
VARIANTS = 16

#: The last of so many drawings leaves the map whole.
_DRAWINGS_PER_WHOLE_MAP = 16

#: A drawing covers at least this share of the map, and leaves as much free.
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


def mask_variants(mask: Bool[np.ndarray, "s s"]) -> Bool[np.ndarray, "16 s s"]:
    """A mask in the 8 symmetries of the square, then the inverse of each."""
    turned = [np.rot90(side, quarter) for side in (mask, mask[:, ::-1]) for quarter in range(4)]
    return np.stack(turned + [~variant for variant in turned])


def drawn_masks(count: int, size: int, *, seed: int) -> Bool[np.ndarray, "count s s"]:
    """Random drawings in all their variants: what is observed.

    Args:
      count: how many masks; the last drawing gives fewer variants where this is no multiple of `VARIANTS`. One drawing
        in 16, of those of more than 240 masks, leaves the map whole.
      size: rows and columns.
      seed: of the drawings.
    """
    rng = np.random.default_rng(seed)
    whole = np.ones((VARIANTS, size, size), bool)
    drawings = [
        mask_variants(_drawing(size, rng)) if number % _DRAWINGS_PER_WHOLE_MAP else whole
        for number in range(1, 1 - (-count // VARIANTS))
    ]
    return np.concatenate([whole[:0], *drawings])[:count]
