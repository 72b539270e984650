"""Transform tree of a log, and motions between any two of its frames."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from jaxdet.elementary import matmul
from jaxdet.errors import TransformError
from jaxdet.io.limits import MAX_FRAMES_TF
from jaxdet.io.messages import TransformMessage
from jaxdet.io.motion import MotionSamples, difference, inverse, motion_matrix
from jaxdet.io.namespaces import namespace_of

_REMEDY = "pass --log.color-from-depth and --log.no-tf, or correct the transforms"


class _Edge:
    """Motion of a frame in its parent."""

    def __init__(self, parent: str, topic: str) -> None:
        self.parent, self.topic = parent, topic
        self.fixed: np.ndarray | None = None
        self.samples = MotionSamples()
        self.once_is_static = False
        self.settled = False
        """Whether the transform is static because its samples are equal, not because of its topic.
        """


class TransformTree:
    """Static and moving transforms; each frame has one parent, the first one found.

    A static transform takes precedence over moving transforms of the same frame. Contradictory
    transforms, and those that are not rigid motions, are ignored and reported in ``warnings``.
    Errors name the ``path`` of the log.

    Attributes:
        ignored: Number of invalid transforms by frame.
    """

    def __init__(self, path: str = "") -> None:
        self.path = path
        self._edges: dict[str, _Edge] = {}
        self._warned: set[str] = set()
        self.warnings: list[str] = []
        self.ignored: Counter[str] = Counter()
        self._problems: dict[str, str] = {}
        """Reason why the first of the ``ignored`` transforms of a frame is invalid, by frame."""
        self._topics: set[str] = set()

    @property
    def frames(self) -> set[str]:
        """Names of all frames."""
        return set(self._edges) | {edge.parent for edge in self._edges.values()}

    @property
    def has_static(self) -> bool:
        """Whether there is a static transform."""
        return any(edge.fixed is not None for edge in self._edges.values())

    @classmethod
    def joined(
        cls, trees: Sequence["TransformTree"], others: Sequence["TransformTree"] = ()
    ) -> "TransformTree":
        """Merge the trees of several namespaces; for a frame in several, the first tree is used.

        Args:
            trees: Trees of the robot's namespaces, in search order.
            others: Trees of other namespaces. Those that contradict the frames found so far belong
                to another robot and are skipped.
        """
        found = cls(next((tree.path for tree in (*trees, *others)), ""))
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
                text = f"is on {used} and on {edge.topic}; {used} is used"
                self._warn(frame, text)
            self._edges.setdefault(frame, edge)
        self.warnings += [text for text in tree.warnings if text not in self.warnings]
        self.ignored.update(tree.ignored)
        self._warned |= tree._warned
        self._topics |= tree._topics

    def _contradicts(self, frame: str, edge: _Edge) -> bool:
        """Return whether another tree has a different transform for this frame."""
        known = self._edges.get(frame)
        if known is None:
            return False
        if known.parent != edge.parent or known.fixed is None or edge.fixed is None:
            return True
        return max(difference(known.fixed, edge.fixed)) > 1e-6

    def uses(self, topic: str, frame: str) -> bool:
        """Return whether transforms of this frame on this topic are used."""
        edge = self._edges.get(frame)
        if edge is None or edge.topic == topic:
            return topic in self._topics
        return edge.fixed is not None and namespace_of(edge.topic) == namespace_of(topic)

    def add(
        self,
        messages: Sequence[TransformMessage],
        static: bool,
        once_is_static: bool = False,
        topic: str = "",
        log_ns: int = 0,
        *,
        is_first: bool = False,
    ) -> None:
        """Add the transforms of a message.

        Args:
            messages: Transforms.
            static: Whether the transforms are valid at all times (``/tf_static``).
            once_is_static: Whether a frame with a single transform is static (for Foxglove, whose
                schemas do not distinguish static and moving transforms).
            topic: Topic of the transforms.
            log_ns: Log time of the message [ns].
            is_first: Whether it is one of the first messages of its topic.
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
                if edge.topic == topic or self._changes_to(topic, message, edge):
                    edge.once_is_static |= once_is_static
                    motion = message.translation, message.rotation
                    edge.samples.add(message.stamp_ns, *motion, log_ns, is_first=is_first)
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
        """Finish the tree: transforms that never change become static.

        Many robots publish constant transforms on ``/tf``, at various rates, and the last message
        may be shortly before the last image.
        """
        for edge in self._edges.values():
            once = edge.once_is_static and len(edge.samples) == 1
            if edge.fixed is None and (once or edge.samples.is_constant()):
                value = edge.samples.values[0]
                edge.fixed = motion_matrix(value[:3], value[3:])
                edge.settled = True
        for frame, problem in sorted(self._problems.items()):
            text = f"TF frame {frame!r}: {self.ignored[frame]} transforms were ignored: {problem}"
            self.warnings.append(text)

    def fixed(self, target: str, source: str) -> np.ndarray | None:
        """Return ``T_target_source`` ``(4, 4)`` from static transforms.

        The result is None if static transforms don't connect the frames.

        Raises:
            TransformError: The transforms form a cycle.
        """
        if self.moving(target, source):
            return None
        T = self.at(target, source, np.zeros(1, np.int64))
        return None if T is None else T[0]

    def at(self, target: str, source: str, stamps_ns: np.ndarray) -> np.ndarray | None:
        """Return ``T_target_source`` at given times, ``(F, 4, 4)``, NaN if unknown.

        The result is None if no chain of static or moving transforms connects the frames.

        Raises:
            TransformError: The transforms form a cycle.
        """
        paths = self._paths(target, source)
        if paths is None:
            return None
        up, down = (self._product_at(path, stamps_ns) for path in paths)
        return matmul(inverse(up), down)

    def distance(self, target: str, source: str) -> int | None:
        """Return the number of transforms between two frames; None if no chain connects them.

        Raises:
            TransformError: The transforms form a cycle.
        """
        paths = self._paths(target, source)
        return None if paths is None else sum(map(len, paths))

    def moving(self, target: str, source: str) -> list[str]:
        """Return the moving frames on the path between two frames."""
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
                topic = ", ".join(sorted(self._topics))
                raise TransformError(problem, path=self.path, topic=topic, remedy=_REMEDY)
            path.append(frame)
            known.add(frame)
        return path

    def sampled_once(self) -> set[str]:
        """Return the frames with a single moving transform, which may or may not change."""
        return {
            frame
            for frame, edge in self._edges.items()
            if len(edge.samples) == 1 and (edge.fixed is None or edge.once_is_static)
        }

    def topic(self, frame: str) -> str:
        """Return the topic of a frame's transforms; empty if unknown."""
        return self._edges[frame].topic if frame in self._edges else ""

    def samples(self, frame: str) -> MotionSamples:
        """Return the samples of a moving frame."""
        return self._edges[frame].samples

    def parent(self, frame: str) -> str | None:
        """Return the parent of a frame; None if it is unknown."""
        return self._edges[frame].parent if frame in self._edges else None

    def agrees(self, message: TransformMessage, static: bool) -> bool:
        """Return whether a transform would change nothing except samples of moving frames."""
        edge = self._edges.get(message.child)
        if edge is None:
            return False
        was_warned = message.child in self._warned
        if edge.parent != message.parent:
            return was_warned and (not static or (edge.fixed is not None and not edge.settled))
        if edge.fixed is None or (static and edge.settled):
            return not static
        if static:
            T = motion_matrix(np.array(message.translation), np.array(message.rotation))
            return was_warned or max(difference(edge.fixed, T)) <= 1e-6
        return not edge.settled or edge.samples.is_like(message, 0)

    def with_samples(self, samples: Mapping[str, MotionSamples]) -> "TransformTree":
        """Return a copy with other samples of the moving frames."""
        tree = TransformTree(self.path)
        for frame, edge in self._edges.items():
            tree._edges[frame] = copy = _Edge(edge.parent, edge.topic)
            copy.fixed, copy.samples = edge.fixed, samples.get(frame, copy.samples)
        return tree

    def _edge(self, message: TransformMessage, static: bool, topic: str) -> _Edge | None:
        """Return the edge for a transform; None if it contradicts the existing edge."""
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

    def _changes_to(self, topic: str, message: TransformMessage, edge: _Edge) -> bool:
        """Return whether a moving frame that is on two topics is used from the second one.

        In this case, the samples from the first one are dropped. The first topic is used, unless
        only the second one is named ``tf``.
        """
        if edge.fixed is not None:
            return False
        first, is_better = edge.topic, topic.endswith("/tf") and not edge.topic.endswith("/tf")
        if message.child not in self._warned and not edge.samples.is_like(message, -1):
            used = topic if is_better else first
            self._warn(message.child, f"is on {first} and on {topic}; {used} is used")
        if is_better:
            edge.topic, edge.samples = topic, MotionSamples()
        return is_better

    def _paths(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Return the paths from both frames up to their common ancestor, exclusive."""
        above_target, above_source = self.above(target), self.above(source)
        known = set(above_source)
        common = next((frame for frame in above_target if frame in known), None)
        if common is None:
            return None
        return (
            above_target[: above_target.index(common)],
            above_source[: above_source.index(common)],
        )

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
