"""The actions of fremenserver and frenap: real clients of actionlib, a real master, the node and a real daemon."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import publisher, until

rospy = pytest.importorskip("rospy", reason="ROS 1 is not installed: python3-rospy of Debian")
actionlib = pytest.importorskip("actionlib", reason="actionlib is not installed: python3-actionlib of Debian")
from actionlib_msgs.msg import GoalStatus  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402

from tidemap_ros import action_types  # noqa: E402

DAY, HOUR = 86_400, 3600
MONDAY = 1_767_571_200
"""2026-01-05T00:00:00Z."""

# Made with genmsg from the definitions as they are published in strands-project/fremen:
# FremenServer/action/Fremen.action of commit 84e5bf74b684707f9f197d471203b8f8e54edbac (with `detect`) and of
# 097cdb66500e02e90bd910f33270475278521fbb (without), frenap/action/TopologicalPrediction.action of
# 2fb4f5044522e2d4c2cddc7d0fd3d758b29e5e5a. The definitions of Action, Goal and Result of the first are also in the code
# that catkin has generated in workspaces of users: AdrianKlei/Studienarbeit and AdrianKlei/fremen_ws.
FEEDBACK_SUMS = {"Feedback": "4fe5af303955c287688e7347e9b00278", "ActionFeedback": "82e97615735594b25e2cee3da22d3eb7"}
SUMS = [
    (action_types.FREMEN, {
        "Action": "14f6cce3a70244709ad0705f23811952", "Goal": "3da51b48cac313fb0b866f25a6c94989",
        "Result": "c4d21afc2fe08d781143d26587909bbe", "ActionGoal": "eccf1b2174bc29e6477991e5b4b82f80",
        "ActionResult": "d485b344797f24403569b5e5e975c9a4", **FEEDBACK_SUMS,
    }),
    (action_types.FREMEN_BEFORE_DETECT, {
        "Action": "78731a0ff15577df44450998cd09c106", "Goal": "0b0c44f9f5a040a05bb5b5c0b3482af4",
        "Result": "a8cbeb44431fdd2d4d33e2b471db237b", "ActionGoal": "dec4a8c4a39a668d261fd76a4ee9487c",
        "ActionResult": "ba1ee54dd664ad631ee62c8740d9d6b7", **FEEDBACK_SUMS,
    }),
    (action_types.PREDICTION, {
        "Action": "f0e41b335896120494c240efce169553", "Goal": "2b9632b310eda84fe9d9fcff5945e504",
        "Result": "eca3d846bb48a0fe7a7987894c9fa0f9", "ActionGoal": "51c7ba61b25eeb84beaeea4e69b350e9",
        "ActionResult": "476d7fdb70239a93477ecd48f90d21c9", **FEEDBACK_SUMS,
    }),
]


@pytest.mark.parametrize("definition, sums", SUMS)
def test_types_have_the_sums_of_the_published_definitions(definition, sums):
    made = action_types.generated(definition)
    assert {name: made[f"{definition.package}/{definition.name}{name}"]._md5sum for name in sums} == sums


class Peer:
    """A client of an action, as a robot of that time has it."""

    def __init__(self, name: str, definition) -> None:
        self.kind = action_types.generated(definition)[definition.type_name]
        self.goal_kind = type(self.kind().action_goal.goal)
        self.client = actionlib.SimpleActionClient(name, self.kind)
        assert self.client.wait_for_server(rospy.Duration(60)), f"nobody answers {name}"
        self.told: list[str] = []

    def __call__(self, **fields):
        self.client.send_goal(self.goal_kind(**fields), feedback_cb=lambda feedback: self.told.append(feedback.status))
        assert self.client.wait_for_result(rospy.Duration(120)), f"no result for {fields}"
        self.state = self.client.get_state()
        return self.client.get_result()

    def done(self, **fields):
        result = self(**fields)
        assert self.state == GoalStatus.SUCCEEDED, result
        return result

    def refused(self, **fields):
        result = self(**fields)
        assert self.state == GoalStatus.ABORTED and result.message, result
        assert self.client.get_goal_status_text() == result.message
        return result


def is_open(seconds: np.ndarray) -> np.ndarray:
    """A door that is open from 8 to 18 o'clock."""
    hours = seconds % DAY // HOUR
    return (hours >= 8) & (hours < 18)


TWO_WEEKS = np.arange(MONDAY, MONDAY + 14 * DAY, 600)
NEXT_DAY = np.arange(MONDAY + 14 * DAY, MONDAY + 15 * DAY, 1800)
TESTS = {"times": NEXT_DAY.tolist(), "states": is_open(NEXT_DAY).tolist()}


