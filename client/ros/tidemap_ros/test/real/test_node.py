"""The node with real ROS and a real daemon: in, out, and nothing lost."""

from __future__ import annotations

import json
import math
import signal
import time

import numpy as np
import pytest
from conftest import LATCHED, RELIABLE, cell, until, values
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap, LoadMap
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import LaserScan, PointCloud2, PointField
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

SECOND = 1_000_000_000


def stamped(message, frame: str, nanos: int):
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(nanos, SECOND)
    return message


def transform(x: float, y: float, nanos: int) -> TransformStamped:
    message = stamped(TransformStamped(), "map", nanos)
    message.child_frame_id = "laser"
    message.transform.translation.x, message.transform.translation.y = x, y
    message.transform.rotation.w = 1.0
    return message


def scan(nanos: int, distance: float = 2.02) -> LaserScan:
    message = stamped(LaserScan(), "laser", nanos)
    message.angle_min, message.angle_max, message.angle_increment = -math.pi, math.pi, math.pi / 180
    message.range_min, message.range_max = 0.05, 20.0
    message.ranges = [distance] * 361
    return message


def cloud(points: np.ndarray, nanos: int, frame: str = "map") -> PointCloud2:
    message = stamped(PointCloud2(), frame, nanos)
    message.height, message.width, message.point_step = 1, len(points), 16
    message.row_step = 16 * len(points)
    message.fields = [
        PointField(name=name, offset=4 * axis, datatype=PointField.FLOAT32, count=1) for axis, name in enumerate("xyz")
    ]
    raw = np.zeros((len(points), 4), dtype=np.float32)
    raw[:, :3] = points
    message.data.frombytes(raw.tobytes())
    return message


def last_values(heard: list, name: str) -> dict[str, str]:
    return values(heard[-1]).get(name, {}) if heard else {}


def text_of(**fields) -> String:
    return String(data=json.dumps(fields))


