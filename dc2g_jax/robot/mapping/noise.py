"""Noise of cameras and pose estimates, as pure functions of a key and noise levels.

All functions take one camera; use `jax.vmap` for batches. Levels are traced values: they can be swept without
recompilation.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Key

from dc2g_jax.grid import NoiseLevels, chance, mislabeled
from dc2g_jax.robot.mapping.camera import CameraPose, Frame

#: Levels of a plausible real robot. The paper gives no figures; it only calls its maps "much noisier" than perfect ones
#: (section IV-D). Depth noise is the Kinect's: 4 cm at 5 m (Khoshelham and Elberink 2012). The rest is set by hand: one
#: confused surface per frame, and a pose that drifts by a hundredth of the distance.
PAPER_LIKE = NoiseLevels(depth=0.0016, mislabeled=0.02, blobs=1.0, dropped=0.05, position_drift=0.01, yaw_drift=0.0035)


def noisy_frame(key: Key[Array, ""], frame: Frame, levels: NoiseLevels) -> Frame:
    """The frame with depth noise, wrong labels and missing pixels. Its pose does not change, see `drifted`.

    Pixels without depth or label stay without it. A depth that noise would make negative is dropped.
    """
    depth_key, label_key, drop_key = jax.random.split(key, 3)
    spread = levels.depth * frame.depth**2
    depth = frame.depth + spread * jax.random.normal(depth_key, frame.depth.shape)
    kept = (depth > 0) & ~chance(drop_key, levels.dropped, frame.depth.shape)
    classes = mislabeled(label_key, frame.classes, levels)
    return dataclasses.replace(
        frame,
        depth=jnp.where(kept, depth, 0),
        classes=jnp.where(kept | (frame.depth == 0), classes, 0).astype(jnp.uint8),
    )


#: Error of a robot's pose estimate: x and y, meters, and yaw, counter-clockwise, radians. At first it is zero.
PoseDrift = Float[Array, "3"]


def drift_on(key: Key[Array, ""], drift: PoseDrift, levels: NoiseLevels, moved: ArrayLike = 1.0) -> PoseDrift:
    """The drift after a motion: a random walk.

    Args:
      key: random key.
      drift: the drift before.
      levels: noise levels.
      moved: the motion: meters driven plus quarter turns.
    """
    spread = jnp.array([levels.position_drift, levels.position_drift, levels.yaw_drift], jnp.float32)
    return drift + spread * (jnp.sqrt(moved) * jax.random.normal(key, (3,)))


def drifted(pose: CameraPose, drift: PoseDrift) -> CameraPose:
    """The estimated pose of a camera at `pose`: rotated about the vertical axis in place, then translated."""
    x, y, yaw = drift
    along, across = jnp.cos(yaw), jnp.sin(yaw)
    # Written out because GPUs round matrix products to fewer bits.
    east, north, up = pose.rotation
    return CameraPose(
        position=pose.position + jnp.stack([x, y, jnp.zeros_like(x)]),
        rotation=jnp.stack([along * east - across * north, across * east + along * north, up]),
    )
