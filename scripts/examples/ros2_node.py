"""A ROS 2 node: depth images in, the distance of the nearest obstacle out.

ros2 run finds it in a package of yours; ``python3 ros2_node.py`` does as well. Topics are remapped
as always: ``--ros-args -r depth:=/camera/camera/depth/image_rect_raw -r camera_info:=/camera/...``
"""

import numpy as np
import rclpy
from message_filters import Subscriber, TimeSynchronizer
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float32

import jaxdet


def pixels(image: Image) -> np.ndarray:
    """Return the pixels of a depth message (16UC1), without the padding of its rows."""
    rows = np.frombuffer(image.data, np.uint16).reshape(image.height, -1)
    return rows[:, : image.width]


class Obstacles(Node):
    """Publishes ``nearest`` [m] for each depth image, infinity where nothing is in range."""

    def __init__(self) -> None:
        super().__init__("obstacles")
        self.detector: jaxdet.Detector | None = None
        self.nearest = self.create_publisher(Float32, "nearest", 10)
        topics = (Image, "depth"), (CameraInfo, "camera_info")
        self.frames = TimeSynchronizer([Subscriber(self, *topic) for topic in topics], 10)
        self.frames.registerCallback(self.on_frame)

    def on_frame(self, depth: Image, info: CameraInfo) -> None:
        """Find the obstacles of a frame."""
        if self.detector is None:
            K = np.reshape(info.k, (3, 3))
            lens = (info.d, info.distortion_model) if any(info.d) else ()  # zeros: no distortion
            camera = jaxdet.Intrinsics.from_matrix(K, info.width, info.height, *lens)
            self.detector = jaxdet.Detector(camera)
        found = self.detector(pixels(depth))
        nearest = found.nearest_m if found.nearest_m is not None else float("inf")
        self.nearest.publish(Float32(data=nearest))
        self.get_logger().info(f"{len(found)} obstacles, nearest {nearest:.2f} m")


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Obstacles())
