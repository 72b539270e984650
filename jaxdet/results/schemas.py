"""Columns of the tables of results, each with its type, unit and description."""

import pyarrow as pa

_TYPES = {
    "text": pa.string(),
    "bool": pa.bool_(),
    "int8": pa.int8(),
    "int32": pa.int32(),
    "int64": pa.int64(),
    "float32": pa.float32(),
    "float64": pa.float64(),
}


def _schema(columns: str) -> pa.Schema:
    """Return the schema that a text describes.

    Args:
        columns: A line per column: its name, type, unit (``-`` without one) and description, which
            may go on in lines that begin with spaces. ``?`` after a type marks a column that may
            be null, ``[n]`` lists of n values, and ``[]`` lists of any length.
    """
    lines = columns.strip().replace("\n ", " ").splitlines()
    return pa.schema([_field(*line.split(maxsplit=3)) for line in lines])


def _field(name: str, kind: str, unit: str, description: str) -> pa.Field:
    item, _, length = kind.removesuffix("?").rstrip("]").partition("[")
    column = _TYPES[item]
    if "[" in kind:
        column = pa.list_(pa.field("item", column, nullable=False), int(length or -1))
    about = {"unit": unit.strip("-"), "description": " ".join(description.split())}
    return pa.field(name, column, kind.endswith("?"), about)


FRAMES_SCHEMA = _schema("""
log                      text        -     name of the log
camera                   text        -     name of the camera
frame                    int64       -     number of the depth image in the log, from 0
stamp_ns                 int64       ns    header stamp of the depth image
color_stamp_ns           int64?      ns    header stamp of its colour image
log_time_ns              int64?      ns    when the log received the depth image
status                   text        -     ok, or why the frame has no result
num_obstacles            int32       -     rows of the frame in obstacles.parquet
overflow                 bool        -     obstacles may be lost: too many surfaces, or paper's
                                           corners
camera_height_m          float32?    m     optical centre above the floor used
camera_pitch_rad         float32?    rad   downward tilt of the camera
camera_roll_rad          float32?    rad   clockwise turn, seen from behind the camera
camera_frame             text?       -     frame_id of the camera that lengths refer to (depth;
                                           paper: colour)
world_frame              text?       -     frame_id of the frame that poses are in
camera_position_world    float64[3]? m     x y z of the optical centre
camera_orientation_world float64[4]? -     unit quaternion x y z w, w >= 0, that turns the optical
                                           frame's axes into the world's
floor_source             text        -     where the floor comes from
floor_refused            text?       -     why the frame's own depth did not decide
free_bearing_rad         float32[]?  rad   free floor: bearing of a ray, clockwise, 0 ahead
free_from_m              float32[]?  m     where it begins, from the camera's foot
free_to_m                float32[]?  m     where it ends, from the camera's foot
free_end                 int8[]?     -     what ends it: 0 not known, 1 an obstacle or what is above
                                           the step, 2 a drop, 3 the range
drop_m                   float32?    m     distance of the nearest drop on the floor
""")
"""``frames.parquet``: one row for each depth image of each log, also without a result."""

OBSTACLES_SCHEMA = _schema("""
log                      text        -     name of the log
camera                   text        -     name of the camera
frame                    int64       -     number of the depth image in the log, from 0
stamp_ns                 int64       ns    header stamp of the depth image
obstacle                 int32       -     label in the frame from 0, by its least measured depth;
                                           those of the free floor last
num_points               int32       -     its depth cells; in the preset paper its corners
evidence                 text        -     what shows it: surface, free_floor (a notch in the free
                                           floor) or corners (preset paper)
box_image                text        -     image that its box is in: color or depth
u_min                    int32?      pixel first column of its box, null outside of the image
u_max                    int32?      pixel last column
v_min                    int32?      pixel first row
v_max                    int32?      pixel last row
x_min                    float32     m     left side, in the camera's optical frame
x_max                    float32     m     right side
y_min                    float32     m     upper side; y points down
y_max                    float32     m     lower side
z_min                    float32     m     near side
z_max                    float32     m     far side
x                        float32     m     centroid, right
y                        float32     m     centroid, down
z                        float32     m     centroid, forward
vertices                 int8        -     1 where a vertex stands out towards the camera, else 0
corners_ground           float32[8]  m     rectangle on the floor, which may leave out single cells:
                                           right and forward of the camera in turn, A, B, beyond B,
                                           beyond A
corners_world            float64[8]? m     the same in the world, x and y in turn; null without a
                                           pose or a floor level in it
distance_m               float32?    m     on the floor, from below the camera to the nearest point
                                           of the contour; null without a floor
bottom_m                 float32?    m     its lowest cell above the floor
top_m                    float32?    m     its highest cell above the floor
contour                  float32[]?  m     visible edge on the floor, right and forward in turn
""")
"""``obstacles.parquet``: one row for each obstacle."""

TRACKS_SCHEMA = _schema("""
log                      text        -     name of the log
camera                   text        -     name of the camera
track                    int32       -     number in the log and camera, from 0, by its first
                                           obstacle
in_world                 bool        -     path in the world, else in the camera's ground frame
first_frame              int64       -     frame that shows it first
last_frame               int64       -     and last
first_stamp_ns           int64       ns    stamp of its first frame
last_stamp_ns            int64       ns    stamp of its last frame
num_frames               int64       -     frames that show it
num_obstacles            int64       -     its rows in obstacles.parquet
moving                   bool        -     whether it moves in its path's frame, else it stands
mean_speed_mps           float32     m/s   mean of its frames, 0 where it stands
max_speed_mps            float32     m/s   greatest of them
length_m                 float32     m     longer side of its outline, median
width_m                  float32     m     shorter side, median
top_m                    float32?    m     highest point above the floor, median
path                     float64[]   m     middle of its outline, x and y in turn: a point for each
                                           frame from the first to the last, shown or not; one point
                                           where it stands
speed_mps                float32[]   m/s   speed in each of these frames; one value if stationary
persistence              float32?    -     of the frames that measure its place since it was found
                                           there, the share that show an obstacle
floor_seen               float32?    -     share of these frames that show floor there
in_map                   bool?       -     most of its obstacles are in the map that was given
""")
"""``tracks.parquet``: one row per track."""

LINKS_SCHEMA = _schema("""
log                      text        -     name of the log
camera                   text        -     name of the camera
frame                    int64       -     number of the depth image in the log
obstacle                 int32       -     label in the frame
track                    int32?      -     number of its track; null where it is in none
persistence              float32?    -     of the frames that measure its place since it was found
                                           there, the share that show an obstacle
floor_seen               float32?    -     share of these frames that show floor there
in_map                   bool?       -     it stands on something of the map that was given
""")
"""``track_links.parquet``: one row per row of ``obstacles.parquet``, in the same order."""

DICTIONARIES = [
    *("log", "camera", "status", "camera_frame", "world_frame", "floor_source", "floor_refused"),
    *("box_image", "evidence"),
]
"""Columns with few different values, which are stored with a dictionary."""
