"""ROS message definitions: the supported ROS 2 types, and parsing of definitions in logs.

A definition is the text of a ``.msg`` file, followed by the definitions of its member types, each
after a line of ``=`` and a line ``MSG: package/Type``.
"""

from functools import cache, lru_cache

from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.limits import MAX_SCHEMA_LINES
from jaxdet.io.messages import plain_schema_name

DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "std_msgs/Float32": "float32 data",
    "sensor_msgs/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data",
    "sensor_msgs/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\n"
    "uint32 width\nbool do_rectify",
    "sensor_msgs/CameraInfo": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "string distortion_model\nfloat64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n"
    "uint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/Transform transform",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/PoseWithCovariance": "geometry_msgs/Pose pose\nfloat64[36] covariance",
    "geometry_msgs/TwistWithCovariance": "geometry_msgs/Twist twist\nfloat64[36] covariance",
    "nav_msgs/Odometry": "std_msgs/Header header\nstring child_frame_id\n"
    "geometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist",
    "nav_msgs/MapMetaData": "builtin_interfaces/Time map_load_time\nfloat32 resolution\n"
    "uint32 width\nuint32 height\ngeometry_msgs/Pose origin",
    "nav_msgs/OccupancyGrid": "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data",
    "sensor_msgs/LaserScan": "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\n"
    "float32 angle_increment\nfloat32 time_increment\nfloat32 scan_time\nfloat32 range_min\n"
    "float32 range_max\nfloat32[] ranges\nfloat32[] intensities",
    "sensor_msgs/PointField": "string name\nuint32 offset\nuint8 datatype\nuint32 count",
    "sensor_msgs/PointCloud2": "std_msgs/Header header\nuint32 height\nuint32 width\n"
    "sensor_msgs/PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\n"
    "uint8[] data\nbool is_dense",
    "vision_msgs/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "vision_msgs/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/Detection3D": "std_msgs/Header header\n"
    "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id",
    "vision_msgs/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "stereo_msgs/DisparityImage": "std_msgs/Header header\nsensor_msgs/Image image\nfloat32 f\n"
    "float32 t\nsensor_msgs/RegionOfInterest valid_window\nfloat32 min_disparity\n"
    "float32 max_disparity\nfloat32 delta_d",
    "realsense2_camera_msgs/Extrinsics": "float64[9] rotation\nfloat64[3] translation",
    "realsense2_camera_msgs/RGBD": "std_msgs/Header header\n"
    "sensor_msgs/CameraInfo rgb_camera_info\nsensor_msgs/CameraInfo depth_camera_info\n"
    "sensor_msgs/Image rgb\nsensor_msgs/Image depth",
}
"""Fields of each type, one per line, from common_interfaces and geometry2 of ROS 2 Jazzy,
vision_msgs and realsense-ros."""
_LEADING: dict[str, dict[str, tuple[str, ...]]] = {
    "cdr": {"Header": ("Time stamp",), "Time": ("int32 sec", "uint32 nanosec")},
    "ros1": {"Header": ("uint32 seq", "time stamp")},
}
"""First fields of the types Header and Time by encoding; Time need not be in a definition."""


@cache
def schema_text(type_name: str) -> str:
    """Return the definitions of a type and its member types, concatenated as in ROS 2."""
    order = [type_name]
    for name in order:
        kinds = (line.split()[0].partition("[")[0] for line in DEFINITIONS[name].splitlines())
        order += [kind for kind in kinds if kind in DEFINITIONS and kind not in order]
    parts = [DEFINITIONS[type_name] + "\n"]
    parts += [f"{'=' * 80}\nMSG: {name}\n{DEFINITIONS[name]}\n" for name in order[1:]]
    return "".join(parts)


def bare_definition(text: str) -> str:
    """Reduce a definition to types and names, without comments, constants and default values.

    The omitted parts do not affect the serialised message, and the parser's time grows with the
    square of their length.

    Raises:
        ValueError: The definition has more than ``MAX_SCHEMA_LINES`` lines.
    """
    lines = []
    for line in text.splitlines():
        kind, _, rest = line.partition("#")[0].strip().partition(" ")
        if not kind or (kind != "MSG:" and "=" in rest):
            continue
        lines.append(f"{kind} {''.join(rest.split()[:1])}".rstrip())
    if len(lines) > MAX_SCHEMA_LINES:
        raise ValueError(f"it has {len(lines)} fields, more than the maximum of {MAX_SCHEMA_LINES}")
    return "\n".join(lines)


def with_ros2_names(definition: str) -> str:
    """Convert the field names of a bare definition to lower case, as in ROS 2.

    Converters of ROS 1 recordings keep the original names, such as CameraInfo's ``K``.
    """
    lines = (line.partition(" ") for line in definition.splitlines())
    return "\n".join(
        f"{kind} {rest if kind == 'MSG:' else rest.lower()}".rstrip() for kind, _, rest in lines
    )


@lru_cache(16)
def fields_of(text: str) -> dict[str, tuple[str, ...]]:
    """Return the fields of each type in a definition, as ``type name``, by type name.

    The message itself has the empty name. Packages are omitted; if types of the same name in
    several packages differ, their fields are empty.

    Raises:
        ValueError: The definition has more than ``MAX_SCHEMA_LINES`` lines.
    """
    found: dict[str, tuple[str, ...]] = {}
    name, fields = "", []
    for line in [*bare_definition(text).splitlines(), "MSG: end"]:
        kind, _, rest = line.partition(" ")
        if kind == "MSG:":
            known = tuple(fields)
            found[name] = known if found.get(name, known) == known else ()
            name, fields = rest.rpartition("/")[2], []
        elif kind.strip("="):
            fields.append(f"{kind.rpartition('/')[2]} {rest}")
    return found


def with_definition(channel: ChannelInfo) -> ChannelInfo:
    """Return a channel with the standard definition of ROS 2 if the log has none for its type.

    rosbag2 omits definitions that it does not find, and before ROS 2 Iron all definitions.
    """
    name = plain_schema_name(channel.schema_name)
    given = channel.schema_data or channel.schema_size
    if given or channel.message_encoding != "cdr" or name not in DEFINITIONS:
        return channel
    return channel._replace(schema_encoding="ros2msg", schema_data=schema_text(name).encode())


@lru_cache(64)
def is_standard(channel: ChannelInfo) -> bool:
    """Return whether the messages of a channel are CDR with the standard ROS 2 definition.

    The definition in the log is compared, not only the type name.
    """
    name = plain_schema_name(channel.schema_name)
    if channel.message_encoding != "cdr" or name not in DEFINITIONS:
        return False
    return fields_of(channel.schema_text) == fields_of(schema_text(name))


def stamp_leads(channel: ChannelInfo) -> bool:
    """Return whether the messages of a channel start with a header that starts with a timestamp."""
    if channel.message_encoding not in _LEADING:
        return False
    known = fields_of(channel.schema_text)
    if known[""][:1] != ("Header header",) or "Header" not in known:
        return False
    leading = _LEADING[channel.message_encoding].items()
    return all(known.get(name, first)[: len(first)] == first for name, first in leading)
