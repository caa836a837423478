"""What is wrong with a real camera and a real pose estimate: pure functions of a key and of how much of it there is.

All functions are for one camera; `jax.vmap` makes them take many. Levels are values, not shapes: they can be swept
without compiling anew.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Key, UInt8

from dc2g_jax.grid.terrain import FRONT_DOOR, SIDEWALK
from dc2g_jax.mapping.camera import CameraPose, Frame

#: What a wrong label may say: the classes from front door to sidewalk, which are those of the published houses.
_FIRST_WRONG, _WRONG_LABELS = FRONT_DOOR, SIDEWALK - FRONT_DOOR + 1

#: The most blobs in a frame.
_MOST_BLOBS = 8


@struct.dataclass
class NoiseLevels:
    """How much is wrong; nothing where all are 0, and then frames and poses are what they were, bit for bit.

    Attributes:
      depth: standard deviation of a depth of 1 m, meters; it grows with the square of the depth, as it does for stereo
        and for structured light.
      mislabeled: share of the labeled pixels that bear a wrong class, each for itself.
      blobs: regions in a frame that bear a wrong class as a whole: how many there are on average, at most 8. Those
        that fall where nothing is labeled are not seen.
      blob_radius: mean radius of those regions as a share of the image's width.
      dropped: share of the pixels without depth and label.
      position_drift: standard deviation of what a step adds to the error in x, and in y, meters.
      yaw_drift: standard deviation of what a step adds to the error in yaw, radians.
    """

    depth: ArrayLike = 0.0
    mislabeled: ArrayLike = 0.0
    blobs: ArrayLike = 0.0
    blob_radius: ArrayLike = 0.08
    dropped: ArrayLike = 0.0
    position_drift: ArrayLike = 0.0
    yaw_drift: ArrayLike = 0.0


#: A robot like the paper's may be. The paper gives no figures, only that its maps are "much noisier" than the perfect
#: ones (section IV-D). Depth is the Kinect's: 4 cm at 5 m (Khoshelham and Elberink 2012). The rest is set by hand: one
#: confused surface in a frame, and a pose that drifts by a hundredth of the way.
PAPER_LIKE = NoiseLevels(depth=0.0016, mislabeled=0.02, blobs=1.0, dropped=0.05, position_drift=0.01, yaw_drift=0.0035)

#: What that leaves in a map from many frames, about: one cell in a hundred has a wrong class and a few next to each
#: other do, and one in a hundred has never been made out.
IN_MAPS = NoiseLevels(mislabeled=0.01, blobs=1.0, blob_radius=0.03, dropped=0.01)


def scaled(levels: NoiseLevels, level: ArrayLike) -> NoiseLevels:
    """So many times as much of everything: 0 for none, 1 for these levels. Blobs grow in number, not in size."""
    return dataclasses.replace(jax.tree.map(lambda amount: amount * level, levels), blob_radius=levels.blob_radius)


def noisy_frame(key: Key[Array, ""], frame: Frame, levels: NoiseLevels) -> Frame:
    """The frame with noise on its depth, wrong labels and missing pixels. Its pose stays: see `drifted`.

    Pixels without depth or label get none. A depth that noise would make negative is dropped.
    """
    depth_key, label_key, drop_key = jax.random.split(key, 3)
    spread = levels.depth * frame.depth**2
    depth = frame.depth + spread * jax.random.normal(depth_key, frame.depth.shape)
    kept = (depth > 0) & ~_chance(drop_key, levels.dropped, frame.depth.shape)
    classes = _mislabeled(label_key, frame.classes, levels)
    return dataclasses.replace(
        frame,
        depth=jnp.where(kept, depth, 0),
        classes=jnp.where(kept | (frame.depth == 0), classes, 0).astype(jnp.uint8),
    )


def noisy_map(key: Key[Array, ""], terrain: UInt8[Array, "h w"], levels: NoiseLevels) -> UInt8[Array, "h w"]:
    """A map with wrong classes and missing cells; what has not been observed stays so.

    Args:
      key: of the random numbers.
      terrain: class index of every cell, 0 where it has not been observed.
      levels: of noise; of these, only what is wrong with labels and what is dropped matters.
    """
    label_key, drop_key = jax.random.split(key)
    missing = _chance(drop_key, levels.dropped, terrain.shape)
    return jnp.where(missing, jnp.uint8(0), _mislabeled(label_key, terrain, levels))


def _chance(key: Key[Array, ""], share: ArrayLike, shape: tuple[int, ...]) -> Bool[Array, "..."]:
    """True for about this share of all; for none at all where it is 0."""
    return jax.random.uniform(key, shape) < share


def _wrong(key: Key[Array, ""], classes: UInt8[Array, "*shape"]) -> UInt8[Array, "*shape"]:
    """For each class another one of those that things are taken for, all of these alike."""
    is_one = (classes >= _FIRST_WRONG) & (classes < _FIRST_WRONG + _WRONG_LABELS)
    shift = jax.random.randint(key, classes.shape, jnp.where(is_one, 1, 0), _WRONG_LABELS)
    wrong = _FIRST_WRONG + (classes.astype(jnp.int32) - _FIRST_WRONG + shift) % _WRONG_LABELS
    return wrong.astype(jnp.uint8)


def _mislabeled(key: Key[Array, ""], classes: UInt8[Array, "h w"], levels: NoiseLevels) -> UInt8[Array, "h w"]:
    """The classes with blobs and single pixels of wrong ones; pixels without label stay so."""
    blob_key, place_key, wrong_key = jax.random.split(key, 3)

    def add_blob(labels: UInt8[Array, "h w"], key: Key[Array, ""]) -> tuple[UInt8[Array, "h w"], None]:
        region, wrong = _blob(key, classes, levels)
        return jnp.where(region, wrong, labels), None

    labels, _ = jax.lax.scan(add_blob, classes, jax.random.split(blob_key, _MOST_BLOBS))
    alone = _chance(place_key, levels.mislabeled, classes.shape)
    return jnp.where(alone, _wrong(wrong_key, classes), labels) * (classes > 0)


def _blob(
    key: Key[Array, ""], classes: UInt8[Array, "h w"], levels: NoiseLevels
) -> tuple[Bool[Array, "h w"], UInt8[Array, ""]]:
    """A region that is taken for something else, and for what: the pixels around one that show the same class.

    Empty in all but a share of `blobs / _MOST_BLOBS` of the cases.
    """
    happens_key, place_key, size_key, wrong_key = jax.random.split(key, 4)
    height, width = classes.shape
    row, column = jax.random.randint(place_key, (2,), 0, jnp.array([height, width]))
    radius = levels.blob_radius * width * jax.random.uniform(size_key, minval=0.5, maxval=1.5)
    near = jnp.hypot(jnp.arange(height)[:, None] - row, jnp.arange(width) - column) <= radius
    here = classes[row, column]
    happens = _chance(happens_key, levels.blobs / _MOST_BLOBS, ())
    return near & (classes == here) & happens, _wrong(wrong_key, here)


@struct.dataclass
class PoseDrift:
    """How wrong a robot is about where it is.

    Attributes:
      x: meters.
      y: meters.
      yaw: counter-clockwise, radians.
    """

    x: Float[Array, ""]
    y: Float[Array, ""]
    yaw: Float[Array, ""]


def no_drift() -> PoseDrift:
    """A robot that knows where it is."""
    return PoseDrift(x=jnp.float32(0), y=jnp.float32(0), yaw=jnp.float32(0))


def drift_on(key: Key[Array, ""], drift: PoseDrift, levels: NoiseLevels) -> PoseDrift:
    """The drift one step later: a random walk in x, y and yaw."""
    x, y, yaw = jax.random.normal(key, (3,))
    return PoseDrift(
        x=drift.x + levels.position_drift * x,
        y=drift.y + levels.position_drift * y,
        yaw=drift.yaw + levels.yaw_drift * yaw,
    )


def drifted(pose: CameraPose, drift: PoseDrift) -> CameraPose:
    """Where a robot thinks its camera is, when it is at this pose: turned on the spot about the vertical, and moved."""
    along, across = jnp.cos(drift.yaw), jnp.sin(drift.yaw)
    # Written out: a matrix product is rounded to fewer bits on GPUs.
    east, north, up = pose.rotation
    return CameraPose(
        position=pose.position + jnp.stack([drift.x, drift.y, jnp.zeros_like(drift.x)]),
        rotation=jnp.stack([along * east - across * north, across * east + along * north, up]),
    )
