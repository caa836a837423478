"""Quaternions x, y, z, w with w = cos(angle / 2), as files and simulators write them. NumPy, on the host."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from dc2g_jax._src.errors import InputError

#: A shorter quaternion is rejected as zero.
_SHORTEST = 1e-6


def rotation_from_quaternion(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation matrix of a quaternion x, y, z, w of any length but zero.

    Raises:
      InputError: the quaternion is zero or not finite.
    """
    length = np.linalg.norm(quaternion)
    if not _SHORTEST < length < np.inf:
        raise InputError(f"the quaternion {quaternion.tolist()} has length {length:g}; give one of length 1")
    return np.asarray(Rotation.from_quat(quaternion).as_matrix())


def quaternion_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """The quaternion x, y, z, w of length 1, w not negative, nearest to a rotation matrix."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))
