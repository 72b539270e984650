"""Assignment of topics to the robot that carries a camera, by namespaces.

Robots in the same recording have the same frame names, but each has a namespace: ``/robot1/tf``
moves the camera of ``/robot1/camera/depth/image_raw``, and ``/robot2/tf`` does not.
"""

from collections.abc import Collection, Iterable
from typing import NamedTuple


class Namespaces(NamedTuple):
    """Namespaces in the order in which they are searched for a camera."""

    own: tuple[str, ...]
    """Namespaces of the camera's robot, the longest first; the global one is empty and comes last.
    """
    others: tuple[str, ...]
    """Namespaces without a camera; they are searched if ``own`` is not sufficient."""

    @property
    def has_robot(self) -> bool:
        """Whether the camera's robot has a namespace."""
        return bool(self.own and self.own[0])


def namespace_of(topic: str) -> str:
    """Return the namespace of a topic.

    >>> namespace_of("/robot1/tf"), namespace_of("/tf")
    ('robot1', '')
    """
    return topic.strip("/").rpartition("/")[0]


def namespaces_of_camera(
    namespaces: Iterable[str], camera_topic: str, image_topics: Collection[str]
) -> Namespaces:
    """Return the namespaces that belong to a camera.

    Namespaces that are prefixes of the camera's topic belong to its robot, as do namespaces that
    start with the longest of them. If there are none, namespaces with the longest common prefix
    with the topic belong to the robot. A namespace that shares a prefix with another camera belongs
    to that camera.

    Args:
        namespaces: Namespaces of the topics with transforms or with poses.
        camera_topic: Topic of the camera's depth images.
        image_topics: All image topics of the log.

    >>> namespaces_of_camera(["", "a", "b"], "/a/camera/depth", ["/a/camera/depth"])
    Namespaces(own=('a', ''), others=())
    """
    camera, every = namespace_of(camera_topic), sorted(set(namespaces))
    shared = {name: affinity(name, camera) for name in every}
    above = [shared[name] for name in every if name and shared[name] == len(_parts(name))]
    least = max(above or shared.values(), default=0)
    own = [name for name in every if name and shared[name] >= max(1, least)]
    own += [name for name in every if shared[name] == len(_parts(name)) and name not in own]
    own.sort(key=lambda name: (-shared[name], len(_parts(name)), name))
    if own and own[0]:
        return Namespaces(tuple(own), ())
    claimed = {_parts(name)[0] for name in image_topics if _parts(namespace_of(name))}
    others = [name for name in every if name not in own and _parts(name)[0] not in claimed]
    return Namespaces(tuple(own), tuple(others))


def affinity(first: str, second: str) -> int:
    """Return the number of leading components that two names have in common.

    >>> affinity("/front/camera/depth", "/front/camera/color")
    2
    """
    count = 0
    for one, other in zip(_parts(first), _parts(second), strict=False):
        if one != other:
            break
        count += 1
    return count


def _parts(name: str) -> list[str]:
    return [part for part in name.split("/") if part]
