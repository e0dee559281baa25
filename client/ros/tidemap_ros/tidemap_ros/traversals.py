"""Traversals of edges, from the reports of navigators.

Invariant: a traversal has the edge and both times that a navigator reported; nothing is reported for an edge whose end
has no reported result.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone
from typing import Any

from tidemap_ros.records import Traversal

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
"""States of goals in ``action_msgs/GoalStatus``."""
GOALS_MAX = 64


class RouteFollower:
    """Feedback and states of Nav2's route action, as traversals.

    ``names`` gives the names of an edge's ends by its number. ``report`` takes each traversal.
    """

    def __init__(
        self, names: Callable[[int], tuple[str, str] | None], report: Callable[[Traversal], object]
    ) -> None:
        self._names = names
        self._report = report
        self._edges: dict[bytes, tuple[int, int]] = {}
        """For each goal, the edge that the robot is on, and the time since when."""

    def feedback(self, goal: bytes, edge: int, now_nanos: int) -> None:
        """The robot is on this edge; if the number differs from the previous one, the robot has arrived at the end of
        the previous edge."""
        before = self._edges.get(goal)
        if before is not None and before[0] == edge:
            return
        if before is not None:
            self._ended(before, now_nanos, True, "")
        elif len(self._edges) >= GOALS_MAX:
            self._edges.pop(next(iter(self._edges)))
        self._edges[goal] = edge, now_nanos

    def status(self, goal: bytes, status: int, now_nanos: int) -> None:
        """A goal has this state. A cancelled goal gives no result for its edge."""
        if status not in (SUCCEEDED, CANCELED, ABORTED):
            return
        before = self._edges.pop(goal, None)
        if before is not None and status != CANCELED:
            self._ended(before, now_nanos, status == SUCCEEDED, "" if status == SUCCEEDED else "the route was aborted")

    def _ended(self, edge: tuple[int, int], now_nanos: int, success: bool, reason: str) -> None:
        ends = self._names(edge[0])
        if ends is not None and now_nanos >= edge[1] and (not success or now_nanos > edge[1]):
            self._report(Traversal(ends[0], ends[1], edge[1], now_nanos, success, "", reason))


def of_statistics(message: Any, now_nanos: int) -> Traversal | None:
    """A ``NavStatistics`` of topological_navigation; ``None`` if it contains no result for an edge.

    The edges are called ``FROM_TO``; ``origin`` and ``target`` are nodes, ``status`` is success, failed or fatal.
    """
    origin, target = str(getattr(message, "origin", "")), str(getattr(message, "target", ""))
    status = str(getattr(message, "status", "")).lower()
    if origin in ("", "none") or target in ("", "none") or origin == target or status not in (
        "success", "failed", "fatal"
    ):
        return None
    start, end = _moment(getattr(message, "date_started", "")), _moment(getattr(message, "date_finished", ""))
    lasted = int(max(float(getattr(message, "operation_time", 0.0) or 0.0), 0.0) * 1e9)
    if end is None:
        end = start + lasted if start is not None else now_nanos
    if start is None:
        start = end - lasted
    success = status == "success"
    if start > end or (success and start == end):
        return None
    return Traversal(origin, target, start, end, success, "", "" if success else status)


_FORMS = ("%A, %B %d %Y, at %H:%M:%S hours", "%Y-%m-%d %H:%M:%S", "%Y-%m-%dT%H:%M:%S")


def _moment(words: Any) -> int | None:
    """A time as topological_navigation writes it, in the time zone of this machine."""
    for form in _FORMS:
        try:
            moment = datetime.strptime(str(words).strip(), form)
        except ValueError:
            continue
        # The time was written by this robot's wall clock.
        return int(moment.astimezone(timezone.utc).timestamp()) * 1_000_000_000
    return None
