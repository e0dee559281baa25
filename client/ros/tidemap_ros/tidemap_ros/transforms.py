"""The poses of frames, from tf.

A small buffer in pure Python: a tree of frames, with static transforms and moving ones, which are interpolated at the
requested time. The node feeds it from ``/tf`` and ``/tf_static``.

Invariant: nothing is extrapolated. A pose is either between two received ones, or static, or not given.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

from tidemap_ros import poses
from tidemap_ros.poses import Pose

DEPTH_MAX = 100
"""Longest chain of frames; a longer one is a circle."""
FRAMES_MAX = 10_000
"""Most frames that are kept; tf has far fewer."""


class NoTransform(LookupError):
    """A pose that is not known, and will not be."""


class NotYet(NoTransform):
    """A pose that is not known yet: its time is newer than the received transforms, or a frame was not received yet."""


class _Moving:
    """The poses of a frame in its parent, in the order of their times."""

    def __init__(self) -> None:
        self.times: deque[int] = deque()
        self.poses: deque[Pose] = deque()

    def add(self, stamp_nanos: int, parent_from_child: Pose, kept_nanos: int) -> None:
        if not self.times or stamp_nanos > self.times[-1]:
            self.times.append(stamp_nanos)
            self.poses.append(parent_from_child)
        else:
            at = bisect_left(self.times, stamp_nanos)
            if self.times[at] == stamp_nanos:
                self.poses[at] = parent_from_child
            else:
                self.times.insert(at, stamp_nanos)
                self.poses.insert(at, parent_from_child)
        while self.times[-1] - self.times[0] > kept_nanos:
            self.times.popleft()
            self.poses.popleft()

    def at(self, stamp_nanos: int, tolerance_nanos: int) -> Pose:
        if stamp_nanos > self.times[-1]:
            if stamp_nanos - self.times[-1] <= tolerance_nanos:
                return self.poses[-1]
            late_secs = (stamp_nanos - self.times[-1]) / 1e9
            raise NotYet(f"the newest transform is {late_secs:.3f} s older")
        if stamp_nanos < self.times[0]:
            raise NoTransform(f"the oldest transform is {(self.times[0] - stamp_nanos) / 1e9:.3f} s newer")
        at = bisect_left(self.times, stamp_nanos)
        if self.times[at] == stamp_nanos:
            return self.poses[at]
        before, after = self.times[at - 1], self.times[at]
        return poses.between(self.poses[at - 1], self.poses[at], (stamp_nanos - before) / (after - before))


class Transforms:
    """Frames, and where they were within the last ``kept_secs`` seconds.

    ``tolerance_secs``: a time that is newer than the newest transform by at most this gets the newest transform.
    """

    def __init__(self, kept_secs: float = 30.0, tolerance_secs: float = 0.0) -> None:
        self._kept_nanos = int(kept_secs * 1e9)
        self._tolerance_nanos = int(tolerance_secs * 1e9)
        self._parents: dict[str, str] = {}
        self._static: dict[str, Pose] = {}
        self._moving: dict[str, _Moving] = {}

    def add(self, parent: str, child: str, stamp_nanos: int, parent_from_child: Pose, *, is_static: bool) -> None:
        """Takes a transform. A frame that gets another parent forgets the poses in the previous one."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not parent or not child or parent == child:
            raise NoTransform(f"a transform from {child!r} to {parent!r} connects no two frames")
        if child not in self._parents and len(self._parents) >= FRAMES_MAX:
            raise NoTransform(f"there are {FRAMES_MAX} frames already; {child!r} is not taken")
        if self._parents.get(child) != parent:
            self._moving.pop(child, None)
            self._static.pop(child, None)
            self._parents[child] = parent
        if is_static:
            self._moving.pop(child, None)
            self._static[child] = parent_from_child
        else:
            self._static.pop(child, None)
            self._moving.setdefault(child, _Moving()).add(stamp_nanos, parent_from_child, self._kept_nanos)

    def _chain(self, frame: str) -> list[str]:
        """The frame, its parent, and so on up to the root."""
        chain = [frame]
        while (parent := self._parents.get(chain[-1])) is not None:
            chain.append(parent)
            if len(chain) > DEPTH_MAX:
                raise NoTransform(f"the frames above {frame!r} are a circle")
        return chain

    def _above(self, chain: list[str], stamp_nanos: int) -> Pose:
        """The pose of the first frame of a chain in the last."""
        whole = poses.IDENTITY
        for child in chain[:-1]:
            step = self._static.get(child)
            if step is None:
                try:
                    step = self._moving[child].at(stamp_nanos, self._tolerance_nanos)
                except NoTransform as missing:
                    raise type(missing)(f"from {child!r} to {self._parents[child]!r}: {missing}") from None
            whole = poses.product(step, whole)
        return whole

    def lookup(self, target: str, source: str, stamp_nanos: int) -> Pose:
        """target_from_source at a time; raises :class:`NotYet` or :class:`NoTransform`."""
        target, source = target.lstrip("/"), source.lstrip("/")
        if target == source:
            return poses.IDENTITY
        up, down = self._chain(source), self._chain(target)
        shared = next((frame for frame in up if frame in down), None)
        if shared is None:
            raise NotYet(f"the frames {source!r} and {target!r} are not connected")
        shared_from_source = self._above(up[: up.index(shared) + 1], stamp_nanos)
        shared_from_target = self._above(down[: down.index(shared) + 1], stamp_nanos)
        return poses.product(poses.inverse(shared_from_target), shared_from_source)
