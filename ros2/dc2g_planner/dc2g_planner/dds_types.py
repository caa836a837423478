"""ROS 2 messages as DDS types, from their definitions.

`nav_msgs/Path` is `nav_msgs::msg::dds_::Path_` on DDS. Types are compared by these names only, unless both sides send
type information. In it, newer versions of `rmw_cyclonedds` name members as ROS does, without the `_` that ROS's
generated IDL appends. Data contain no names.
"""

import dataclasses
from types import SimpleNamespace
from typing import Any

from cyclonedds.idl import IdlStruct, make_idl_struct, types as idl

#: Members as in `ros2 interface show`, for ROS 2 Humble and later. A type comes after those of its members.
_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "std_msgs/Header": "Time stamp, string frame_id",
    "std_msgs/String": "string data",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/PoseArray": "Header header, Pose[] poses",
    "geometry_msgs/PoseStamped": "Header header, Pose pose",
    "geometry_msgs/Transform": "Vector3 translation, Quaternion rotation",
    "geometry_msgs/TransformStamped": "Header header, string child_frame_id, Transform transform",
    "nav_msgs/MapMetaData": "Time map_load_time, float32 resolution, uint32 width, uint32 height, Pose origin",
    "nav_msgs/OccupancyGrid": "Header header, MapMetaData info, int8[] data",
    "nav_msgs/Path": "Header header, PoseStamped[] poses",
    "sensor_msgs/CompressedImage": "Header header, string format, uint8[] data",
    "tf2_msgs/TFMessage": "TransformStamped[] transforms",
    "visualization_msgs/MeshFile": "string filename, uint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u, float32 v",
    "visualization_msgs/Marker": (
        "Header header, string ns, int32 id, int32 type, int32 action, Pose pose, Vector3 scale, ColorRGBA color,"
        "Duration lifetime, bool frame_locked, Point[] points, ColorRGBA[] colors, string texture_resource,"
        "CompressedImage texture, UVCoordinate[] uv_coordinates, string text, string mesh_resource,"
        "MeshFile mesh_file, bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "Marker[] markers",
}

#: The DDS type of each primitive, and a function that returns its default.
_PRIMITIVES: dict[str, tuple[Any, Any]] = {
    "bool": (bool, bool),
    "float32": (idl.float32, float),
    "float64": (idl.float64, float),
    "int8": (idl.int8, int),
    "int32": (idl.int32, int),
    "string": (str, str),
    "uint8": (idl.uint8, int),
    "uint32": (idl.uint32, int),
}


def _messages() -> dict[str, type[IdlStruct]]:
    """A class for each definition."""
    made: dict[str, type[IdlStruct]] = {}
    for full_name, definition in _DEFINITIONS.items():
        package, _, name = full_name.partition("/")
        kinds, defaults = {}, {}
        for member in definition.split(","):
            kind, field = member.split()
            element = kind.removesuffix("[]")
            of, default = _PRIMITIVES[element] if element in _PRIMITIVES else (made[element], made[element])
            kinds[field], defaults[field] = (of, default) if kind == element else (idl.sequence(of), list)
        made[name] = make_idl_struct(name, f"{package}.msg.dds_.{name}_", kinds, dataclassify=False)
        for field, default in defaults.items():
            setattr(made[name], field, dataclasses.field(default_factory=default))
        made[name] = dataclasses.dataclass(made[name])
    return made


#: The classes by their names in ROS.
TYPES: Any = SimpleNamespace(**_messages())
for _name, _value in {"ARROW": 0, "CUBE_LIST": 6, "TEXT_VIEW_FACING": 9, "ADD": 0, "DELETEALL": 3}.items():
    setattr(TYPES.Marker, _name, _value)
