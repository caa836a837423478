"""What a robot's software should ask of its camera before a frame goes into the map.

On the host, outside compiled code, where values can be looked at. `dc2g_jax.mapping.semantic_map.integrate` itself
skips what it cannot use and says nothing.
"""

import numpy as np
import numpy.typing as npt

from dc2g_jax.errors import InputError
from dc2g_jax.grid.terrain import CLASS_NAMES
from dc2g_jax.mapping.camera import CameraPose, Frame, Intrinsics, check_shapes
from dc2g_jax.mapping.semantic_map import MapSettings

#: How far the product of a rotation with its own transpose may be from the identity; single precision is well within.
_ROTATION_TOLERANCE = 1e-3


def check_frame(frame: Frame, intrinsics: Intrinsics, settings: MapSettings) -> None:
    """Refuse a frame that has something wrong with it.

    Raises:
      InputError: the intrinsics form no image, the pose is none or off the map, the images are not the camera's, a
        depth is negative or not finite, or a class does not exist.
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
        f"give class indices from 0 (no label) to {len(CLASS_NAMES) - 1}, see dc2g_jax.grid.terrain.CLASS_NAMES",
    )


def check_intrinsics(intrinsics: Intrinsics) -> None:
    """Refuse intrinsics that form no image.

    Raises:
      InputError: a focal length is not positive, a number not finite, or the image has no pixels.
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
    """Refuse a pose at which no camera over the map can be.

    Raises:
      InputError: the position is not above the map, or the rotation is none.
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
            f"rotation is none: its rows are off by {error:.2g} from being of unit length and at right angles; give an "
            "orthonormal matrix"
        )
    if np.linalg.det(rotation) < 0:
        raise InputError(
            "rotation is a reflection (its determinant is -1); give the camera's axes right, down and forward, in this "
            "order, as columns"
        )


def _finite(name: str, values: npt.ArrayLike, shape: tuple[int, ...], remedy: str) -> np.ndarray:
    """The numbers, if they are so many and finite."""
    array = np.asarray(values, np.float64)
    if array.shape != shape:
        raise InputError(f"{name} has shape {array.shape}, not {shape}; {remedy}, for one camera")
    if not np.isfinite(array).all():
        raise InputError(f"{name} is {array.tolist()}, not finite; {remedy}")
    return array


def _refuse_pixels(name: str, values: np.ndarray, wrong: np.ndarray, remedy: str) -> None:
    """Refuse an image in which something is wrong, and name the first place."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        count = f"one of {wrong.sum()} such pixels of {wrong.size}"
        raise InputError(f"{name}[{row}, {column}] is {values[row, column]}, {count}; {remedy}")
