"""The tree of a log's transforms, and the motion between any two of its frames."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import TransformError
from jaxdet.io.limits import MAX_FRAMES_TF
from jaxdet.io.messages import TransformMessage
from jaxdet.io.motion import MotionSamples, difference, inverse, motion_matrix
from jaxdet.io.namespaces import namespace_of

_REMEDY = "give --log.color-from-depth and --log.no-tf, or repair the transforms"


class _Edge:
    """A frame's motion in its parent."""

    def __init__(self, parent: str, topic: str) -> None:
        self.parent, self.topic = parent, topic
        self.fixed: np.ndarray | None = None
        self.samples = MotionSamples()
        self.once_is_static = False
        self.settled = False
        """Static by what it does, not by its topic."""


class TransformTree:
    """Static and moving transforms; each frame has one parent, the first that is seen.

    A static transform goes before moving ones of the same frame. What contradicts, or is no
    motion, is not used and noted in ``warnings``.

    Attributes:
        ignored: How many transforms of each frame are no motions.
    """

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}
        self._warned: set[str] = set()
        self.warnings: list[str] = []
        self.ignored: Counter[str] = Counter()
        self._problems: dict[str, str] = {}
        """Of the first of them."""
        self._topics: set[str] = set()

    @property
    def frames(self) -> set[str]:
        """All frames."""
        return set(self._edges) | {edge.parent for edge in self._edges.values()}

    @property
    def has_static(self) -> bool:
        """Whether a static transform was seen."""
        return any(edge.fixed is not None for edge in self._edges.values())

    @classmethod
    def joined(
        cls, trees: Sequence["TransformTree"], others: Sequence["TransformTree"] = ()
    ) -> "TransformTree":
        """Join the trees of several namespaces; of a frame in several, the first tree's counts.

        Args:
            trees: Of the robot's namespaces, in the order in which they are searched.
            others: Of other namespaces. One whose frames contradict those before it is of another
                robot, and is left out.
        """
        found = cls()
        for tree in trees:
            found._join(tree)
        for tree in others:
            if not any(found._contradicts(frame, edge) for frame, edge in tree._edges.items()):
                found._join(tree)
        return found

    def _join(self, tree: "TransformTree") -> None:
        for frame, edge in tree._edges.items():
            if self._contradicts(frame, edge):
                used = self._edges[frame].topic
                text = f"comes from {used} and from {edge.topic}; {used} is used"
                self._warn(frame, text)
            self._edges.setdefault(frame, edge)
        self.warnings += [text for text in tree.warnings if text not in self.warnings]
        self.ignored.update(tree.ignored)
        self._warned |= tree._warned
        self._topics |= tree._topics

    def _contradicts(self, frame: str, edge: _Edge) -> bool:
        """Return whether another tree has this frame elsewhere."""
        known = self._edges.get(frame)
        if known is None:
            return False
        if known.parent != edge.parent or known.fixed is None or edge.fixed is None:
            return True
        return max(difference(known.fixed, edge.fixed)) > 1e-6

    def uses(self, topic: str, frame: str) -> bool:
        """Return whether transforms of this frame are taken from this topic."""
        edge = self._edges.get(frame)
        if edge is not None and namespace_of(edge.topic) != namespace_of(topic):
            return False
        return topic in self._topics

    def add(
        self,
        messages: Sequence[TransformMessage],
        static: bool,
        once_is_static: bool = False,
        topic: str = "",
    ) -> None:
        """Add transforms.

        Args:
            messages: The transforms.
            static: They hold at all times (``/tf_static``).
            once_is_static: A frame that gets one transform only has a static one (Foxglove,
                which doesn't tell them apart).
            topic: The topic that they come from.
        """
        self._topics.add(topic)
        for message in messages:
            if message.problem:
                self._ignore(message)
                continue
            edge = self._edge(message, static, topic)
            if edge is None:
                continue
            if not static:
                edge.once_is_static |= once_is_static
                edge.samples.add(message.stamp_ns, message.translation, message.rotation)
                continue
            T = motion_matrix(np.array(message.translation), np.array(message.rotation))
            if edge.fixed is None:
                edge.fixed = T
            elif max(difference(edge.fixed, T)) > 1e-6:
                both = sorted({edge.topic, topic} - {""})
                where = f", on {' and '.join(both)}" if len(both) > 1 else ""
                text = f"has two static transforms{where}; the first is used"
                self._warn(message.child, text)

    def settle(self) -> None:
        """Call when all is added: a transform that never changes counts as static, at all times.

        Many repeat their mounts on ``/tf``, at any rate, and end a little before the images.
        """
        for edge in self._edges.values():
            once = edge.once_is_static and len(edge.samples) == 1
            if edge.fixed is None and (once or edge.samples.is_constant()):
                value = edge.samples.values[0]
                edge.fixed = motion_matrix(value[:3], value[3:])
                edge.settled = True
        for frame, problem in sorted(self._problems.items()):
            text = f"TF frame {frame!r}: {self.ignored[frame]} transforms are ignored: {problem}"
            self.warnings.append(text)

    def fixed(self, target: str, source: str) -> np.ndarray | None:
        """``T_target_source`` ``(4, 4)`` of static transforms; None if there is none.

        Raises:
            TransformError: The transforms form a cycle.
        """
        paths = self._paths(target, source)
        if paths is None:
            return None
        up, down = (self._fixed_product(path) for path in paths)
        return None if up is None or down is None else matmul(inverse(up), down)

    def at(self, target: str, source: str, stamps_ns: np.ndarray) -> np.ndarray | None:
        """``T_target_source`` at each stamp ``(F, 4, 4)``, NaN where unknown.

        None if no chain of transforms, static or moving, joins the frames.

        Raises:
            TransformError: The transforms form a cycle.
        """
        paths = self._paths(target, source)
        if paths is None:
            return None
        up, down = (self._product_at(path, stamps_ns) for path in paths)
        return matmul(inverse(up), down)

    def joins(self, target: str, source: str) -> bool:
        """Return whether a chain of transforms, static or moving, joins two frames.

        Raises:
            TransformError: The transforms form a cycle.
        """
        return self._paths(target, source) is not None

    def moving(self, target: str, source: str) -> list[str]:
        """Return the frames between two that move in their parents."""
        paths = self._paths(target, source) or ([], [])
        return [frame for path in paths for frame in path if self._edges[frame].fixed is None]

    def above(self, frame: str) -> list[str]:
        """Return a frame and its parents up to the root.

        Raises:
            TransformError: The transforms form a cycle.
        """
        path, known = [frame], {frame}
        while frame in self._edges:
            frame = self._edges[frame].parent
            if frame in known:
                problem = f"the transforms form a cycle through frame {frame!r}"
                raise TransformError(problem, remedy=_REMEDY)
            path.append(frame)
            known.add(frame)
        return path

    def sampled_once(self) -> set[str]:
        """Return the frames with a single moving transform, which may change or not."""
        return {
            frame
            for frame, edge in self._edges.items()
            if len(edge.samples) == 1 and (edge.fixed is None or edge.once_is_static)
        }

    def topic(self, frame: str) -> str:
        """Return the topic that a frame's transforms come from; empty if it is unknown."""
        return self._edges[frame].topic if frame in self._edges else ""

    def parent(self, frame: str) -> str | None:
        """Return the parent of a frame; None if it is unknown."""
        return self._edges[frame].parent if frame in self._edges else None

    def agrees(self, message: TransformMessage, static: bool) -> bool:
        """Return whether a transform would change nothing but the samples of moving frames."""
        edge = self._edges.get(message.child)
        if edge is None:
            return False
        told = message.child in self._warned
        if edge.parent != message.parent:
            return told and (not static or (edge.fixed is not None and not edge.settled))
        if edge.fixed is None or (static and edge.settled):
            return not static
        if static:
            T = motion_matrix(np.array(message.translation), np.array(message.rotation))
            return told or max(difference(edge.fixed, T)) <= 1e-6
        return not edge.settled or edge.samples.is_like_first(message)

    def with_samples(self, samples: dict[str, MotionSamples]) -> "TransformTree":
        """Return the same tree with other samples of what moves."""
        tree = TransformTree()
        for frame, edge in self._edges.items():
            tree._edges[frame] = copy = _Edge(edge.parent, edge.topic)
            copy.fixed, copy.samples = edge.fixed, samples.get(frame, copy.samples)
        return tree

    def _edge(self, message: TransformMessage, static: bool, topic: str) -> _Edge | None:
        """Return the edge of a transform; None if it contradicts the existing one."""
        edge = self._edges.get(message.child)
        if edge is None and len(self._edges) >= MAX_FRAMES_TF:
            text = f"there are more than {MAX_FRAMES_TF} TF frames; the first ones are used"
            self.warnings += [text] if text not in self.warnings else []
            return None
        if edge is None:
            edge = self._edges[message.child] = _Edge(message.parent, topic)
        if edge.parent == message.parent:
            return edge
        used = edge.parent
        if static and edge.fixed is None:
            used = message.parent
            self._edges[message.child] = _Edge(used, topic)
        both = sorted({edge.topic, topic} - {""})
        where = f" (on {' and '.join(both)})" if len(both) > 1 else ""
        parents = f"{edge.parent!r} and {message.parent!r}{where}"
        self._warn(message.child, f"has two parents, {parents}; {used!r} is used")
        return self._edges[message.child] if used == message.parent else None

    def _paths(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Return the frames from each of the two up to their common ancestor, exclusive."""
        above_target, above_source = self.above(target), self.above(source)
        known = set(above_source)
        common = next((frame for frame in above_target if frame in known), None)
        if common is None:
            return None
        return (
            above_target[: above_target.index(common)],
            above_source[: above_source.index(common)],
        )

    def _fixed_product(self, path: Sequence[str]) -> np.ndarray | None:
        T = np.eye(4)
        for frame in path:
            fixed = self._edges[frame].fixed
            if fixed is None:
                return None
            T = matmul(fixed, T)
        return T

    def _product_at(self, path: Sequence[str], stamps_ns: np.ndarray) -> np.ndarray:
        T = np.broadcast_to(np.eye(4), (len(stamps_ns), 4, 4))
        for frame in path:
            edge = self._edges[frame]
            T = matmul(edge.samples.at(stamps_ns) if edge.fixed is None else edge.fixed, T)
        return T

    def _ignore(self, message: TransformMessage) -> None:
        if message.child in self._problems or len(self._problems) < MAX_FRAMES_TF:
            self._problems.setdefault(message.child, message.problem)
            self.ignored[message.child] += 1

    def _warn(self, frame: str, problem: str) -> None:
        if frame not in self._warned:
            self._warned.add(frame)
            self.warnings.append(f"TF frame {frame!r} {problem}")
