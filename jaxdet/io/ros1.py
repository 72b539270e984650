"""ROS 1's messages, decoded by ``rosbags`` from the definition that stands in the log."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError


def require_rosbags(path: Path) -> None:
    """Check that ROS 1 messages can be decoded.

    Raises:
        InputError: ``rosbags`` isn't installed.
    """
    if find_spec("rosbags") is None:
        remedy = "install jaxdet[rosbag], or convert it: "
        remedy += f"rosbags-convert --src {path} --dst NEW --dst-storage mcap"
        raise InputError("ROS 1 bags need the package rosbags", path=str(path), remedy=remedy)


def ros1_decoder(name: str, definition: str) -> Callable[[bytes], Any]:
    """Return a decoder of messages of a type.

    Args:
        name: The type's.
        definition: Its fields, then those of the types in it, as ROS 1 concatenates them.

    Raises:
        ImportError: ``rosbags`` isn't installed.
        Exception: The definition can't be read.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    full = name if "/msg/" in name else name.replace("/", "/msg/")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, full))
    return lambda data: store.deserialize_ros1(data, full)
