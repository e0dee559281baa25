"""The actions of STRANDS' frenap on edges, answered by tidemap; without ROS.

Invariant: an edge has the same numbers in ``predict`` and in ``timeline``, and every goal is answered or refused.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import tidemap
from tidemap import times as _times
from tidemap_ros.link import Link
from tidemap_ros.predecessors import (
    LAST_SECOND, SECOND, TIMES_MAX, Floats, Refused, Seconds, States, checked_count,
)

BATCH = 1000
"""The number of states of one request."""
NOT_COMPARED = -1.0


@dataclass
class EdgesAnswer:
    """A result of the action, and whether the goal has succeeded."""

    success: bool
    message: str
    names: list[str] = field(default_factory=list)
    probabilities: list[float] = field(default_factory=list)
    durations: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Edge:
    """An edge of the topology, with the values that are expected if nothing was reported."""

    start: str
    end: str
    action: str
    length_m: float | None
    nominal_secs: float | None
    reports: int
    success: float
    duration_secs: float

    @property
    def name(self) -> str:
        """The name, as frenap has it."""
        return f"{self.start}->{self.end}" + (f"/{self.action}" if self.action else "")

    def is_called(self, name: str) -> bool:
        """Whether a client means this edge: by frenap's name, or by the name of topological_navigation."""
        return name in (self.name, f"{self.start}_{self.end}")

    @property
    def path(self) -> str:
        """The part of the state names that names the edge."""
        return "/".join(part for part in (self.start, self.end, self.action) if part)

    @property
    def state(self) -> str:
        """The state of its success."""
        return f"edge/{self.path}"

    @property
    def pace(self) -> tuple[str, float] | None:
        """The state of the pace of the edge, and the number that is divided by its value to give seconds."""
        if self.length_m is not None:
            return f"speed/{self.path}", self.length_m
        return None if self.nominal_secs is None else (f"pace/{self.path}", self.nominal_secs)


