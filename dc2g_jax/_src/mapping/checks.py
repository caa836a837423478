"""Checks of frames, intrinsics and poses that a robot should run before it integrates a frame into the map.

They run on the host, outside compiled code, because they look at values. `mapping.semantic_map.integrate`
itself silently skips pixels that it cannot use.
"""

import numpy as np
import numpy.typing as npt

from dc2g_jax._src.errors import InputError
from dc2g_jax._src.grid.terrain import CLASS_NAMES
from dc2g_jax._src.mapping.camera import CameraPose, Frame, Intrinsics, check_shapes
from dc2g_jax._src.mapping.semantic_map import MapSettings

#: Largest deviation of a rotation times its transpose from the identity; errors of single precision are far smaller.
_ROTATION_TOLERANCE = 1e-3


def check_frame(frame: Frame, intrinsics: Intrinsics, settings: MapSettings) -> None:
    """Check a frame.

    Raises:
      InputError: the intrinsics or the pose are invalid, the pose is off the map, an image does not have the camera's
        size, a depth is negative or not finite, or a class does not exist.
    """
    check_intrinsics(intrinsics)
    check_pose(frame.pose, settings)
    check_shapes(frame, intrinsics)
    depth, classes = np.asarray(frame.depth), np.asarray(frame.classes)
    if not np.issubdtype(depth.dtype, np.floating):
        raise InputError(f"depth has dtype {depth.dtype}; give meters as floating-point numbers")
    _refuse_pixels("depth", depth, ~np.isfinite(depth) | (depth < 0), "give meters, and 0 where nothing came back")
    if classes.dtype != np.uint8:
        raise InputError(f"classes has dtype {classes.dtype}; give class indices as uint8, 0 where there is no label")
    _refuse_pixels(
        "classes",
        classes,
        classes >= len(CLASS_NAMES),
        f"give class indices from 0 (no label) to {len(CLASS_NAMES) - 1}, see dc2g_jax._src.grid.terrain.CLASS_NAMES",
    )


def check_intrinsics(intrinsics: Intrinsics) -> None:
    """Check the intrinsics of a camera.

    Raises:
      InputError: a focal length is not positive, a number is not finite, or the image has no pixels.
    """
    for name in ("focal_x", "focal_y"):
        focal = _finite(name, getattr(intrinsics, name), (), "give pixels, above 0")
        if focal <= 0:
            raise InputError(f"{name} is {focal}; give pixels, above 0")
    for name in ("center_x", "center_y"):
        _finite(name, getattr(intrinsics, name), (), "give the principal point in pixels")
    for name in ("height", "width"):
        if getattr(intrinsics, name) <= 0:
            raise InputError(f"the image's {name} is {getattr(intrinsics, name)}; give pixels, above 0")


def check_pose(pose: CameraPose, settings: MapSettings) -> None:
    """Check that a pose is a rotation and a position above the map.

    Raises:
      InputError: the position is not above the map, or the rotation is not a rotation matrix.
    """
    x, y, z = _finite("position", pose.position, (3,), "give x, y and z in meters")
    east, south = settings.columns * settings.cell_size, settings.rows * settings.cell_size
    if not (0 <= x <= east and -south <= y <= 0):
        raise InputError(
            f"the camera is at x {x:g}, y {y:g}, off the map of x 0 to {east:g} and y {-south:g} to 0; give meters "
            "in the map's frame, whose y is 0 above the first row and falls from row to row"
        )
    if z <= 0:
        raise InputError(f"the camera is at z {z:g}, not above the ground; give its height over z = 0 in meters")
    rotation = _finite("rotation", pose.rotation, (3, 3), "give the rotation from camera to world")
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ROTATION_TOLERANCE:
        raise InputError(
            f"rotation is not orthonormal: its rows are off by {error:.2g} from unit length and right angles; give an "
            "orthonormal matrix"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            "rotation is a reflection (its determinant is -1); give the camera's axes right, down and forward, in this "
            "order, as columns"
        )


def _finite(name: str, values: npt.ArrayLike, shape: tuple[int, ...], remedy: str) -> np.ndarray:
    """The numbers as an array, checked to have the shape and to be finite."""
    array = np.asarray(values, np.float64)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, not {shape}; {remedy}, for one camera")
    if not np.isfinite(array).all():
        raise InputError(f"{name} is {array.tolist()}, not finite; {remedy}")
    return array


def _refuse_pixels(name: str, values: np.ndarray, wrong: np.ndarray, remedy: str) -> None:
    """Reject an image with wrong pixels; the message names the first of them."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        count = f"one of {wrong.sum()} such pixels of {wrong.size}"
        raise InputError(f"{name}[{row}, {column}] is {values[row, column]}, {count}; {remedy}")
