"""Cameras and frames that the tests of mapping share."""

import jax.numpy as jnp
import numpy as np

from dc2g_jax.robot.mapping.camera import CameraPose, Frame, Intrinsics
from dc2g_jax.robot.mapping.semantic_map import MapSettings

#: A small map, its voxels not cubes, no two of its sizes equal. It is larger than the window of a camera.
SETTINGS = MapSettings(
    rows=17, columns=20, cell_size=0.5, levels=6, level_height=0.4, reach=3.1, inset=0.03, clearance=1.3
)

#: The same with more and smaller voxels.
FINE = MapSettings(
    rows=23, columns=26, cell_size=0.3, levels=7, level_height=0.25, reach=2.9, inset=0.02, clearance=1.0
)

#: A camera that is the same in nothing along rows and along columns.
CAMERA = Intrinsics(
    focal_x=jnp.float32(19.0),
    focal_y=jnp.float32(23.0),
    center_x=jnp.float32(14.3),
    center_y=jnp.float32(8.9),
    height=18,
    width=28,
)

#: From the axes of the camera to those of a world that it looks into along +x, level.
_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def camera_matrix(intrinsics: Intrinsics) -> np.ndarray:
    return np.array(
        [
            [float(intrinsics.focal_x), 0.0, float(intrinsics.center_x)],
            [0.0, float(intrinsics.focal_y), float(intrinsics.center_y)],
            [0.0, 0.0, 1.0],
        ]
    )


def turned(rng: np.random.Generator) -> np.ndarray:
    """A random rotation, mostly to the north-east and not upside down."""
    yaw, pitch, roll = rng.normal([0.6, 0.0, 0.0], [1.0, 0.4, 0.4])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    return about_z @ about_y @ about_x @ _LEVEL


def random_frame(rng: np.random.Generator, settings: MapSettings = SETTINGS, camera: Intrinsics = CAMERA) -> Frame:
    """Slanted surfaces with noise and holes, labels in patches with noise, mostly from near the middle of the map."""
    shape = (camera.height, camera.width)
    row, column = np.mgrid[: shape[0], : shape[1]]
    slope_down, slope_right = rng.uniform(-0.08, 0.08, 2)
    depth = rng.uniform(1.0, settings.reach) + slope_down * (row - 9) + slope_right * (column - 14)
    depth[:, rng.integers(shape[1]) :] *= rng.uniform(0.5, 1.5)
    depth += rng.normal(0, 0.05, shape)
    garbage = rng.choice([0.0, -1.0, np.nan, np.inf, -np.inf, 1e30], shape)
    depth = np.where(rng.random(shape) < 0.05, garbage, depth)
    classes = rng.choice([0, 2, 3, 3, 7, 7], (3, 4)).repeat(6, axis=0).repeat(7, axis=1)
    classes = np.where(rng.random(shape) < 0.2, rng.choice([0, 1, 5, 12, 15, 16, 255], shape), classes)
    east, south = settings.columns * settings.cell_size, settings.rows * settings.cell_size
    position = rng.normal([east / 2, -south / 2, 1.0], [east / 6, south / 6, 0.3])
    return Frame(
        depth=jnp.asarray(depth, jnp.float32),
        classes=jnp.asarray(classes, jnp.uint8),
        pose=CameraPose(jnp.asarray(position, jnp.float32), jnp.asarray(turned(rng), jnp.float32)),
    )
