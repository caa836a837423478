"""Rotations as files and simulators write them: quaternions x, y, z, w with w = cos(angle / 2). On the host, NumPy."""

import numpy as np
from jaxtyping import Float

from dc2g_jax.errors import InputError

#: A quaternion shorter than this has no direction.
_SHORTEST = 1e-6


def rotation_from_quaternion(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion x, y, z, w of any length but zero.

    Raises:
      InputError: the quaternion has no length or is not finite.
    """
    length = np.linalg.norm(quaternion)
    if not _SHORTEST < length < np.inf:
        raise InputError(f"the quaternion {quaternion.tolist()} has length {length:g}; give one of length 1")
    x, y, z, w = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """The quaternion x, y, z, w of length 1, w not negative, nearest to a rotation matrix.

    The eigenvector method of Bar-Itzhack (Journal of Guidance, Control, and Dynamics 2000): exact where the matrix is
    a rotation, and without a case that is badly conditioned.
    """
    ((a, b, c), (d, e, f), (g, h, i)) = rotation.astype(np.float64)
    symmetric = np.array(
        [
            [a - e - i, b + d, c + g, h - f],
            [b + d, e - a - i, f + h, c - g],
            [c + g, f + h, i - a - e, d - b],
            [h - f, c - g, d - b, a + e + i],
        ]
    )
    quaternion = np.linalg.eigh(symmetric).eigenvectors[:, -1]
    return -quaternion if quaternion[3] < 0 else quaternion
