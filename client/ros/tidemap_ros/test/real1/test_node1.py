"""The node for ROS 1 with a real master, real tf messages and a real daemon."""

from __future__ import annotations

import json
import math
import time

import numpy as np
import pytest
from conftest import publisher, until

rospy = pytest.importorskip("rospy", reason="ROS 1 is not installed: python3-rospy of Debian")
from geometry_msgs.msg import TransformStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid  # noqa: E402
from nav_msgs.srv import GetMap, LoadMap, LoadMapResponse  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402


def transform(x: float, stamp: float) -> TFMessage:
    one = TransformStamped()
    one.header.frame_id, one.child_frame_id, one.header.stamp = "map", "laser", rospy.Time.from_sec(stamp)
    one.transform.translation.x, one.transform.rotation.w = x, 1.0
    return TFMessage(transforms=[one])


def cell(grid, x_m: float, y_m: float) -> int:
    column = int(np.floor((x_m - grid.info.origin.position.x) / grid.info.resolution))
    row = int(np.floor((y_m - grid.info.origin.position.y) / grid.info.resolution))
    return grid.data[row * grid.info.width + column]


def test_scans_become_the_map(bench):
    bench.start(create_map=True, resolution=0.1)
    frames, scans = publisher(TFMessage, "/tf"), publisher(LaserScan, "/scan")
    start = float(int(time.time()))
    for tenth in range(11):
        frames.publish(transform(tenth / 10, start + tenth / 10))
    for tenth in range(10):
        scan = LaserScan(angle_min=-math.pi, angle_increment=math.pi / 180, range_min=0.05, range_max=20.0)
        scan.header.frame_id, scan.header.stamp = "laser", rospy.Time.from_sec(start + tenth / 10 + 0.05)
        scan.ranges = [5.02] * 361
        scans.publish(scan)
    until(lambda: bench.values("daemon").get("records durable") == "10", "ten durable scans")
    maps: list[OccupancyGrid] = []
    rospy.Subscriber("/map", OccupancyGrid, maps.append)
    shown = until(lambda: maps and maps[-1], "a latched map")
    # The last scan was taken at x = 0.95, between two transforms.
    assert cell(shown, 5.95, 0.05) == 100 and cell(shown, 2.05, 0.05) == 0
    rospy.wait_for_service("/tidemap/get_map", 20)
    assert cell(rospy.ServiceProxy("/tidemap/get_map", GetMap)().map, 5.95, 0.05) == 100
    at = rospy.ServiceProxy("/tidemap/get_map_at", LoadMap)
    assert at("+2h?probability").result == LoadMapResponse.RESULT_SUCCESS
    assert at("at noon").result == LoadMapResponse.RESULT_INVALID_MAP_METADATA


def test_a_daemon_that_is_killed_costs_nothing(bench):
    bench.client.create_map("office")
    bench.start(map_topic="")
    observe = publisher(String, "/tidemap/observe")
    rows = [((1_767_614_400 + number) * 10**9, float(number % 2)) for number in range(300)]

    def say(part) -> None:
        for nanos, value in part:
            observe.publish(String(json.dumps({"state": "door", "value": value, "stamp": nanos // 10**9})))
            time.sleep(0.001)

    say(rows[:100])
    bench.daemon.kill()
    say(rows[100:200])
    until(lambda: bench.values("daemon").get("level") == "2", "an error in diagnostics")
    bench.restart()
    say(rows[200:])
    until(lambda: len(bench.history("door")) >= 300, "all observations", 90)
    assert bench.history("door") == rows
