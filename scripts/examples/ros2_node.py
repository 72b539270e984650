"""A ROS 2 node: colour and aligned depth in, the distance of the nearest obstacle out.

ros2 run finds it in a package of yours; ``python3 ros2_node.py`` does as well. Topics are remapped
as always: ``--ros-args -r color:=/camera/camera/color/image_raw -r depth:=/camera/camera/...``
"""

import numpy as np
import rclpy
from message_filters import Subscriber, TimeSynchronizer
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float32

import jaxdet


def pixels(image: Image) -> np.ndarray:
    """The pixels of a message, without the padding of its rows."""
    kind, size = {"rgb8": (np.uint8, 3), "bgr8": (np.uint8, 3), "16UC1": (np.uint16, 1)}[
        image.encoding
    ]
    rows = np.frombuffer(image.data, kind).reshape(image.height, -1)
    return rows[:, : image.width * size].reshape(image.height, image.width, size)


class Obstacles(Node):
    """Publishes ``nearest`` [m] for each pair of images, infinity where nothing is in range."""

    def __init__(self) -> None:
        super().__init__("obstacles")
        self.detector: jaxdet.Detector | None = None
        self.nearest = self.create_publisher(Float32, "nearest", 10)
        topics = (Image, "color"), (Image, "depth"), (CameraInfo, "camera_info")
        self.frames = TimeSynchronizer([Subscriber(self, *topic) for topic in topics], 10)
        self.frames.registerCallback(self.on_frame)

    def on_frame(self, color: Image, depth: Image, info: CameraInfo) -> None:
        """Finds the obstacles of a frame."""
        if self.detector is None:
            K, order = np.reshape(info.k, (3, 3)), color.encoding.removesuffix("8")
            lens = (info.d, info.distortion_model) if any(info.d) else ()  # zeros: no distortion
            camera = jaxdet.Intrinsics.from_matrix(K, info.width, info.height, *lens)
            self.detector = jaxdet.Detector(camera, color_order=order)  # "rgb" or "bgr"
        found = self.detector(pixels(color), pixels(depth))
        nearest = found.nearest_m if found.nearest_m is not None else float("inf")
        self.nearest.publish(Float32(data=nearest))
        self.get_logger().info(f"{len(found)} obstacles, nearest {nearest:.2f} m")


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Obstacles())
