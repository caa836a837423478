"""How much a map has in common with the training maps: bags of visual words (section IV-A3)."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from dc2g_jax.grid.terrain import CLASS_NAMES

#: Words in the vocabulary, as in the paper.
VOCABULARY = 20

#: A map is broken into this many patches along each side.
_PATCHES = 16

_SEED, _ATTEMPTS, _ITERATIONS = 0, 10, 200


class SimilarityScale(NamedTuple):
    """The training maps as bags of words.

    Attributes:
      vocabulary: color histograms that stand for the kinds of patches there are, each with sum 1.
      bags: how often each word occurs in each training map, with sum 1 over the words.
    """

    vocabulary: Float[np.ndarray, "words classes"]
    bags: Float[np.ndarray, "maps words"]


def patch_histograms(terrain: UInt8[np.ndarray, "s s"]) -> Float[np.ndarray, "patches classes"]:
    """The color histogram of every patch of a map, with sum 1; a class is a color.

    Raises:
      ValueError: if the map cannot be broken into patches of equal size.
    """
    size = len(terrain)
    if size % _PATCHES:
        raise ValueError(f"a map of {size} cells a side cannot be broken into {_PATCHES} equal patches a side")
    side = size // _PATCHES
    patches = terrain.reshape(_PATCHES, side, _PATCHES, side).transpose(0, 2, 1, 3).reshape(-1, side * side)
    return np.stack([np.mean(patches == index, axis=1) for index in range(len(CLASS_NAMES))], axis=1, dtype=np.float32)


def _bag(
    terrain: UInt8[np.ndarray, "s s"], vocabulary: Float[np.ndarray, "words classes"]
) -> Float[np.ndarray, "words"]:
    """How often each word occurs in a map, with sum 1."""
    distance = np.linalg.norm(patch_histograms(terrain)[:, None] - vocabulary, axis=-1)
    return np.bincount(np.argmin(distance, axis=1), minlength=len(vocabulary)) / _PATCHES**2


def similarity_scale(training: UInt8[np.ndarray, "maps s s"]) -> SimilarityScale:
    """Learn the words from the training maps by k-means, the same way every time."""
    features = np.concatenate([patch_histograms(terrain) for terrain in training])
    words = min(VOCABULARY, len(np.unique(features, axis=0)))
    cv2.setRNGSeed(_SEED)
    until = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, _ITERATIONS, 1e-5)
    centers = cv2.kmeans(features, words, None, until, _ATTEMPTS, cv2.KMEANS_PP_CENTERS)[2]  # type: ignore[call-overload]
    return SimilarityScale(centers, np.stack([_bag(terrain, centers) for terrain in training]))


def distance_to_training(terrain: UInt8[np.ndarray, "s s"], scale: SimilarityScale) -> float:
    """Distance of a map from the most similar training map: 0 for the same bag of words, 1 for no word in common.

    The paper calls it the similarity score; half the L1 distance between bags, which both have the sum 1.
    """
    return float(np.min(np.abs(scale.bags - _bag(terrain, scale.vocabulary)).sum(axis=1)) / 2)
