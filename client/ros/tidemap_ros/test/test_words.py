"""Times in words, parameters, route graphs and traversals."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace as Message

import pytest

import tidemap
import tidemap.times
from tidemap_ros import clock_words, graph, parameters, traversals
from tidemap_ros.graph import Node, RouteGraph
from tidemap_ros.parameters import BadParameter, Settings
from tidemap_ros.records import Traversal
from tidemap_ros.traversals import RouteFollower

SECOND = 1_000_000_000
NOW = 1_767_614_400 * SECOND


@pytest.mark.parametrize("words, seconds", [
    ("now", 0), ("", 0), ("+2h", 7200), ("now+2h", 7200), ("now - 1.5 d", -129_600), ("-30min", -1800),
    ("+1w", 604_800), ("2026-01-05T12:00:00Z", 0), ("2026-01-05T13:00:00+01:00", 0), ("2026-01-05 12:00:01Z", 1),
])
def test_times_in_words(words, seconds):
    assert clock_words.nanos(words, NOW) == NOW + seconds * SECOND


@pytest.mark.parametrize("words", ["noon", "2h", "+2", "+2y", "2026-01-05T12:00:00", "1960-01-01T00:00:00Z", "-100000d",
                                   "9999-01-01T00:00:00Z", "+999999999999d"])
def test_words_that_are_no_time_are_refused(words):
    with pytest.raises(clock_words.BadTime):
        clock_words.nanos(words, NOW)


@pytest.mark.parametrize("nanos", [0, 1, 5 * SECOND + 123_456_789, 10**16 - 1, 10**16, NOW + 1])
def test_the_package_takes_times_of_a_simulated_clock(nanos):
    assert tidemap.times.read(clock_words.stated(nanos)).nanos.tolist() == [nanos]


@pytest.mark.parametrize("words, needed", [
    ("now", True), ("", True), (" +2h", True), ("-1d", True), ("now - 1h", True), ("2026-01-05T12:00:00Z", False),
])
def test_only_a_time_of_its_own_needs_no_clock(words, needed):
    assert clock_words.needs_now(words) == needed


def test_parameters_have_types_and_limits():
    settings = Settings({"map_period": 5, "scan_topics": ["front", "", "back"], "map_region": [0, 0, 2, 3.5]})
    assert settings.number("map_period") == 5.0 and settings.texts("scan_topics") == ["front", "back"]
    assert settings.numbers("map_region") == [0.0, 0.0, 2.0, 3.5] and settings.texts("cloud_topics") == []
    for wrong in (
        {"map_period": "soon"}, {"map_period": 0}, {"map_output": "colours"}, {"scan_topics": [1]}, {"flat": 1},
        {"map_region": [0, 0, 1]}, {"map_region": [1, 0, 0, 2]}, {"free_up_to": 0.9}, {"speed_slowest": 120},
        {"dynamic_edges": "/edges"}, {"queue_depth": 1.5}, {"map": 7}, {"map_period": float("nan")},
        {"map_heights": ["a", "b"]},
    ):
        with pytest.raises(BadParameter, match=next(iter(wrong))):
            Settings(wrong)


def test_spools_of_different_producers_are_different_folders(tmp_path):
    names = ["r/1", "r%2f%1", "r 1", "r_1", "řobot"]
    settings = Settings({"spool_dir": str(tmp_path), "map": "office"})
    folders = {settings.spool_folder(name) for name in names}
    assert len(folders) == len(names) and all(folder.parent == tmp_path for folder in folders)


def test_the_read_me_has_all_parameters():
    text = (Path(__file__).parents[1] / "README.md").read_text()
    assert parameters.markdown().strip() in text, "run: python -m tidemap_ros.parameters README.md"


def geojson(**names):
    point = {"type": "Point"}
    return {"type": "FeatureCollection", "features": [
        {"properties": {"id": 0, "metadata": {"name": "hall"}}, "geometry": {**point, "coordinates": [0.0, 0.0]}},
        {"properties": {"id": 1}, "geometry": {**point, "coordinates": [5.1, 0.0]}},
        {"properties": {"id": 2}, "geometry": {**point, "coordinates": [50.0, 0.0]}},
        {"properties": {"id": 3, "startid": 0, "endid": 1}, "geometry": {"type": "MultiLineString", "coordinates": []}},
        {"properties": {"id": 4, "startid": 1, "endid": 0}, "geometry": {"type": "MultiLineString", "coordinates": []}},
        {"properties": {"id": 5, "startid": 1, "endid": 2}, "geometry": {"type": "MultiLineString", "coordinates": []}},
    ]}


TOPOLOGY = [Node("hall", 0.3, 0.0), Node("lab", 5.0, 0.0), Node("attic", None, None)]


def test_edges_of_the_route_graph_get_the_names_of_the_topology(tmp_path):
    path = tmp_path / "graph.geojson"
    path.write_text(json.dumps(geojson()))
    known = RouteGraph.read(path)
    assert known.ends(known.names(TOPOLOGY, 0.5)) == {3: ("hall", "lab"), 4: ("lab", "hall")}
    assert known.ends(known.names(TOPOLOGY, 0.05)) == {}
    path.write_text("{}")
    with pytest.raises(graph.BadGraph):
        RouteGraph.read(path)
    with pytest.raises(graph.BadGraph):
        RouteGraph.read(tmp_path / "missing")


def predicted(start: str, end: str, success: float, secs: float, action: str = ""):
    return {"edge": {"from": start, "to": end, "action": action}, "success": success, "duration_secs": secs}


def test_edges_are_closed_repriced_and_opened_again():
    ends = {3: ("hall", "lab"), 4: ("lab", "hall"), 9: ("moon", "lab")}
    first = graph.repricing(ends, [predicted("hall", "lab", 0.1, 10), predicted("lab", "hall", 0.5, 10)], 0.2, set())
    assert (first.closed, first.opened, first.costs) == ([3], [], [(4, 20.0)])
    later = graph.repricing(ends, [
        predicted("hall", "lab", 0.1, 10), predicted("hall", "lab", 0.8, 12, "lift"), predicted("lab", "hall", 0.9, 9),
    ], 0.2, {3})
    assert (later.closed, later.opened, later.costs) == ([], [3], [(3, 15.0), (4, 10.0)])


def follower() -> tuple[RouteFollower, list[Traversal]]:
    found: list[Traversal] = []
    return RouteFollower({3: ("hall", "lab"), 4: ("lab", "attic")}.get, found.append), found


def test_feedback_of_a_route_becomes_traversals():
    route, found = follower()
    for edge, seconds in ((3, 0), (3, 5), (4, 10), (4, 15)):
        route.feedback(b"goal", edge, seconds * SECOND)
    route.status(b"goal", 2, 16 * SECOND)
    route.status(b"goal", traversals.SUCCEEDED, 20 * SECOND)
    route.status(b"goal", traversals.SUCCEEDED, 30 * SECOND)
    assert found == [
        Traversal("hall", "lab", 0, 10 * SECOND, True), Traversal("lab", "attic", 10 * SECOND, 20 * SECOND, True)
    ]


def test_an_aborted_route_failed_on_its_edge_and_a_cancelled_one_says_nothing():
    route, found = follower()
    route.feedback(b"a", 3, 0)
    route.feedback(b"b", 4, 0)
    route.feedback(b"c", 99, 0)
    route.status(b"a", traversals.ABORTED, 7 * SECOND)
    route.status(b"b", traversals.CANCELED, 7 * SECOND)
    route.status(b"c", traversals.ABORTED, 7 * SECOND)
    assert [(one.from_node, one.success, one.end_nanos) for one in found] == [("hall", False, 7 * SECOND)]


def test_statistics_of_topological_navigation_become_traversals():
    message = Message(
        origin="hall", target="lab", status="failed", operation_time=12.5, date_started="", date_finished=""
    )
    found = traversals.of_statistics(message, NOW)
    assert found == Traversal("hall", "lab", NOW - int(12.5 * SECOND), NOW, False, "", "failed")
    message.status = "success"
    assert traversals.of_statistics(message, NOW).success
    for changes in ({"origin": "none"}, {"target": "hall"}, {"status": "active"}, {"operation_time": 0.0}):
        assert traversals.of_statistics(Message(**{**vars(message), **changes}), NOW) is None
