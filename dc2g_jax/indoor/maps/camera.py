"""The camera of the indoor robot: where it sits, and its pictures of simulated houses."""

import math

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt8

from dc2g_jax.indoor.maps.classes import NO_COLOR
from dc2g_jax.robot import CameraPose, Intrinsics, Scene, cast_all, classes_of, intrinsics, level_camera, rays

#: The camera: height above the floor, meters; angle below the horizon, radians; horizontal field of view, degrees; rows
#: and columns of its depth image. It is as high as on the usual research robots. Level, it would see no floor nearer
#: than 1.2 m and leave a hole in the map around the start. At this angle the floor is in view from 0.6 m on, and walls
#: up to 1.5 m high from 2.0 m on.
INDOOR_CAMERA_HEIGHT, INDOOR_CAMERA_PITCH = 0.9, math.radians(20)
INDOOR_FIELD_OF_VIEW, INDOOR_IMAGE_SIZE = 90.0, (120, 160)

#: Rows and columns of its picture, from which networks take mid-level features.
VIEW_SIZE = (48, 64)

#: Brightness of surfaces by the face that a ray hits: those that face along x, along y, and up.
_LIGHT = (0.82, 0.7, 1.0)


@struct.dataclass
class CameraView:
    """A picture with its ground truth.

    Attributes:
      image: colors.
      depth: depth along the optical axis, meters; 0 where there is nothing.
      classes: class indices of objects; 0 for floor and walls.
    """

    image: UInt8[Array, "*b 48 64 3"]
    depth: Float[Array, "*b 48 64"]
    classes: UInt8[Array, "*b 48 64"]


def indoor_camera() -> Intrinsics:
    """The intrinsics of the camera's depth image."""
    return intrinsics(INDOOR_FIELD_OF_VIEW, *INDOOR_IMAGE_SIZE)


def camera_pose(x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> CameraPose:
    """The pose of the camera of a robot.

    Args:
      x: position of the robot, meters.
      y: position of the robot, meters.
      yaw: direction of the robot, counter-clockwise from +x, radians.
    """
    return level_camera(x, y, INDOOR_CAMERA_HEIGHT, yaw, INDOOR_CAMERA_PITCH)


def view(scene: Scene, paint: UInt8[Array, "h w 3"], pose: CameraPose) -> CameraView:
    """Render the camera's picture in a house with cells of these colors, with unlimited range."""
    hits = cast_all(scene, pose, rays(intrinsics(INDOOR_FIELD_OF_VIEW, *VIEW_SIZE), pose), math.inf)
    light = jnp.asarray(_LIGHT, jnp.float32)[hits.face]
    colors = paint.at[hits.row, hits.column].get(mode="clip") * light[..., None]
    return CameraView(
        image=jnp.where(hits.distance[..., None] > 0, colors, jnp.asarray(NO_COLOR, jnp.float32)).astype(jnp.uint8),
        depth=hits.distance,
        classes=classes_of(scene, hits),
    )
