"""Noise of class labels, as pure functions of a key and noise levels: what errors of a camera leave in a map.

All functions take one image or map; use `jax.vmap` for batches. Levels are traced values: they can be swept without
recompilation.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Key, UInt8

from dc2g_jax._src.grid.terrain import FRONT_DOOR, SIDEWALK

#: Classes of wrong labels: those of the published houses, from front door to sidewalk.
_FIRST_WRONG, _WRONG_LABELS = FRONT_DOOR, SIDEWALK - FRONT_DOOR + 1

#: Largest number of blobs in a frame.
_MOST_BLOBS = 8


@struct.dataclass
class NoiseLevels:
    """Noise levels. Where all are 0, frames and poses do not change by a bit.

    Attributes:
      depth: standard deviation at a depth of 1 m, meters. It grows with the square of the depth, as for stereo cameras
        and structured light.
      mislabeled: share of the labeled pixels that get a wrong class, independently of each other.
      blobs: mean number of regions per frame that get a wrong class as a whole, at most 8. Regions in unlabeled parts
        of the image have no effect.
      blob_radius: mean radius of these regions, as a share of the image's width.
      dropped: share of the pixels that lose depth and label.
      position_drift: standard deviation of the error that each unit of motion adds to x and to y, meters.
      yaw_drift: standard deviation of the error that each unit of motion adds to yaw, radians.
    """

    depth: ArrayLike = 0.0
    mislabeled: ArrayLike = 0.0
    blobs: ArrayLike = 0.0
    blob_radius: ArrayLike = 0.08
    dropped: ArrayLike = 0.0
    position_drift: ArrayLike = 0.0
    yaw_drift: ArrayLike = 0.0


#: Roughly what remains of `PAPER_LIKE` in a map of many frames: one cell in a hundred and one small region have a wrong
#: class, and one cell in a hundred stays unknown.
IN_MAPS = NoiseLevels(mislabeled=0.01, blobs=1.0, blob_radius=0.03, dropped=0.01)


def scaled(levels: NoiseLevels, level: ArrayLike) -> NoiseLevels:
    """All levels multiplied by `level`: 0 for no noise, 1 for no change. Blobs grow in number, not in size."""
    return dataclasses.replace(jax.tree.map(lambda amount: amount * level, levels), blob_radius=levels.blob_radius)


def noisy_map(key: Key[Array, ""], terrain: UInt8[Array, "h w"], levels: NoiseLevels) -> UInt8[Array, "h w"]:
    """The map with wrong classes and missing cells. Cells of class 0, which are unobserved, stay so."""
    label_key, drop_key = jax.random.split(key)
    missing = chance(drop_key, levels.dropped, terrain.shape)
    return jnp.where(missing, jnp.uint8(0), mislabeled(label_key, terrain, levels))


def chance(key: Key[Array, ""], share: ArrayLike, shape: tuple[int, ...]) -> Bool[Array, "..."]:
    """True with probability `share`, for each element independently; never where the share is 0."""
    return jax.random.uniform(key, shape) < share


def _wrong(key: Key[Array, ""], classes: UInt8[Array, "*shape"]) -> UInt8[Array, "*shape"]:
    """For each class a different one among the classes of wrong labels, uniformly distributed."""
    is_one = (classes >= _FIRST_WRONG) & (classes < _FIRST_WRONG + _WRONG_LABELS)
    shift = jax.random.randint(key, classes.shape, jnp.where(is_one, 1, 0), _WRONG_LABELS)
    wrong = _FIRST_WRONG + (classes.astype(jnp.int32) - _FIRST_WRONG + shift) % _WRONG_LABELS
    return wrong.astype(jnp.uint8)


def mislabeled(key: Key[Array, ""], classes: UInt8[Array, "h w"], levels: NoiseLevels) -> UInt8[Array, "h w"]:
    """The classes with wrong blobs and wrong single pixels; unlabeled pixels stay unlabeled."""
    blob_key, place_key, wrong_key = jax.random.split(key, 3)

    def add_blob(labels: UInt8[Array, "h w"], key: Key[Array, ""]) -> tuple[UInt8[Array, "h w"], None]:
        region, wrong = _blob(key, classes, levels)
        return jnp.where(region, wrong, labels), None

    labels, _ = jax.lax.scan(add_blob, classes, jax.random.split(blob_key, _MOST_BLOBS))
    alone = chance(place_key, levels.mislabeled, classes.shape)
    return jnp.where(alone, _wrong(wrong_key, classes), labels) * (classes > 0)


def _blob(
    key: Key[Array, ""], classes: UInt8[Array, "h w"], levels: NoiseLevels
) -> tuple[Bool[Array, "h w"], UInt8[Array, ""]]:
    """A mislabeled region and its wrong class: the pixels around a random one that show the same class as it.

    The region is non-empty with probability `blobs / _MOST_BLOBS` only.
    """
    happens_key, place_key, size_key, wrong_key = jax.random.split(key, 4)
    height, width = classes.shape
    row, column = jax.random.randint(place_key, (2,), 0, jnp.array([height, width]))
    radius = levels.blob_radius * width * jax.random.uniform(size_key, minval=0.5, maxval=1.5)
    near = jnp.hypot(jnp.arange(height)[:, None] - row, jnp.arange(width) - column) <= radius
    here = classes[row, column]
    happens = chance(happens_key, levels.blobs / _MOST_BLOBS, ())
    return near & (classes == here) & happens, _wrong(wrong_key, here)
