"""Metrics of predicted pictures against plain counting."""

import cv2
import jax
import numpy as np
import pytest
from hypothesis import given

from experiments.translator.metrics import compare_images
from tests.support import maps

SHAPE = (8, 9)
measure = jax.jit(lambda predicted, true: compare_images(predicted, true).metrics())
RED, WHITE, GRAY, BLACK = (1.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.5, 0.5, 0.5), (0.0, 0.0, 0.0)


def picture(*colors: tuple[float, float, float]) -> np.ndarray:
    return np.array([colors], np.float32)


def share(part: np.ndarray, whole: np.ndarray) -> float:
    return float((part & whole).sum() / whole.sum()) if whole.any() else np.nan


@given(maps.seeds)
def test_metrics_are_those_of_plain_counting(seed):
    rng = np.random.default_rng(seed)
    gray = rng.choice([0.0, 0.5, 0.89, 0.91, 1.0], (2, *SHAPE))[..., None]
    tint = rng.choice([0.0, 0.1, 0.6], (2, *SHAPE))[..., None] * np.array([0.0, 1.0, 1.0])
    predicted, true = (gray * (1 - tint)).astype(np.float32)
    found = measure(predicted, true)
    sets = []
    for image in (predicted, true):
        hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)
        sets.append(((hsv[..., 2] > 0.9) & (hsv[..., 1] < 0.3), hsv[..., 1] < 0.3))
    (low, drivable), (low_true, drivable_true) = sets
    expected = (
        np.abs(predicted - true).mean(),
        share(low_true, low),
        share(low, low_true),
        share(drivable_true, drivable),
        share(drivable, drivable_true),
    )
    np.testing.assert_allclose(list(found.values()), expected, atol=1e-6)


def test_a_perfect_prediction():
    true = picture(RED, WHITE, GRAY, BLACK)
    assert tuple(map(float, measure(true, true).values())) == (0.0, 1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("predicted", "true", "precision", "recall"),
    [
        ((GRAY, GRAY), (GRAY, GRAY), np.nan, np.nan),  # nothing to find, nothing found
        ((GRAY, GRAY), (WHITE, GRAY), np.nan, 0.0),  # missed
        ((WHITE, GRAY), (GRAY, GRAY), 0.0, np.nan),  # found where there is nothing
        ((RED, RED), (RED, RED), np.nan, np.nan),
        ((WHITE, WHITE), (WHITE, GRAY), 0.5, 1.0),
    ],
)
def test_a_share_of_nothing_is_no_number(predicted, true, precision, recall):
    found = measure(picture(*predicted), picture(*true))
    np.testing.assert_equal((float(found["low_precision"]), float(found["low_recall"])), (precision, recall))


def test_the_l1_error_is_the_mean_over_pixels_and_colors():
    assert float(measure(picture(RED, WHITE), picture(BLACK, WHITE))["l1"]) == pytest.approx(1 / 6)
