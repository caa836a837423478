"""Maps in cells and poses in them as ROS messages: turned by 30 degrees, with cells of a quarter of a meter."""

import math

import numpy as np

from tests.oracles import numpy_gridworld as oracle
from tests.support import ros

M = ros.MESSAGES
ROAD, HOUSE = 3, 7
#: Meters of a cell, as in a message; sensing range in cells; where the grid lies.
CELL, REACH = float(np.float32(0.25)), 4
X, Y, YAW = -2.0, 5.5, math.pi / 6


def quaternion(yaw: float):
    return M.Quaternion(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def in_map(column: float, row: float, rows: int) -> tuple[float, float]:
    """The middle of a cell in meters; the row counts from the top."""
    right, up = (column + 0.5) * CELL, (rows - row - 0.5) * CELL
    return X + right * math.cos(YAW) - up * math.sin(YAW), Y + right * math.sin(YAW) + up * math.cos(YAW)


def map_message(terrain: np.ndarray):
    """Observed terrain with rows from the top, 0 unknown, as a map: -1, 0 or 100, with rows from below."""
    values = np.where(terrain == 0, -1, np.where(np.isin(terrain, oracle.TRAVERSABLE_CLASSES), 0, 100))
    rows, columns = terrain.shape
    origin = M.Pose(position=M.Point(x=X, y=Y, z=0.0), orientation=quaternion(YAW))
    info = M.MapMetaData(resolution=CELL, width=columns, height=rows, origin=origin)
    return M.OccupancyGrid(header=M.Header(frame_id="map"), info=info, data=np.ravel(values[::-1]).astype(np.int8))


def transform_of(pose, rows: int):
    x, y = in_map(pose[0], pose[1], rows)
    return M.Transform(translation=M.Vector3(x=x, y=y, z=0.0), rotation=quaternion(YAW - pose[2] * math.pi / 2))


#: A corridor whose right end is unknown.
CORRIDOR = np.pad(np.array([[ROAD] * 9 + [0]], np.uint8), ((1, 1), (1, 0)), constant_values=HOUSE)
