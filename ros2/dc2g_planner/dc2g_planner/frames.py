"""The tree of coordinate frames of a robot, from the messages of tf2."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from .planner_process import MapPose, Refused

_Matrix = npt.NDArray[np.float64]


def _matrix_of(transform: Any) -> _Matrix:
    """A `geometry_msgs/Transform` as a 4 x 4 matrix. An unset quaternion, all zeros, is no rotation."""
    at, turn = transform.translation, transform.rotation
    length = math.hypot(turn.x, turn.y, turn.z, turn.w) or 1.0
    x, y, z, w = turn.x / length, turn.y / length, turn.z / length, turn.w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), at.x],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), at.y],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), at.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


class Frames:
    """The frames seen so far, each with its parent. The transform that came last counts, whatever its stamp."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, _Matrix]] = {}

    def see(self, message: Any) -> None:
        """Take in a `tf2_msgs/TFMessage`."""
        for each in message.transforms:
            frame, child = (name.lstrip("/") for name in (each.header.frame_id, each.child_frame_id))  # as tf2 does
            self._parents[child] = (frame, _matrix_of(each.transform))

    def pose(self, of: str, frame: str) -> MapPose:
        """The pose of a frame in another.

        Raises:
          Refused: they are not connected.
        """
        with np.errstate(invalid="ignore"):  # the planner refuses what is not finite
            ours, theirs = self._above(of), self._above(frame.lstrip("/"))
            common = next((name for name in ours if name in theirs), None)
            if common is None:
                raise Refused(f"{of} is not connected to {frame}; publish transforms between them on tf")
            try:
                pose = np.linalg.inv(theirs[common]) @ ours[common]
            except np.linalg.LinAlgError:
                raise Refused(f"the transforms between {of} and {frame} have no inverse; check tf") from None
        return MapPose(float(pose[0, 3]), float(pose[1, 3]), math.atan2(pose[1, 0], pose[0, 0]))

    def _above(self, frame: str) -> dict[str, _Matrix]:
        """The frame and its ancestors, nearest first, with the transform from the frame to each."""
        found = {frame: np.eye(4)}
        while frame in self._parents:
            parent, transform = self._parents[frame]
            if parent in found:  # a cycle
                break
            found[parent] = transform @ found[frame]
            frame = parent
        return found
