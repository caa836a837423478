"""Pinhole cameras: intrinsics, poses, and the points in the world that pixels of depth images show.

World frame, right-handed, meters: x along the map's columns, y against its rows, z up; the ground is z = 0. The center
of the cell in column c and row r is x = (c + 0.5) cell_size, y = -(r + 0.5) cell_size.

Camera frame, as in OpenCV and ROS: x right, y down, z forward. Pixel (u, v) is column and row; centers of pixels have
integer coordinates. The ray of a pixel is ((u - center_x) / focal_x, (v - center_y) / focal_y, 1). Depth is measured
along the optical axis.

All functions take one camera; use `jax.vmap` for batches.
"""

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt8

from dc2g_jax.runtime import InputError


@struct.dataclass
class Intrinsics:
    """Intrinsics of a pinhole camera without distortion.

    Attributes:
      focal_x: focal length along a row, pixels.
      focal_y: focal length along a column, pixels.
      center_x: column of the principal point, pixels.
      center_y: row of the principal point, pixels.
      height: rows of the image.
      width: columns of the image.
    """

    focal_x: Float[Array, ""]
    focal_y: Float[Array, ""]
    center_x: Float[Array, ""]
    center_y: Float[Array, ""]
    height: int = struct.field(pytree_node=False)
    width: int = struct.field(pytree_node=False)


@struct.dataclass
class CameraPose:
    """Position and orientation of a camera.

    Attributes:
      position: position of the camera in the world, meters.
      rotation: rotation from camera frame to world frame; its columns are the camera's axes right, down and forward.
    """

    position: Float[Array, "3"]
    rotation: Float[Array, "3 3"]


@struct.dataclass
class Frame:
    """Depth image, class image and pose of one moment.

    Attributes:
      depth: depth along the optical axis, meters; 0 for pixels without return.
      classes: class index of each pixel, see `grid.CLASS_NAMES`; 0 without label.
      pose: pose of the camera.
    """

    depth: Float[Array, "h w"]
    classes: UInt8[Array, "h w"]
    pose: CameraPose


def intrinsics(field_of_view_degrees: float, height: int, width: int) -> Intrinsics:
    """A camera with square pixels and the principal point in the middle of the image.

    Args:
      field_of_view_degrees: angle between the outer edges of the first and the last column, above 0 and below 180.
      height: rows of the image.
      width: columns of the image.
    """
    focal = width / 2 / jnp.tan(jnp.radians(jnp.float32(field_of_view_degrees)) / 2)
    return Intrinsics(
        focal_x=focal,
        focal_y=focal,
        center_x=jnp.float32((width - 1) / 2),
        center_y=jnp.float32((height - 1) / 2),
        height=height,
        width=width,
    )


def level_camera(x: ArrayLike, y: ArrayLike, z: ArrayLike, yaw: ArrayLike, pitch: ArrayLike = 0.0) -> CameraPose:
    """The pose of a camera without roll.

    Args:
      x: position in the world, meters.
      y: position in the world, meters.
      z: height above the ground, meters.
      yaw: viewing direction, counter-clockwise from +x, radians.
      pitch: downward tilt, radians.
    """
    yaw, pitch = jnp.asarray(yaw, jnp.float32), jnp.asarray(pitch, jnp.float32)
    along, across = jnp.cos(yaw), jnp.sin(yaw)
    level, down = jnp.cos(pitch), jnp.sin(pitch)
    axes = (
        (across, -along, jnp.zeros_like(yaw)),
        (-along * down, -across * down, -level),
        (along * level, across * level, -down),
    )
    return CameraPose(
        position=jnp.stack([jnp.asarray(value, jnp.float32) for value in (x, y, z)]),
        rotation=jnp.stack([jnp.stack(axis) for axis in axes], axis=-1),
    )


def rays(intrinsics: Intrinsics, pose: CameraPose) -> Float[Array, "h w 3"]:
    """The viewing direction of each pixel in the world, not normalized: point = position + depth * ray."""
    right = (jnp.arange(intrinsics.width) - intrinsics.center_x) / intrinsics.focal_x
    down = (jnp.arange(intrinsics.height) - intrinsics.center_y) / intrinsics.focal_y
    # Written out because GPUs round matrix products to fewer bits.
    x_axis, y_axis, z_axis = pose.rotation.T
    return right[None, :, None] * x_axis + down[:, None, None] * y_axis + z_axis


def points(frame_depth: Float[Array, "h w"], intrinsics: Intrinsics, pose: CameraPose) -> Float[Array, "h w 3"]:
    """The point in the world that each pixel shows, meters; the camera's position where depth is 0, without return."""
    return frame_depth[..., None] * rays(intrinsics, pose) + pose.position


def check_shapes(frame: Frame, intrinsics: Intrinsics) -> None:
    """Check that the images of a frame have the camera's size. Works under `jit`: it looks at shapes only.

    Raises:
      InputError: depth or classes do not have one value per pixel.
    """
    image = (intrinsics.height, intrinsics.width)
    for name, values in (("depth", frame.depth), ("classes", frame.classes)):
        if values.shape != image:
            raise InputError(f"{name} has shape {values.shape}, but the camera's images have {image}; give one a pixel")
