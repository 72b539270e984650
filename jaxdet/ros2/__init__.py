"""ROS 2 node that detects obstacles in live depth images: ``python -m jaxdet.ros2``.

It is tested with a stub of ``rclpy``; it has never run on a ROS 2 installation.
"""