def taught(bench, **parameters) -> Peer:
    bench.start(create_map=True, map_topic="", fremen_action="/fremenserver", **parameters)
    peer = Peer("/fremenserver", action_types.FREMEN)
    # Teaches half of the readings, then all of them again, as clients of fremenserver do.
    for part, added in ((TWO_WEEKS[:1000], 1000), (TWO_WEEKS, 1016), (TWO_WEEKS, 0)):
        result = peer.done(operation="add", id="door", times=part.tolist(), states=is_open(part).tolist())
        assert result.success == added and "door" in result.message
    return peer


def test_a_client_of_fremenserver_learns_and_predicts(bench):
    heard: list[bool] = []
    rospy.Subscriber("/fremenserver_start", Bool, lambda message: heard.append(message.data))
    peer = taught(bench)
    until(lambda: heard == [True], "the word that the server has started")
    # The data that the action reports as durable is there.
    assert len(bench.history("door")) == len(TWO_WEEKS)

    predicted = peer.done(operation="predict", id="door", times=NEXT_DAY.tolist(), order=2)
    probabilities = np.array(predicted.probabilities)
    assert predicted.success == len(NEXT_DAY) and not predicted.entropies
    assert np.mean((probabilities > 0.5) == is_open(NEXT_DAY)) > 0.9
    static = peer.done(operation="predict", id="door", times=NEXT_DAY.tolist(), order=0).probabilities
    assert np.ptp(static) < 1e-6 and static[0] == pytest.approx(10 / 24, abs=0.02)
    best = peer.done(operation="predict", id="door", times=NEXT_DAY.tolist(), order=-1).probabilities
    assert np.mean((np.array(best) > 0.5) == is_open(NEXT_DAY)) > 0.95

    bits = np.array(peer.done(operation="entropy", id="door", times=NEXT_DAY.tolist(), order=2).entropies)
    inside = np.clip(probabilities, 1e-12, 1 - 1e-12)
    assert bits == pytest.approx(-(inside * np.log2(inside) + (1 - inside) * np.log2(1 - inside)), abs=1e-4)

    compared = peer.done(operation="evaluate", id="door", order=3, **TESTS)
    assert len(compared.errors) == 4 and compared.errors[0] == pytest.approx(10 / 24, abs=0.01)
    assert compared.success > 0 and compared.errors[compared.success] < 0.1

    noon = int(MONDAY + 14 * DAY + 12 * HOUR)
    forecast = peer.done(operation="forecast", ids=["door", "nowhere", "door"], times=[noon], orders=[2, 2, 0])
    assert forecast.success == 2 and forecast.probabilities[1] == -1
    assert forecast.probabilities[0] > 0.8 and forecast.probabilities[2] == pytest.approx(static[0])
    unsure = peer.done(operation="forecastEntropy", ids=["door", "nowhere"], times=[noon], order=0)
    assert unsure.entropies[0] > 0.9 and unsure.entropies[1] == -1 and not unsure.probabilities

    odd = peer.done(operation="detect", id="door", times=[noon, noon + 12 * HOUR], values=[0, 0], order=2,
                    confidence=0.8)
    assert odd.success == 1 and list(odd.anomalyTimes) == [noon] and list(odd.anomalyValues) == [0]


def test_the_rhythms_that_are_viewed_are_those_that_predict(bench):
    # Local time is later than UTC, and times of goals are in UTC.
    peer = taught(bench, time_zone="Europe/Prague")
    seen = peer.done(operation="view", id="door", order=2)
    assert seen.success == 2 and len(seen.errors) == 3
    assert math.isinf(seen.probabilities[0]) and seen.probabilities[1] == pytest.approx(DAY)
    expected = np.full(len(NEXT_DAY), seen.entropies[0])
    for period, amplitude, phase in list(zip(seen.probabilities, seen.entropies, seen.errors))[1:]:
        expected += 2 * amplitude * np.cos(2 * np.pi * NEXT_DAY / period - phase)
    predicted = peer.done(operation="predict", id="door", times=NEXT_DAY.tolist(), order=2).probabilities
    assert np.array(predicted) == pytest.approx(np.clip(expected, 0, 1), abs=0.01)