class Frenap:
    """The server of predictions of edges."""

    def __init__(self, link: Link, map_name: str, now: Callable[[], float] = time.time) -> None:
        self._link, self._states, self._now = link, States(link, map_name), now

    def answer(self, goal: Any, tell: Callable[[str], object]) -> EdgesAnswer:
        """The result of a goal, whatever it is; ``tell`` receives progress messages."""
        try:
            if goal.action == "build":
                return self._build(goal, tell)
            if goal.action == "predict":
                return self._predict(goal)
            if goal.action == "timeline":
                return self._timeline(goal)
            if goal.action == "debug":
                return EdgesAnswer(True, "Nothing is printed: `tidemap topology predict` shows the edges.")
            raise Refused(
                f"Unknown action requested: {goal.action[:100]!r}; known are build, predict, timeline and debug"
            )
        except Refused as refusal:
            return EdgesAnswer(False, str(refusal))
        except tidemap.TidemapError as error:
            return EdgesAnswer(False, f"tidemap: {error}")

    def _edges(self, second: int) -> list[Edge]:
        """All edges, in the order of their numbers."""
        client, asked = self._states.client, {"map": self._states.map_name}
        measures: dict[tuple[str, str, str], dict[str, Any]] = {}
        for edge in client.call("TopologyService/GetTopology", asked)["edges"]:
            measures[_ends(edge["ends"])] = edge
        time_of = _times.timestamp(second * SECOND)
        found = []
        for edge in client.call("RouteService/PredictEdges", {**asked, "time": time_of})["edges"]:
            known = measures.get(_ends(edge["edge"]), {})
            found.append(Edge(
                *_ends(edge["edge"]), known.get("length_m"), known.get("nominal_secs"), int(edge["reports"]),
                float(edge["success"]), float(edge["duration_secs"]),
            ))
        return found

    def _build(self, goal: Any, tell: Callable[[str], object]) -> EdgesAnswer:
        """Learns, and returns how well the models of the edges fit the data from which they were learned."""
        tell("The map learns the reports.")
        self._states.update()
        edges = [edge for edge in self._edges(int(self._now())) if edge.reports]
        present = self._states.names()
        answer = EdgesAnswer(True, f"The models of {len(edges)} edges are built.")
        missing = 0
        for number, edge in enumerate(edges):
            if number % 100 == 0:
                tell(f"Comparing edge {number + 1} of {len(edges)}.")
            wrong, late = self._errors(edge, present, goal.resultOrder, goal.durationOrder)
            missing += wrong == NOT_COMPARED
            answer.names.append(edge.name)
            answer.probabilities.append(wrong)
            answer.durations.append(late)
        if missing:
            answer.message += f" The map does not keep the history of {missing} of them: their errors are -1."
        tell("The models are built and compared.")
        return answer

    def _errors(self, edge: Edge, present: set[str], result_order: int, duration_order: int) -> tuple[float, float]:
        """The share of outcomes on the other side of 0.5 than predicted, and the mean error of durations, seconds."""
        try:
            seconds, outcomes = self._history(edge.state)
            if not len(seconds):
                return NOT_COMPARED, 0.0
            predicted, _ = self._states.predicted([edge.state], seconds, result_order)
            wrong = float(np.mean((predicted[0] >= 0.5) != (outcomes >= 0.5)))
            if edge.pace is None or edge.pace[0] not in present:
                return wrong, 0.0
            seconds, paces = self._history(edge.pace[0])
            expected = self._durations(edge, present, seconds, duration_order)
            driven = edge.pace[1] / paces
            counted = np.isfinite(driven)
            return wrong, float(np.mean(np.abs(expected - driven)[counted])) if counted.any() else 0.0
        except (tidemap.FailedPrecondition, tidemap.InvalidArgument, tidemap.ResourceExhausted):
            # The map keeps no history, none of that time, or more than may be read at once.
            return NOT_COMPARED, NOT_COMPARED

    def _history(self, state: str) -> tuple[Seconds, Floats]:
        """The newest readings of a state."""
        request = {
            "map": self._states.map_name, "state": state, "from_time": _times.timestamp(0),
            "to_time": _times.timestamp(LAST_SECOND * SECOND),
        }
        nanos: list[int] = []
        values: list[float] = []
        for reply in self._states.client.stream("QueryService/Reconstruct", request):
            nanos += reply["times_nanos"]
            values += reply["values"]
        read = np.asarray(values[-TIMES_MAX:], dtype=np.float64)
        return np.asarray(nanos[-TIMES_MAX:], dtype=np.int64) // SECOND, read

    def _successes(self, edge: Edge, present: set[str], seconds: Seconds, order: int) -> Floats:
        if edge.state not in present:
            return np.full(len(seconds), edge.success)
        return np.asarray(self._states.predicted([edge.state], seconds, order)[0][0])

    def _durations(self, edge: Edge, present: set[str], seconds: Seconds, order: int) -> Floats:
        pace = edge.pace
        if pace is None or pace[0] not in present:
            return np.full(len(seconds), edge.duration_secs)
        return _seconds_of(edge, self._states.predicted([pace[0]], seconds, order)[0][0])

    def _predict(self, goal: Any) -> EdgesAnswer:
        second = _second(goal.predictionTime, "predictionTime")
        edges, present = self._edges(second), self._states.names()
        seconds = np.array([second], dtype=np.int64)
        successes = np.array([edge.success for edge in edges])
        durations = np.array([edge.duration_secs for edge in edges])
        reported = [row for row, edge in enumerate(edges) if edge.state in present]
        paced = [(row, edge.pace[0]) for row, edge in enumerate(edges) if edge.pace and edge.pace[0] in present]
        for begin in range(0, len(reported), BATCH):
            rows = reported[begin : begin + BATCH]
            names = [edges[row].state for row in rows]
            successes[rows] = self._states.predicted(names, seconds, goal.resultOrder)[0][:, 0]
        for begin in range(0, len(paced), BATCH):
            part = paced[begin : begin + BATCH]
            paces = self._states.predicted([name for _, name in part], seconds, goal.durationOrder)[0]
            for (row, _), pace in zip(part, paces):
                durations[row] = _seconds_of(edges[row], pace)[0]
        return EdgesAnswer(
            True, f"Predicted {len(edges)} edges.", [edge.name for edge in edges], successes.tolist(),
            durations.tolist(),
        )

    def _timeline(self, goal: Any) -> EdgesAnswer:
        begin, end = _second(goal.startTime, "startTime"), _second(goal.endTime, "endTime")
        step = int(goal.predictionTime)
        if step <= 0:
            raise Refused(f"predictionTime is the step of a timeline, in seconds, and was {step}")
        checked_count(max(math.ceil((end - begin) / step), 0), TIMES_MAX, "times")
        edge = next((one for one in self._edges(begin) if one.is_called(goal.mapName)), None)
        if edge is None:
            raise Refused(f"There is no edge of the name {goal.mapName!r}; names are like A->B")
        seconds, present = np.arange(begin, end, step, dtype=np.int64), self._states.names()
        successes = self._successes(edge, present, seconds, goal.resultOrder)
        durations = self._durations(edge, present, seconds, goal.durationOrder)
        message = f"Predicted the edge {edge.name} at {len(seconds)} times."
        return EdgesAnswer(True, message, [edge.name], successes.tolist(), durations.tolist())


def _seconds_of(edge: Edge, paces: Floats) -> Floats:
    """Durations of an edge; where its model gives no possible value, the expectation of the map."""
    assert edge.pace is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        seconds = edge.pace[1] / paces
    return np.asarray(np.where(np.isfinite(seconds) & (seconds > 0), seconds, edge.duration_secs))


def _ends(edge: dict[str, Any]) -> tuple[str, str, str]:
    return str(edge["from"]), str(edge["to"]), str(edge.get("action", ""))


def _second(value: Any, name: str) -> int:
    if not 0 <= int(value) <= LAST_SECOND:
        raise Refused(f"{name} is {value}: use seconds since 1970, from 0 to {LAST_SECOND}")
    return int(value)
