"""Pinhole cameras: what a pixel of a depth image says about the world.

World frame, right-handed, meters: x along the map's columns, y against its rows, z up; the ground is z = 0. The center
of the cell in column c and row r is x = (c + 0.5) cell_size, y = -(r + 0.5) cell_size.

Camera frame, as in OpenCV and ROS: x right, y down, z forward. Pixel (u, v) is column and row, its center lies at whole
numbers, and its ray is ((u - center_x) / focal_x, (v - center_y) / focal_y, 1). Depth is measured along the optical
axis.

All functions are for one camera; `jax.vmap` makes them take many.
"""

import jax.numpy as jnp
from flax import struct
from jax.typing import ArrayLike
from jaxtyping import Array, Float, UInt8

from dc2g_jax.errors import InputError


@struct.dataclass
class Intrinsics:
    """How a camera without distortion forms its image.

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
    """Where a camera is and how it is turned.

    Attributes:
      position: of the camera in the world, meters.
      rotation: from the camera's frame to the world's; its columns are the camera's axes right, down and forward.
    """

    position: Float[Array, "3"]
    rotation: Float[Array, "3 3"]


@struct.dataclass
class Frame:
    """What a camera delivers at one moment.

    Attributes:
      depth: along the optical axis, meters; 0 where nothing came back.
      classes: class index of each pixel, see `dc2g_jax.grid.terrain`; 0 where it is not labeled.
      pose: where the camera was.
    """

    depth: Float[Array, "h w"]
    classes: UInt8[Array, "h w"]
    pose: CameraPose


def intrinsics(field_of_view_degrees: float, height: int, width: int) -> Intrinsics:
    """A camera with square pixels and the principal point in the middle of the image.

    Args:
      field_of_view_degrees: between the outer edges of the first and of the last column, above 0 and below 180.
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
    """A camera that is not tilted sideways.

    Args:
      x: of the camera in the world, meters.
      y: meters.
      z: height above the ground, meters.
      yaw: where it looks, counter-clockwise from +x, radians.
      pitch: how far it looks down, radians.
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
    """The direction in which each pixel looks, in the world, not normalized: depth times ray + position = point."""
    right = (jnp.arange(intrinsics.width) - intrinsics.center_x) / intrinsics.focal_x
    down = (jnp.arange(intrinsics.height) - intrinsics.center_y) / intrinsics.focal_y
    # Written out: a matrix product is rounded to fewer bits on GPUs.
    x_axis, y_axis, z_axis = pose.rotation.T
    return right[None, :, None] * x_axis + down[:, None, None] * y_axis + z_axis


def points(frame_depth: Float[Array, "h w"], intrinsics: Intrinsics, pose: CameraPose) -> Float[Array, "h w 3"]:
    """The point in the world that each pixel shows, meters.

    Args:
      frame_depth: along the optical axis, meters. The point of a pixel without return (0) is the camera's own.
      intrinsics: of the camera that took it.
      pose: of that camera.
    """
    return frame_depth[..., None] * rays(intrinsics, pose) + pose.position


def check_shapes(frame: Frame, intrinsics: Intrinsics) -> None:
    """Refuse a frame whose images are not those of the camera. Shapes are known before anything is computed.

    Raises:
      InputError: depth or classes are not one value a pixel.
    """
    image = (intrinsics.height, intrinsics.width)
    for name, values in (("depth", frame.depth), ("classes", frame.classes)):
        if values.shape != image:
            raise InputError(f"{name} has shape {values.shape}, but the camera's images have {image}; give one a pixel")
