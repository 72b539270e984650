"""ROS 1 messages, decoded by ``rosbags`` from the definition in the log."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError


def require_rosbags(path: Path) -> None:
    """Check that ROS 1 messages can be decoded.

    Raises:
        InputError: ``rosbags`` is not installed.
    """
    if find_spec("rosbags") is None:
        remedy = "install jaxdet[rosbag], or convert the bag: "
        remedy += f"rosbags-convert --src {path} --dst NEW --dst-storage mcap"
        raise InputError("ROS 1 bags need the package rosbags", path=str(path), remedy=remedy)


def ros1_decoder(name: str, definition: str) -> Callable[[bytes], Any]:
    """Return a function that decodes messages of a type.

    Args:
        name: Name of the type.
        definition: Fields of the type, followed by the definitions of its member types, as in ROS
            1.

    Raises:
        ImportError: ``rosbags`` is not installed.
        Exception: The definition can't be parsed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    full = name if "/msg/" in name else name.replace("/", "/msg/")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, full))
    return lambda data: store.deserialize_ros1(data, full)
