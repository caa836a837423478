"""What the node and the DDS participant have in common: their parameters, and when to decide. It needs no ROS."""

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from .messages import doors_of, labels_of, map_of
from .planner_process import AnyPlanner, Decision, MapPose, Refused

#: Default of each parameter, and what it is; all are read once, at the start.
PARAMETERS: dict[str, tuple[Any, str]] = {
    "planner": ("dc2g", "dc2g, dc2g_uncertain or frontier"),
    "network": ("", "folder of a trained network; empty: the shipped one"),
    "cell_size": (0.25, "side of the planner's cells, meters"),
    "smallest_cell": (0.0, "side of the smallest cells after halving, meters; 0: a quarter of cell_size"),
    "sensing_range": (3.0, "how far the robot sees, meters"),
    "field_of_view": (90.0, "width of the robot's field of view, degrees; 360: all around"),
    "labels": ([""], "class of each cell value, for semantic maps, such as 1:road"),
    "largest": ([100, 100], "rows and columns of the largest map, cells"),
    "base_frame": ("base_link", "frame of the robot"),
    "period": (1.0, "minimum time between decisions, seconds"),
    "drive": (False, "whether to send the robot to the subgoals through Nav2"),
}


def planner_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `dc2g_jax.MetricPlanner`, from parameters.

    Raises:
      Refused: the labels have another form, or the period is not positive.
    """
    if not given["period"] > 0:
        raise Refused(f"period: is {given['period']}; give seconds above 0")
    return {
        "planner": given["planner"],
        "cell_size": given["cell_size"],
        "smallest_cell": given["smallest_cell"] or None,
        "sensing_range": given["sensing_range"],
        "field_of_view": given["field_of_view"],
        "labels": labels_of(given["labels"]),
        "network": given["network"] or None,
        "largest": tuple(given["largest"]),
    }


class Decided(NamedTuple):
    """A decision, the header of its map, and where the robot was."""

    header: Any
    pose: MapPose
    decision: Decision


class Decider:
    """Keeps the latest map and doors, and decides on them if anything is new.

    Attributes:
      changing: lock for what several threads change. No thread holds it while the planner decides.
      is_news: whether there is anything to decide on.
    """

    def __init__(self) -> None:
        self.changing = threading.RLock()
        self.is_news = False
        self._map: Any = None
        self._doors: Any = None
        self._to_set_aside: list[MapPose] = []

    def see_map(self, message: Any) -> None:
        """Take in a `nav_msgs/OccupancyGrid`, in place of the last one."""
        with self.changing:
            self._map, self.is_news = message, True

    def see_doors(self, message: Any) -> None:
        """Take in a `geometry_msgs/PoseArray` of doors, in place of the last one. The same doors again are no news."""
        with self.changing:
            before, self._doors = self._doors, message
            same_frame = before is not None and before.header.frame_id == message.header.frame_id
            self.is_news |= not (same_frame and before.poses == message.poses)

    def set_aside(self, place: MapPose) -> None:
        """Set aside, before the next decision, what would be seen from a subgoal."""
        with self.changing:
            self._to_set_aside.append(place)
            self.is_news = True

    def decide(self, planner: AnyPlanner, pose_in: Callable[[str], MapPose]) -> Decided | None:
        """Decide on the latest map; `None` if nothing is new.

        Args:
          planner: makes the decision.
          pose_in: the robot's pose in a frame; it raises `Refused` if it is unknown.

        Raises:
          Refused: the planner cannot use the map, the pose or the doors. The next call tries again.
        """
        with self.changing:
            seen, found = self._map, self._doors
            if seen is None or not self.is_news:
                return None
            self.is_news = False
            aside, self._to_set_aside = self._to_set_aside, []
        try:
            for place in aside:
                planner.set_aside(place)
            frame = seen.header.frame_id
            pose = pose_in(frame)
            doors = doors_of(found, frame) if found is not None and found.poses else []
            return Decided(seen.header, pose, planner.plan(map_of(seen), pose, doors))
        except Refused:
            self.is_news = True
            raise
