"""The operations of fremenserver and frenap, with a daemon that is played."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace as Message

import numpy as np
import pytest

import tidemap
from tidemap_ros import action_types, predecessors
from tidemap_ros.fremen import Fremen, entropies
from tidemap_ros.frenap import Frenap
from tidemap_ros.predecessors import SECOND

NOON = 1_767_614_400


class Daemon:
    """States with their readings; an update learns their mean, and rhythms add 0.1 each. Edges as they are given."""

    def __init__(self) -> None:
        self.readings: dict[str, list[tuple[int, float]]] = {}
        self.learned: dict[str, list[tuple[int, float]]] = {}
        self.kinds: list[str | None] = []
        self.updates = 0
        self.refusals: list[Message] = []
        self.error: Exception | None = None
        self.edges: list[dict] = []
        self.requests: list[str] = []

    def call(self, method: str, request: dict) -> dict:
        if self.error:
            raise self.error
        self.requests.append(method)
        if method == "QueryService/DescribeModel":
            readings, learned = self._of(request["state"]), self.learned.get(request["state"], [])
            last = {"last_time": tidemap.times.timestamp(max(readings)[0])} if readings else {}
            return {
                "mean": _mean(learned), "learned_observations": len(learned), "observations": len(readings), **last,
                "components": [{"period_secs": 86_400.0, "amplitude": 0.4, "phase_rad": 1.0}],
            }
        if method == "MapService/ListStates":
            return {"states": [{"name": name} for name in self.readings], "next_page_token": ""}
        if method == "TopologyService/GetTopology":
            return {"edges": self.edges}
        assert method == "RouteService/PredictEdges", method
        return {"edges": [
            {"edge": edge["ends"], "reports": len(self.readings.get(f"edge/{_path(edge)}", [])), "success": 0.7,
             "duration_secs": 33.0} for edge in self.edges
        ]}

    def _of(self, name: str) -> list[tuple[int, float]]:
        if name not in self.readings:
            raise tidemap.NotFound(f"no state {name}", "NOT_FOUND")
        return self.readings[name]

    def stream(self, method: str, request: dict):
        if self.error:
            raise self.error
        if method == "QueryService/Reconstruct":
            # In two pieces, as long ones come.
            readings = self._of(request["state"])
            for part in (readings[:1], readings[1:]):
                yield {"times_nanos": [row[0] for row in part], "values": [row[1] for row in part]}
            return
        assert method == "QueryService/PredictStates", method
        order = 15 if request["model"] == "auto" else request["model"]["order"]
        for index, name in enumerate(request["states"]):
            pending = len(self._of(name)) - len(self.learned.get(name, []))
            values = [_mean(self.learned.get(name, [])) + 0.1 * order] * len(request["times_nanos"])
            for first in range(0, len(values), 2):
                yield {"state_index": index, "first_time_index": first, "probabilities": values[first : first + 2],
                       "pending": pending, "axis": 1 if name == "place" else 0}

    def producer(self, map_name: str, name: str, label: str, **options):
        if self.error:
            raise self.error
        self.kinds.append(options["kind"])

        def send(state: str, seconds: float, value: float) -> None:
            assert isinstance(seconds, float)
            self.readings.setdefault(state, []).append((int(seconds * SECOND), value))

        return Message(send=send, flush=lambda: 0, take_refusals=lambda: self.refusals, close=lambda: None,
                       abandon=lambda: None)

    def update(self, map_name: str) -> None:
        self.updates += 1
        self.learned = {name: list(readings) for name, readings in self.readings.items()}

    def erase(self, map_name: str, name: str) -> None:
        del self.readings[name]


def _mean(readings: list[tuple[int, float]]) -> float:
    return float(np.mean([value for _, value in readings])) if readings else 0.5


def _path(edge: dict) -> str:
    return "/".join(part for part in edge["ends"].values() if part)


@pytest.fixture
def daemon():
    return Daemon()


@pytest.fixture
def link(daemon):
    return Message(
        client=daemon, producer_name="robot", ensure_map=lambda: None, map=lambda: {"time_zone": "Europe/Prague"}
    )


def goal(operation: str, **fields) -> Message:
    empty = {"id": "", "ids": [], "times": [], "order": 0, "orders": [], "states": [], "values": [], "confidence": 0.0}
    return Message(**{**empty, "operation": operation, **fields})


def test_readings_are_added_once_and_learned_when_they_are_asked_for(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    added = fremen.answer(goal("add", id="door", times=[1, 2, 3], states=[True, True, False]))
    assert added.is_done and added.success == 3 and daemon.updates == 0
    again = fremen.answer(goal("add", id="door", times=[2, 3, 4], states=[True, False, True]))
    assert again.success == 1 and daemon.readings["door"][-1] == (4 * SECOND, 1.0) and len(daemon.readings["door"]) == 4
    predicted = fremen.answer(goal("predict", id="door", times=[5, 6, 7]))
    assert daemon.updates == 1 and predicted.probabilities == [0.75] * 3 and predicted.success == 3
    assert fremen.answer(goal("predict", id="door", times=[5], order=-1)).probabilities == pytest.approx([2.25])
    assert fremen.answer(goal("predict", id="door", times=[5], order=80)).probabilities == pytest.approx([2.25])
    assert fremen.answer(goal("predict", id="door")).probabilities == [] and daemon.updates == 1


def test_updates_keep_their_distance(daemon, link):
    now = [100.0]
    fremen = Fremen(link, "office", "ros-fremen", 60.0, lambda: now[0])
    for second in (1, 2, 3):
        fremen.answer(goal("add", id="door", times=[second], states=[True]))
        fremen.answer(goal("predict", id="door", times=[9]))
    assert daemon.updates == 1
    now[0] += 60
    fremen.answer(goal("entropy", id="door", times=[9]))
    assert daemon.updates == 2
    assert fremen.answer(goal("update")).success == 1 and daemon.updates == 3


def test_the_kind_of_a_new_state_is_that_of_its_values(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    fremen.answer(goal("addvalues", id="share", times=[1, 2], values=[0.0, 1.0]))
    fremen.answer(goal("addvalues", id="degrees", times=[1], values=[21.5]))
    fremen.answer(goal("addvalues", id="degrees", times=[2], values=[0.5]))
    assert daemon.kinds == [None, "continuous", None]


def test_orders_are_compared_with_what_was_seen(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    # The mean is 0.25, so that orders 0 to 2 predict 0, and orders from 3 on predict 1.
    fremen.answer(goal("add", id="door", times=[1, 2, 3, 4], states=[True, False, False, False]))
    compared = fremen.answer(goal("evaluate", id="door", times=[5, 6, 7, 8], states=[True] * 3 + [False], order=20))
    assert compared.success == 3 and len(compared.errors) == 21
    assert compared.errors[:3] == [0.75] * 3 and set(compared.errors[3:]) == {0.25}
    no_order = goal("evaluate", id="door", times=[1], states=[True], order=-1)
    for wrong in (goal("evaluate", id="door", order=2), no_order):
        assert not fremen.answer(wrong).is_done


def test_states_at_one_time_each_with_its_order(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    for name, state in (("a", True), ("b", False)):
        fremen.answer(goal("add", id=name, times=[1], states=[state]))
    found = fremen.answer(goal("forecast", ids=["b", "x", "a", "b"], times=[9], orders=[0, 1, 2, 3]))
    assert found.success == 3 and found.probabilities == pytest.approx([0.0, -1.0, 1.2, 0.3])
    unsure = fremen.answer(goal("forecastEntropy", ids=["b", "x"], times=[9], order=5))
    assert unsure.entropies == [1.0, -1.0] and not unsure.probabilities
    # Orders of another length do not count.
    assert fremen.answer(goal("forecast", ids=["b"], times=[9], order=1, orders=[7, 7])).probabilities[0] < 0.11
    assert fremen.answer(goal("forecast", times=[9])).success == 0


def test_entropy_is_in_bits():
    assert entropies(np.array([0.5, 0.25, 0.0, 1.0, -0.5, 1.5])) == pytest.approx([1, 0.811278, 0, 0, 0, 0])


def test_anomalies_are_values_far_from_the_prediction(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    fremen.answer(goal("add", id="door", times=[1, 2], states=[True, True]))
    odd = fremen.answer(goal("detect", id="door", times=[3, 4, 5], values=[1.0, 0.0, -7.0], confidence=0.5))
    assert odd.success == 2 and odd.anomaly_times == [4, 5] and odd.anomaly_values == [0, 0]
    before = goal("detect", id="door", times=[3], values=[1.0])
    del before.confidence
    assert fremen.answer(before).success == 0 and not fremen.answer(before).is_done


def test_rhythms_are_told_by_the_clock_of_the_goals(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    fremen.answer(goal("add", id="door", times=[NOON], states=[True]))
    seen = fremen.answer(goal("view", id="door", order=2))
    assert daemon.updates == 1 and seen.success == 2
    assert seen.probabilities == [math.inf, 86_400.0, math.inf] and seen.entropies == [1.0, 0.2, 0.0]
    # The zone is UTC+1 in winter.
    assert seen.errors[1] == pytest.approx(-1.0 - 2 * math.pi / 24)
    assert len(fremen.answer(goal("view", id="door", order=-1)).errors) == 2


def test_refusals_have_codes_and_words(daemon, link):
    fremen = Fremen(link, "office", "ros-fremen", 0.0)
    daemon.readings["place"] = [(1, 1.0)]
    for code, asked in (
        (0, goal("")), (0, goal("dance" * 1000)), (-1, goal("predict", id="door", times=[1])),
        (-1, goal("predict", id="door")), (-1, goal("remove", id="door")), (-3, goal("remove")),
        (-2, goal("add", id="door", times=[1], states=[])),
        (-3, goal("addvalues", id="d", times=[1], values=[math.nan])),
        (-3, goal("addvalues", id="d", times=[1], values=[math.inf])), (-3, goal("predict", id="place", times=[1])),
        (-3, goal("predict", id="door", times=range(predecessors.TIMES_MAX + 1))),
    ):
        refused = fremen.answer(asked)
        assert (refused.is_done, refused.success) == (False, code) and 0 < len(refused.message) < 500, asked
    daemon.refusals = [Message(detail="it is too old")]
    refused = fremen.answer(goal("add", id="door", times=[1, 2], states=[True, True]))
    assert not refused.is_done and "1 of 2" in refused.message and "too old" in refused.message
    for error in (tidemap.Unavailable("no daemon answers"), tidemap.NotFound("no map office", "NOT_FOUND")):
        daemon.error = error
        refused = fremen.answer(goal("forecast", ids=["door"], times=[1]))
        assert refused.success == -3 and str(error) in refused.message
        assert str(error) in Frenap(link, "office").answer(edges_goal("build"), lambda words: None).message


def edges_goal(action: str, **fields) -> Message:
    empty = {"mapName": "", "startTime": 0, "endTime": 0, "predictionTime": 0, "resultOrder": 0, "durationOrder": 0}
    return Message(**{**empty, "action": action, **fields})


def with_edges(daemon: Daemon) -> None:
    def ends(start: str, end: str, action: str = "") -> dict:
        return {"from": start, "to": end, "action": action}

    daemon.edges = [
        {"ends": ends("a", "b"), "nominal_secs": 20.0}, {"ends": ends("b", "c", "lift"), "length_m": 10.0},
        {"ends": ends("c", "a"), "length_m": 5.0},
    ]
    daemon.readings = {
        "edge/a/b": [(second * SECOND, float(second != 3)) for second in range(4)],
        "pace/a/b": [(0, 0.5), (SECOND, 1.0), (2 * SECOND, 1.5)],
        "edge/b/c/lift": [(0, 0.0)], "door": [(0, 1.0)],
    }


def test_edges_are_built_predicted_and_drawn_over_time(daemon, link):
    with_edges(daemon)
    frenap, told = Frenap(link, "office", lambda: NOON), []
    built = frenap.answer(edges_goal("build"), told.append)
    assert built.success and built.names == ["a->b", "b->c/lift"] and daemon.updates == 1 and len(told) == 3
    # One of four runs failed; 40, 20 and 13.3 seconds were driven, and 20 are expected.
    assert built.probabilities == [0.25, 0.0] and built.durations == pytest.approx([(20 + 0 + 20 / 3) / 3, 0.0])
    found = frenap.answer(edges_goal("predict", predictionTime=NOON, resultOrder=1), told.append)
    assert found.names == ["a->b", "b->c/lift", "c->a"]
    assert found.probabilities == pytest.approx([0.85, 0.1, 0.7]) and found.durations == pytest.approx([20, 33, 33])
    for name in ("a->b", "a_b"):
        line = frenap.answer(
            edges_goal("timeline", mapName=name, startTime=NOON, endTime=NOON + 5, predictionTime=2, resultOrder=1),
            told.append,
        )
        assert line.names == ["a->b"] and line.probabilities == pytest.approx([0.85] * 3)
        assert line.durations == pytest.approx([20] * 3)
    assert len(told) == 3
    line = frenap.answer(edges_goal("timeline", mapName="c->a", endTime=2, predictionTime=1), told.append)
    assert line.probabilities == [0.7, 0.7] and line.durations == [33.0, 33.0]
    # Nothing lies between an end that is not behind the start.
    assert frenap.answer(edges_goal("timeline", mapName="a->b", startTime=9, predictionTime=1), told.append).success


def test_a_map_without_history_compares_nothing(daemon, link):
    with_edges(daemon)
    frenap, stream = Frenap(link, "office"), daemon.stream

    def without_history(method: str, request: dict):
        if method == "QueryService/Reconstruct":
            raise tidemap.FailedPrecondition("the map keeps no history")
        return stream(method, request)

    daemon.stream = without_history
    built = frenap.answer(edges_goal("build"), lambda words: None)
    assert built.success and built.probabilities == built.durations == [-1.0, -1.0] and "history of 2" in built.message


@pytest.mark.parametrize("fields", [
    {"action": "dance"}, {"action": "timeline", "mapName": "a->c", "endTime": 5, "predictionTime": 1},
    {"action": "timeline", "mapName": "a->b", "endTime": 5}, {"action": "predict", "predictionTime": -1},
    {"action": "predict", "predictionTime": 2**62},
    {"action": "timeline", "mapName": "a->b", "endTime": predecessors.TIMES_MAX + 1, "predictionTime": 1},
])
def test_goals_on_edges_are_refused_with_words(daemon, link, fields):
    with_edges(daemon)
    refused = Frenap(link, "office").answer(edges_goal(**fields), lambda words: None)
    assert not refused.success and refused.message and not refused.names


def test_a_definition_names_all_its_parts():
    text = action_types.PREDICTION.text({"std_msgs/Header": "uint32 seq"})
    parts = text.split("=" * 80)
    assert len(parts) == 8 and parts[0].startswith("TopologicalPredictionActionGoal action_goal")
    assert parts[-1].strip() == "MSG: std_msgs/Header\nuint32 seq"
    assert action_types.FREMEN.type_name == "fremenserver/FremenAction"


def test_types_that_are_installed_are_used(monkeypatch):
    lines: list[str] = []
    monkeypatch.setitem(sys.modules, "frenap", Message())
    monkeypatch.setitem(sys.modules, "frenap.msg", Message(TopologicalPredictionAction="theirs"))
    assert action_types.action(action_types.PREDICTION, lines.append) == "theirs" and not lines
    monkeypatch.setattr(action_types, "generated", lambda definition: {definition.type_name: "ours"})
    assert action_types.action(action_types.FREMEN, lines.append) == "ours" and "fremenserver.msg" in lines[0]
