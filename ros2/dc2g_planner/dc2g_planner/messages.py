"""ROS messages as inputs of the planner, and its decisions as messages. Nothing here needs ROS or `dc2g_jax`."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from .planner_process import Decision, Map, MapPose, Refused

#: The outputs in the order of publication, and their types: the subgoal last, when all else is known.
OUTPUTS = {
    "frontiers": "PoseArray",
    "path": "Path",
    "markers": "MarkerArray",
    "why": "String",
    "mode": "String",
    "subgoal": "PoseStamped",
}

#: Targets that differ by less than this, in meters and radians, are the same.
_SAME = 0.01

#: Colors of the best and the worst candidate and of the subgoal; red, green, blue.
_BEST, _WORST, _SUBGOAL = (0.1, 0.8, 0.2), (0.9, 0.4, 0.1), (0.1, 0.3, 1.0)


def map_of(message: Any) -> Map:
    """The map of a `nav_msgs/OccupancyGrid`.

    Raises:
      Refused: the message contradicts itself.
    """
    info, cells = message.info, np.asarray(message.data, np.int8)
    if cells.size != info.width * info.height:
        raise Refused(
            f"the map has {cells.size} cells, but its info says {info.width} x {info.height}; publish a value per cell"
        )
    at = info.origin.position
    origin = (at.x, at.y, yaw_of(info.origin.orientation))
    return Map(cells.tobytes(), (info.height, info.width), float(info.resolution), origin)


def yaw_of(quaternion: Any) -> float:
    """The yaw of a `geometry_msgs/Quaternion`, in radians."""
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def pose_of(transform: Any) -> MapPose:
    """The pose of the robot, from the `geometry_msgs/Transform` from the map to the robot."""
    return MapPose(transform.translation.x, transform.translation.y, yaw_of(transform.rotation))


def doors_of(message: Any, frame: str) -> list[tuple[float, float]]:
    """The x and y of the doors in a `geometry_msgs/PoseArray`.

    Raises:
      Refused: they are not in the map's frame.
    """
    if message.header.frame_id != frame:
        raise Refused(f"doors are in the frame {message.header.frame_id!r}; give them in the map's frame, {frame!r}")
    return [(pose.position.x, pose.position.y) for pose in message.poses]


def labels_of(lines: Iterable[str]) -> dict[int, str] | None:
    """The class of each value in `["1:road", "7:house"]`; `None` if all lines are empty.

    Raises:
      Refused: a line has another form.
    """
    labels = {}
    for line in filter(None, lines):
        value, colon, name = line.partition(":")
        if not (colon and value.strip().isdecimal()):
            raise Refused(f"labels: {line!r}; write VALUE:CLASS, such as 1:road")
        labels[int(value)] = name.strip()
    return labels or None


def place_to_drive_to(decision: Decision) -> MapPose | None:
    """Where to send the robot: to the subgoal, or in front of the door. `None` if it is already there or gave up."""
    steps = decision.path[:-1] if decision.mode == "to_goal" else decision.path
    return steps[-1] if len(steps) > 1 else None


def is_same(one: MapPose, other: MapPose) -> bool:
    """Whether two poses are the same target."""
    return max(abs(a - b) for a, b in zip(one, other, strict=True)) < _SAME


class Outgoing:
    """Messages for a decision.

    Args:
      types: has the message classes as attributes: `ColorRGBA`, `Header`, `Marker`, `MarkerArray`, `Path`,
        `Point`, `Pose`, `PoseArray`, `PoseStamped`, `Quaternion`, `String` and `Vector3`.
      frame: frame of the map.
      stamp: time of the decision.
    """

    def __init__(self, types: Any, frame: str, stamp: Any):
        self._types = types
        self._header = types.Header(stamp=stamp, frame_id=frame)

    def all(self, decision: Decision) -> Iterator[tuple[str, Any]]:
        """The names of `OUTPUTS` with their messages; no subgoal if the planner gave up."""
        for name in OUTPUTS:
            if name != "subgoal" or decision.subgoal is not None:
                yield name, getattr(self, name)(decision)

    def pose(self, pose: MapPose) -> Any:
        """A `geometry_msgs/Pose`."""
        turn = self._types.Quaternion(x=0.0, y=0.0, z=math.sin(pose.yaw / 2), w=math.cos(pose.yaw / 2))
        return self._types.Pose(position=self._types.Point(x=pose.x, y=pose.y, z=0.0), orientation=turn)

    def stamped(self, pose: MapPose) -> Any:
        """A `geometry_msgs/PoseStamped`."""
        return self._types.PoseStamped(header=self._header, pose=self.pose(pose))

    def subgoal(self, decision: Decision) -> Any:
        """A `geometry_msgs/PoseStamped` of the subgoal, which must exist."""
        assert decision.subgoal is not None
        return self.stamped(decision.subgoal)

    def frontiers(self, decision: Decision) -> Any:
        """A `geometry_msgs/PoseArray` of the candidates, the subgoal first, then by score."""
        poses = [self.pose(candidate) for candidate in decision.candidates]
        return self._types.PoseArray(header=self._header, poses=poses)

    def path(self, decision: Decision) -> Any:
        """A `nav_msgs/Path`."""
        return self._types.Path(header=self._header, poses=[self.stamped(pose) for pose in decision.path])

    def why(self, decision: Decision) -> Any:
        """A `std_msgs/String` with the reason."""
        return self._types.String(data=decision.why)

    def mode(self, decision: Decision) -> Any:
        """A `std_msgs/String` with the mode: `explore`, `to_goal`, or `gave_up` at the end."""
        return self._types.String(data=decision.mode)

    def markers(self, decision: Decision) -> Any:
        """A `visualization_msgs/MarkerArray`: candidates from best (green) to worst, the subgoal, and the reason."""
        new, size = self._types, decision.cell_size
        markers = [new.Marker(header=self._header, action=new.Marker.DELETEALL)]
        if decision.candidates:
            shares = np.linspace(0.0, 1.0, len(decision.candidates))[:, None]
            colors = ((1 - shares) * _BEST + shares * _WORST).tolist()
            markers.append(
                self._marker(
                    new.Marker.CUBE_LIST,
                    (0.6 * size, 0.6 * size, 0.02),
                    points=[new.Point(x=pose.x, y=pose.y, z=0.0) for pose in decision.candidates],
                    colors=[self._color(color) for color in colors],
                )
            )
        if decision.subgoal is not None:
            above = self.pose(decision.subgoal)
            above.position.z = 0.5
            arrow = (2 * size, 0.4 * size, 0.4 * size)
            markers += [
                self._marker(new.Marker.ARROW, arrow, pose=self.pose(decision.subgoal), color=self._color(_SUBGOAL)),
                self._marker(
                    new.Marker.TEXT_VIEW_FACING,
                    (0.0, 0.0, 0.2),
                    pose=above,
                    color=self._color((1.0, 1.0, 1.0)),
                    text=decision.why,
                ),
            ]
        for number, marker in enumerate(markers):
            marker.id = number
        return new.MarkerArray(markers=markers)

    def _marker(self, kind: int, scale: tuple[float, float, float], **fields: Any) -> Any:
        x, y, z = scale
        fields = {"pose": self.pose(MapPose(0.0, 0.0, 0.0)), **fields}
        return self._types.Marker(
            header=self._header,
            ns="dc2g",
            type=kind,
            action=self._types.Marker.ADD,
            scale=self._types.Vector3(x=x, y=y, z=z),
            **fields,
        )

    def _color(self, color: Iterable[float]) -> Any:
        red, green, blue = color
        return self._types.ColorRGBA(r=red, g=green, b=blue, a=1.0)