def test_values_and_removal(bench):
    peer = taught(bench)
    warmth = 0.5 + 0.4 * np.cos(2 * np.pi * TWO_WEEKS / DAY)
    added = peer.done(operation="addvalues", id="warmth", times=TWO_WEEKS.tolist(), values=warmth.tolist())
    assert added.success == 2016
    predicted = peer.done(operation="predict", id="warmth", times=[int(MONDAY + 14 * DAY)], order=1)
    assert predicted.probabilities[0] == pytest.approx(0.9, abs=0.03)
    # Values beyond 0 to 1 make a state of another kind.
    degrees = (20 + 10 * warmth).tolist()
    assert peer.done(operation="addvalues", id="degrees", times=TWO_WEEKS.tolist(), values=degrees).success == 2016
    predicted = peer.done(operation="predict", id="degrees", times=[int(MONDAY + 14 * DAY)], order=1)
    assert predicted.probabilities[0] == pytest.approx(29, abs=0.5)
    assert peer.done(operation="update").success == 1 and peer.done(operation="debug").success == 1

    assert peer.done(operation="remove", id="warmth").success == 3
    assert peer.done(operation="delete", id="degrees").success == 2
    assert peer.refused(operation="predict", id="warmth", times=[0]).success == -1
    # A removed state begins anew.
    assert peer.done(operation="add", id="warmth", times=[5, 6], states=[True, False]).success == 2


def test_what_cannot_be_done_is_refused_and_the_node_goes_on(bench):
    bench.start(create_map=True, map_topic="", fremen_action="/fremenserver")
    peer = Peer("/fremenserver", action_types.FREMEN)
    many = [0] * 100_001
    for code, goal in (
        (0, {"operation": "dance"}), (0, {}), (-1, {"operation": "predict", "id": "door", "times": [1]}),
        (-2, {"operation": "add", "id": "door", "times": [1, 2], "states": [True]}),
        (-2, {"operation": "addvalues", "id": "door", "times": [1, 2], "values": [1.0]}),
        (-2, {"operation": "evaluate", "id": "door", "times": [1, 2], "states": [True]}),
        (-3, {"operation": "addvalues", "id": "door", "times": [1, 2], "values": [1.0, math.nan]}),
        (-3, {"operation": "add", "times": [1], "states": [True]}),
        (-3, {"operation": "add", "id": "cell/1/2/3", "times": [1], "states": [True]}),
        (-3, {"operation": "predict", "id": "door", "times": many}),
        (-3, {"operation": "predict", "id": "door", "times": [1], "order": 101}),
        (-3, {"operation": "forecast", "ids": ["door"] * 10_001, "times": [1]}),
        (-1, {"operation": "forecast", "ids": ["door"], "times": [1, 2]}),
        (-1, {"operation": "remove", "id": "door"}), (-1, {"operation": "view", "id": "door", "order": 2}),
        (-1, {"operation": "detect", "id": "door", "times": [1], "values": [1.0]}),
    ):
        assert peer.refused(**goal).success == code, goal
    assert peer.done(operation="add", id="door", times=[0, 4_294_967_295], states=[True, False]).success == 2
    assert len(peer.done(operation="predict", id="door", times=[0, 4_294_967_295], order=100).probabilities) == 2


def test_a_daemon_that_is_stopped_is_told_and_then_used_again(bench):
    peer = taught(bench)
    bench.daemon.stop()
    later = (NEXT_DAY.tolist(), is_open(NEXT_DAY).tolist())
    for goal in (
        {"operation": "predict", "id": "door", "times": [MONDAY]},
        {"operation": "add", "id": "door", "times": later[0], "states": later[1]},
    ):
        refusal = peer.refused(**goal)
        assert refusal.success == -3 and bench.server in refusal.message, refusal
    bench.restart()
    added = peer.done(operation="add", id="door", times=later[0], states=later[1])
    assert added.success == len(NEXT_DAY) and len(bench.history("door")) == len(TWO_WEEKS) + len(NEXT_DAY)


def test_clients_of_the_definition_before_detect(bench):
    bench.start(create_map=True, map_topic="", fremen_action="/before/fremenserver", fremen_detect=False)
    # The action has another name, because a process of ROS 1 has one type for each topic, and the tests above are
    # clients of the newest type.
    peer = Peer("/before/fremenserver", action_types.FREMEN_BEFORE_DETECT)
    assert peer.done(operation="add", id="door", times=[1, 2, 3], states=[True, True, False]).success == 3
    assert peer.done(operation="predict", id="door", times=[9]).probabilities[0] == pytest.approx(2 / 3, abs=0.2)
    assert peer.refused(operation="detect", id="door", times=[9]).success == 0


