"""``python -m jaxdet.ros2``: runs the node until it is interrupted."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from jaxdet.errors import JaxdetError
from jaxdet.ros2.node import PARAMETERS, ObstacleNode, ros

LAUNCH_FILE = Path(__file__).with_name("jaxdet.launch.xml")
"""Launch file of the node."""
WAIT_S = 0.2
"""Maximum delay until Ctrl-C takes effect while no images arrive [s]."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the node.

    Args:
        argv: Arguments; those from ``--ros-args`` on are for ROS 2. None: those of the process.

    Returns:
        0 after an interruption, 2 if the node can't start.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    own = args[: args.index("--ros-args")] if "--ros-args" in args else args
    if _parser().parse_args(own).launch_file:
        print(LAUNCH_FILE)
        return 0
    try:
        _run(args)
    except JaxdetError as error:
        print(f"jaxdet: {error}", file=sys.stderr)
        return 2
    return 0


def _run(args: Sequence[str]) -> None:
    """Run the node until Ctrl-C, or until ROS 2 is shut down."""
    rclpy, executors = ros("rclpy"), ros("rclpy.executors")
    # Python handles signals: a detector replaces the handlers of rclpy while it computes.
    no_handlers = ros("rclpy.signals").SignalHandlerOptions.NO
    rclpy.init(args=[__package__, *args], signal_handler_options=no_handlers)
    try:
        node = rclpy.create_node("jaxdet")
        obstacles, executor = ObstacleNode(node), executors.SingleThreadedExecutor()
        executor.add_node(node)
        try:
            while rclpy.ok():
                executor.spin_once(timeout_sec=WAIT_S)
        except KeyboardInterrupt:
            print(obstacles, file=sys.stderr)
    finally:
        rclpy.try_shutdown()


def _parser() -> argparse.ArgumentParser:
    parameters = "\n".join(
        f"  {name} ({default!r}): {text}" for name, (default, text) in PARAMETERS.items()
    )
    parser = argparse.ArgumentParser(
        prog="python -m jaxdet.ros2",
        usage="%(prog)s [-h] [--launch-file] [--ros-args -r depth:=TOPIC -r camera_info:=TOPIC]",
        description="Publish the obstacles in depth images as ROS 2 messages.",
        epilog=f"parameters, with their defaults:\n{parameters}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--launch-file", action="store_true", help="print the launch file's path")
    return parser


if __name__ == "__main__":
    sys.exit(main())
