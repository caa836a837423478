"""Similarity of a map to the training maps: bags of visual words (section IV-A3)."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from dc2g_jax._src.grid.terrain import CLASS_NAMES

#: Words in the vocabulary, as in the paper.
VOCABULARY = 20

#: Number of patches along each side of a map.
_PATCHES = 16

_SEED, _ATTEMPTS, _ITERATIONS = 0, 10, 200


class _SimilarityScale(NamedTuple):
    """The training maps as bags of words.

    Attributes:
      vocabulary: the words: color histograms of kinds of patches, each with sum 1.
      bags: frequency of each word in each training map, with sum 1 over the words.
    """

    vocabulary: Float[np.ndarray, "words classes"]
    bags: Float[np.ndarray, "maps words"]


def patch_histograms(terrain: UInt8[np.ndarray, "s s"]) -> Float[np.ndarray, "patches classes"]:
    """The color histogram of every patch of a map, with sum 1. Each class is one color.

    Raises:
      ValueError: if the map cannot be divided into patches of equal size.
    """
    size = len(terrain)
    if size % _PATCHES:
        raise ValueError(f"a map with sides of {size} cells cannot be divided into {_PATCHES} equal patches per side")
    side = size // _PATCHES
    patches = terrain.reshape(_PATCHES, side, _PATCHES, side).transpose(0, 2, 1, 3).reshape(-1, side * side)
    return np.stack([np.mean(patches == index, axis=1) for index in range(len(CLASS_NAMES))], axis=1, dtype=np.float32)


def _bag(
    terrain: UInt8[np.ndarray, "s s"], vocabulary: Float[np.ndarray, "words classes"]
) -> Float[np.ndarray, "words"]:
    """Frequency of each word in a map, with sum 1."""
    distance = np.linalg.norm(patch_histograms(terrain)[:, None] - vocabulary, axis=-1)
    return np.bincount(np.argmin(distance, axis=1), minlength=len(vocabulary)) / _PATCHES**2


def similarity_scale(training: UInt8[np.ndarray, "maps s s"]) -> _SimilarityScale:
    """Learn the vocabulary from the training maps by k-means. The result is deterministic."""
    features = np.concatenate([patch_histograms(terrain) for terrain in training])
    words = min(VOCABULARY, len(np.unique(features, axis=0)))
    cv2.setRNGSeed(_SEED)
    until = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, _ITERATIONS, 1e-5)
    centers = cv2.kmeans(features, words, None, until, _ATTEMPTS, cv2.KMEANS_PP_CENTERS)[2]  # type: ignore[call-overload]
    return _SimilarityScale(centers, np.stack([_bag(terrain, centers) for terrain in training]))


def distance_to_training(terrain: UInt8[np.ndarray, "s s"], scale: _SimilarityScale) -> float:
    """Distance of a map to the most similar training map: 0 for equal bags of words, 1 for no word in common.

    This is half the L1 distance between the bags, both of sum 1. The paper calls it the similarity score.
    """
    return float(np.min(np.abs(scale.bags - _bag(terrain, scale.vocabulary)).sum(axis=1)) / 2)