def test_a_client_of_frenap_builds_and_predicts(bench):
    bench.client.create_map("office")
    bench.client.call("TopologyService/LoadTopology", {"map": "office", "nodes": [
        {"name": "hall"}, {"name": "lab"}, {"name": "store"},
    ], "edges": [
        {"ends": {"from": "hall", "to": "lab"}, "nominal_secs": 20},
        {"ends": {"from": "lab", "to": "store"}, "length_m": 10},
        {"ends": {"from": "store", "to": "hall"}, "nominal_secs": 30},
    ]})
    starts = np.arange(MONDAY, MONDAY + 14 * DAY, HOUR)
    rows: dict[str, list] = {"from": [], "to": [], "start": [], "end": [], "success": []}
    for number, start in enumerate(starts.tolist()):
        passes = bool(is_open(np.array([start]))[0])
        secs = 25 if number % 2 else 15
        for ends, success, lasted in ((("hall", "lab"), passes, secs), (("lab", "store"), True, 20)):
            for name, cell in zip(rows, (*ends, float(start), float(start + lasted), success)):
                rows[name].append(cell)
    bench.client.traverse("office", rows, producer="other")
    bench.start(map_topic="", prediction_action="/FreNaP")
    peer = Peer("/FreNaP", action_types.PREDICTION)

    built = peer.done(action="build", mapName="office", resultOrder=2, durationOrder=0)
    assert built.success and built.edgeName == ["hall->lab", "lab->store"]
    assert built.probability[0] < 0.1 and built.probability[1] == 0
    assert 3 < built.duration[0] < 7 and built.duration[1] == pytest.approx(0, abs=0.1)
    # A client takes no feedback that comes after the result.
    until(lambda: peer.done(action="build").success and peer.told, "feedback")

    noon, night = int(MONDAY + 14 * DAY + 12 * HOUR), int(MONDAY + 14 * DAY)
    day = peer.done(action="predict", predictionTime=noon, resultOrder=2)
    assert day.edgeName == ["hall->lab", "lab->store", "store->hall"]
    assert day.probability[0] > 0.8 and day.probability[1] > 0.95 and 0 < day.probability[2] < 1
    assert day.duration[1] == pytest.approx(20, abs=0.5) and day.duration[2] == pytest.approx(30, abs=10)
    dark = peer.done(action="predict", predictionTime=night, resultOrder=2)
    assert dark.probability[0] < 0.2

    for name in ("hall->lab", "hall_lab"):
        line = peer.done(action="timeline", mapName=name, startTime=night, endTime=night + DAY, predictionTime=1800,
                         resultOrder=2)
        assert line.edgeName == ["hall->lab"] and len(line.probability) == len(line.duration) == 48
        assert line.probability[24] == pytest.approx(day.probability[0], abs=1e-6)
        assert line.duration[24] == pytest.approx(day.duration[0], abs=1e-4)
    static = peer.done(action="timeline", mapName="hall->lab", startTime=night, endTime=night + DAY,
                       predictionTime=3600)
    assert np.ptp(static.probability) < 1e-6
    for goal in (
        {"action": "timeline", "mapName": "nowhere", "endTime": 5, "predictionTime": 1},
        {"action": "timeline", "mapName": "hall->lab", "endTime": 5},
        {"action": "timeline", "mapName": "hall->lab", "endTime": 2**40, "predictionTime": 1},
        {"action": "timeline", "mapName": "hall->lab", "endTime": 10**9, "predictionTime": 1},
        {"action": "predict", "predictionTime": -5}, {"action": "dance"},
    ):
        assert not peer.refused(**goal).success
    bench.daemon.stop()
    assert bench.server in peer.refused(action="build").message


def test_what_the_node_hears_of_edges_is_built(bench):
    bench.client.create_map("office")
    bench.client.call("TopologyService/LoadTopology", {
        "map": "office", "nodes": [{"name": "hall"}, {"name": "lab"}],
        "edges": [{"ends": {"from": "hall", "to": "lab"}, "nominal_secs": 20}],
    })
    bench.start(map_topic="", prediction_action="/FreNaP")
    from std_msgs.msg import String
    traverse = publisher(String, "/tidemap/traverse")
    for number in range(20):
        start = MONDAY + number * HOUR
        traverse.publish(String(
            f'{{"from": "hall", "to": "lab", "start": {start}, "end": {start + 20}, "success": true}}'
        ))
    until(lambda: bench.values("daemon").get("records durable") == "20", "durable traversals")
    peer = Peer("/FreNaP", action_types.PREDICTION)
    assert peer.done(action="build").edgeName == ["hall->lab"]
    assert peer.done(action="predict", predictionTime=MONDAY + DAY).probability[0] > 0.9