def test_scans_become_the_map_that_a_late_joiner_gets(bench, peer):
    bench.node(create_map=True, resolution=0.1, transform_topics=["/transforms"])
    transforms = peer.publisher(TransformStamped, "/transforms")
    scans = peer.publisher(LaserScan, "/scan")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    start = time.time_ns()
    for tenth in range(11):
        transforms.publish(transform(tenth / 10, 0.0, start + tenth * SECOND // 10))
    for tenth in range(10):
        scans.publish(scan(start + tenth * SECOND // 10 + SECOND // 20, 5.02))
    until(lambda: last_values(heard, "daemon").get("records durable") == "10", "ten durable scans")
    assert last_values(heard, "observations")["taken"] == "10"
    assert bench.client.map("office")["grid_summary"]["scans"] == 10
    late = peer.heard(OccupancyGrid, "/map")
    message = until(lambda: late and late[-1], "a latched map")
    # The last scan was taken at x = 0.95, between two transforms: the wall in front of it is at 5.97. Nearer, all is
    # free.
    assert (message.header.frame_id, round(message.info.resolution, 6)) == ("map", 0.1)
    assert cell(message, 5.95, 0.05) == 100 and cell(message, 2.05, 0.05) == 0 and -1 in message.data
    reply = peer.ask(GetMap, "/tidemap/get_map", GetMap.Request())
    assert reply.map.info.origin == message.info.origin and cell(reply.map, 5.95, 0.05) == 100


def test_an_observation_without_its_transform_is_told(bench, peer):
    bench.node(create_map=True, tf_wait=0.2)
    scans = peer.publisher(LaserScan, "/scan")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    scans.publish(scan(time.time_ns()))
    until(lambda: last_values(heard, "observations").get("left out: no transform") == "1", "a scan that is left out")
    assert last_values(heard, "observations")["level"] == "1"


def week_of_a_door(bench) -> int:
    """A map with a door in a wall that is shut at night, learned; returns a midnight."""
    client = bench.client
    client.create_map("office", grid_resolution_m=0.5, grid={"flat": True})
    seen = np.zeros((14 * 24, 16, 20), dtype=np.int8)
    day = np.arange(14 * 24) % 24
    seen[:, 4, :] = 1
    seen[:, 4, 7] = (day < 8) | (day >= 18)
    times = np.datetime64("2026-01-05T00", "ns") + np.arange(14 * 24) * np.timedelta64(1, "h")
    client.observe_grids("office", times, seen)
    client.update("office")
    return int(np.datetime64("2026-01-19T00", "ns").astype(np.int64))


def test_the_map_at_any_time(bench, peer):
    week_of_a_door(bench)
    bench.node(map_time="2026-01-19T12:00:00Z")
    heard = peer.heard(OccupancyGrid, "/map")
    noon = until(lambda: heard and heard[-1], "a map")
    assert (noon.info.width, noon.info.height) == (20, 16)
    assert cell(noon, 3.75, 2.25) == 0 and cell(noon, 3.25, 2.25) == 100
    assert noon.info.map_load_time.sec == int(np.datetime64("2026-01-19T12:00:00").astype(np.int64))

    def at(words: str) -> LoadMap.Response:
        return peer.ask(LoadMap, "/tidemap/get_map_at", LoadMap.Request(map_url=words))

    night = at("2026-01-19T03:00:00Z")
    assert night.result == LoadMap.Response.RESULT_SUCCESS and cell(night.map, 3.75, 2.25) == 100
    assert (night.map.info.width, night.map.info.origin) == (20, noon.info.origin)
    probable = at("2026-01-19T03:00:00Z?probability").map
    assert 50 < cell(probable, 3.75, 2.25) <= 100
    assert cell(at("2026-01-19T08:00:00Z?entropy").map, 3.75, 2.25) > cell(at("now?entropy").map, 3.25, 2.25)
    assert at("at noon").result == LoadMap.Response.RESULT_INVALID_MAP_METADATA
    assert at("now?colours").result == LoadMap.Response.RESULT_INVALID_MAP_METADATA
    # Another time while it runs.

    def change(words: str):
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=words)
        request = SetParameters.Request(parameters=[Parameter(name="map_time", value=value)])
        return peer.ask(SetParameters, "/tidemap/set_parameters", request).results[0]

    assert change("2026-01-19T03:00:00Z").successful
    until(lambda: cell(heard[-1], 3.75, 2.25) == 100, "the map of the night")
    refused = change("at noon")
    assert not refused.successful and "at noon" in refused.reason
    # The map grows; the published region does not.
    later, far = [np.datetime64("2026-01-20T00", "ns")], np.ones((1, 2, 2), np.int8)
    bench.client.observe_grids("office", later, far, first_cell=(40, 40, 0), label="far")
    count = len(heard)
    until(lambda: len(heard) > count + 1, "another map")
    assert heard[-1].info.width == 20 and len(heard[-1].data) == 320
    told = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    until(lambda: "map_region" in last_values(told, "map").get("message", ""), "that the map has grown")


def test_grids_of_any_cells_become_the_map(bench, peer):
    bench.node(create_map=True, resolution=0.5, grid_topics=["/slam"], scan_topics=[""])
    grids = peer.publisher(OccupancyGrid, "/slam", LATCHED)
    message = stamped(OccupancyGrid(), "map", time.time_ns())
    message.info.resolution, message.info.width, message.info.height = 0.25, 4, 2
    message.info.origin.position.x, message.info.origin.orientation.w = 10.0, 1.0
    message.data = [0, 100, -1, -1, 0, 0, -1, 0]
    grids.publish(message)
    heard = peer.heard(OccupancyGrid, "/map")
    shown = until(lambda: heard and heard[-1], "a map")
    assert (shown.info.width, shown.info.height, shown.info.origin.position.x) == (2, 1, 10.0)
    assert list(shown.data) == [100, 0]


def test_topology_and_traversals(bench, peer):
    bench.client.create_map("office")
    nodes = {"name": ["hall", "lab"], "x_m": [0.0, 5.0], "y_m": [0.0, 1.0], "yaw_rad": [0.0, 0.0]}
    bench.client.load_topology("office", {"from": ["hall"], "to": ["lab"], "length_m": [5.0]}, nodes)
    bench.node(map_topic="")
    traverse = peer.publisher(String, "/tidemap/traverse")
    now = time.time()
    traverse.publish(text_of(**{"from": "hall", "to": "lab"}, start=now - 10, end=now, success=True))
    traverse.publish(text_of(**{"from": "hall", "to": "lab"}, start=now - 5, end=now, success=False, reason="a person"))
    until(lambda: len(bench.history("edge/hall/lab")) == 2, "two traversals")
    assert [value for _, value in bench.history("edge/hall/lab")] == [1, 0]
    heard = peer.heard(MarkerArray, "/tidemap/topology")
    shown = until(lambda: heard and heard[-1], "markers")
    kinds = [marker.ns for marker in shown.markers[1:]]
    assert kinds == ["nodes", "names", "nodes", "names", "edges"] and shown.markers[2].text == "hall"
    until(lambda: heard[-1].markers[-1].color.a == 1.0, "an edge with reports")


def test_masks(bench, peer):
    week_of_a_door(bench)
    bench.node(
        map_time="2026-01-19T12:00:00Z", keepout_source="occupancy", speed_source="entropy", speed_full_at=0.5,
        mask_period=1.0,
    )
    keepout, speed = (peer.heard(OccupancyGrid, f"/tidemap/{name}_mask") for name in ("keepout", "speed"))
    until(lambda: keepout and speed, "both masks")
    assert cell(keepout[-1], 3.25, 2.25) == 100 and cell(keepout[-1], 1.0, 1.0) == 0
    assert set(keepout[-1].data) == {0, 100} and 0 <= min(speed[-1].data) and max(speed[-1].data) <= 80


@pytest.mark.parametrize("heights, high", [([], 100), ([0.0, 1.5], 0)])
def test_a_map_in_three_dimensions_shows_the_heights_that_count(bench, peer, heights, high):
    bench.node(create_map=True, resolution=0.5, flat=False, cloud_topics=["/points"], map_heights=heights)
    clouds = peer.publisher(PointCloud2, "/points")
    # A box on the floor, and a lamp above a way that was seen to be free.
    points = np.array([[3.2, 0.2, 0.2], [0.2, 3.2, 2.2], [0.2, 6.2, 0.2], [np.nan, 0, 0]], dtype=np.float32)
    clouds.publish(cloud(points, time.time_ns()))
    heard = peer.heard(OccupancyGrid, "/map")
    shown = until(lambda: heard and heard[-1], "a map")
    assert cell(shown, 3.2, 0.2) == 100 and cell(shown, 1.2, 0.2) == 0 and cell(shown, 0.2, 3.2) == high


def test_people_slow_robots_down_where_they_are_expected(bench, peer):
    bench.client.create_map("office", grid_resolution_m=0.5, grid={"flat": True})
    times = np.datetime64("2026-01-05T00", "ns") + np.arange(14 * 48) * np.timedelta64(30, "m")
    # Every half hour somebody walks by at x = 3, y = 2; by day only.
    times = times[np.arange(14 * 48) % 48 >= 24]
    for state, place in (("people", [3.2, 2.2]), ("people_velocity", [1.0, 0.0])):
        bench.client.observe("office", states=state, times=times, values=np.tile(place, (len(times), 1)), label=state)
    floor = np.zeros((1, 10, 20), dtype=np.int8)
    bench.client.observe_grids("office", times[:1], floor)
    bench.client.update("office")
    bench.node(map_time="2026-01-19T18:00:00Z", speed_source="people", speed_full_at=0.1, mask_period=1.0)
    heard = peer.heard(OccupancyGrid, "/tidemap/speed_mask")
    mask = until(lambda: heard and heard[-1], "a mask")
    assert (mask.info.width, mask.info.height) == (20, 10)
    assert cell(mask, 3.2, 2.2) > 40 and cell(mask, 8.2, 2.2) == 0


def observed(count: int, first: int = 0) -> list[tuple[int, float]]:
    """Times and values that are all different."""
    return [((1_767_614_400 + number) * SECOND, float(number % 2)) for number in range(first, first + count)]


def say(publisher, rows: list[tuple[int, float]]) -> None:
    for nanos, value in rows:
        publisher.publish(text_of(state="door", value=value, stamp=nanos // SECOND))
        time.sleep(0.001)


def test_a_daemon_that_is_killed_and_away_costs_nothing(bench, peer):
    bench.client.create_map("office")
    bench.node()
    observe = peer.publisher(String, "/tidemap/observe")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    rows = observed(600)
    say(observe, rows[:200])
    bench.daemon.kill()
    say(observe, rows[200:400])
    until(lambda: last_values(heard, "daemon").get("level") == "2", "an error in diagnostics")
    until(lambda: int(last_values(heard, "daemon")["records waiting"]) >= 200, "records that wait")
    bench.daemon_again()
    say(observe, rows[400:])
    until(lambda: len(bench.history("door")) >= 600, "all observations")
    until(lambda: last_values(heard, "daemon").get("records waiting") == "0", "no record that waits")
    assert bench.history("door") == rows and last_values(heard, "daemon")["level"] == "0"


def test_a_simulated_clock_begins_at_zero(bench, peer):
    bench.client.create_map("office")
    bench.node()
    observe = peer.publisher(String, "/tidemap/observe")
    rows = [(second * SECOND, float(second % 2)) for second in range(1, 21)]
    say(observe, rows)
    until(lambda: len(bench.history("door")) >= 20, "all observations")
    assert bench.history("door") == rows


def test_a_daemon_that_no_longer_answers_costs_nothing(bench, peer):
    bench.client.create_map("office")
    bench.node()
    observe = peer.publisher(String, "/tidemap/observe")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    rows = observed(300)
    say(observe, rows[:100])
    until(lambda: last_values(heard, "daemon").get("records durable") == "100", "the first hundred")
    # This acts like a lost network: nothing is refused, and nothing is answered.
    process = bench.daemon._process
    process.send_signal(signal.SIGSTOP)
    try:
        say(observe, rows[100:200])
        until(lambda: last_values(heard, "daemon")["level"] == "2", "an error in diagnostics", 90)
        assert last_values(heard, "daemon")["records waiting"] == "100"
        assert float(last_values(heard, "daemon")["oldest waits for seconds"]) > 0
    finally:
        process.send_signal(signal.SIGCONT)
    say(observe, rows[200:])
    until(lambda: len(bench.history("door")) >= 300, "all observations", 90)
    until(lambda: last_values(heard, "daemon")["records waiting"] == "0", "no record that waits", 90)
    assert bench.history("door") == rows


def test_a_node_that_is_killed_sends_the_rest_when_it_comes_back(bench, peer):
    bench.client.create_map("office")
    node = bench.node()
    observe = peer.publisher(String, "/tidemap/observe")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    rows = observed(300)
    say(observe, rows[:100])
    bench.daemon.kill()
    say(observe, rows[100:200])
    until(lambda: last_values(heard, "observations").get("taken") == "200", "200 taken")
    node.kill()
    bench.daemon_again()
    until(lambda: observe.get_subscription_count() == 0, "the end of the node", 40)
    node.start()
    until(lambda: observe.get_subscription_count() > 0, "the node")
    say(observe, rows[200:])
    until(lambda: len(bench.history("door")) >= 300, "all observations", 90)
    assert bench.history("door") == rows
    assert node.stop() == 0


def test_a_full_spool_is_told_and_the_oldest_are_kept(bench, peer):
    bench.client.create_map("office", grid_resolution_m=0.5)
    bench.node(cloud_topics=["/points"], spool_megabytes=2, cloud_cell=-1.0)
    clouds = peer.publisher(PointCloud2, "/points")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    until(lambda: last_values(heard, "daemon").get("level") == "0", "a connection")
    bench.daemon.kill()
    points = np.random.default_rng(1).uniform(-5, 5, (20_000, 3)).astype(np.float32)
    start = time.time_ns()
    for number in range(20):
        clouds.publish(cloud(points, start + number * SECOND // 100))
        time.sleep(0.02)
    lost = "observations lost because it was full"
    until(lambda: int(last_values(heard, "spool").get(lost, 0)) > 0, "lost ones in diagnostics")
    taken_now = lambda: int(last_values(heard, "observations")["taken"])  # noqa: E731
    until(lambda: int(last_values(heard, "spool")[lost]) + taken_now() == 20, "all")
    assert last_values(heard, "spool")["level"] == "2"
    taken = taken_now()
    assert taken >= 4
    bench.daemon_again()
    until(lambda: bench.client.map("office")["grid_summary"]["scans"] == taken, "what was kept", 90)


def test_wrong_words_are_told_and_stop_nothing(bench, peer):
    bench.client.create_map("office")
    bench.node()
    observe = peer.publisher(String, "/tidemap/observe")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    observe.publish(String(data="open"))
    observe.publish(text_of(state="door", value=7.5))
    observe.publish(text_of(state="door", value="open"))
    until(lambda: len(bench.history("door")) == 1, "the right one")
    until(lambda: last_values(heard, "daemon").get("refused: Value") == "1", "a refusal by the daemon")
    assert last_values(heard, "observations")["left out: malformed"] == "1"


@pytest.mark.parametrize("parameters, words", [
    ({"map_time": "at noon"}, "at noon"), ({"map_output": "colours"}, "map_output"),
    ({"map_period": -1.0}, "map_period"),
])
def test_wrong_parameters_end_the_node_with_a_word(bench, peer, parameters, words):
    node = bench.node(**parameters)
    assert node.process.wait(60) == 2
    assert words in node.log.read_text()
