"""The node for ROS 1 with a real master, real tf messages and a real daemon."""

from __future__ import annotations

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import tidemap

rospy = pytest.importorskip("rospy", reason="ROS 1 is not installed: python3-rospy of Debian")
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import TransformStamped  # noqa: E402
from nav_msgs.msg import OccupancyGrid  # noqa: E402
from nav_msgs.srv import GetMap, LoadMap, LoadMapResponse  # noqa: E402
from sensor_msgs.msg import LaserScan  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402


def until(goal, what: str, patience: float = 60.0):
    deadline = time.monotonic() + patience
    while True:
        found = goal()
        if found:
            return found
        assert time.monotonic() < deadline, f"not within {patience:.0f} s: {what}"
        time.sleep(0.02)


@pytest.fixture(scope="module", autouse=True)
def master():
    """A master of ROS on a free port, and this process as a node."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1")
    program = "import rosmaster, sys; rosmaster.rosmaster_main(sys.argv)"
    running = subprocess.Popen([sys.executable, "-c", program, "--core", "-p", str(port)])

    def is_there() -> bool:
        with socket.socket() as tried:
            return tried.connect_ex(("127.0.0.1", port)) == 0

    until(is_there, "the master")
    rospy.init_node("peer", disable_signals=True)
    yield
    rospy.signal_shutdown("the end of the tests")
    running.terminate()
    running.wait(10)


class Bench:
    """A daemon and the node."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon = tidemap.serve(folder / "data")
        self.server = self.daemon.grpc
        self.client = self.daemon.connect()
        self.node: subprocess.Popen[bytes] | None = None
        self.heard: list[DiagnosticArray] = []
        self.subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, self.heard.append)

    def start(self, **parameters) -> None:
        known = {
            "server": self.server, "map": "office", "producer": "robot", "spool_dir": str(self.folder / "spool"),
            "diagnostics_period": 0.2, "map_period": 1.0, **parameters,
        }
        shown = {name: value if isinstance(value, str) else json.dumps(value) for name, value in known.items()}
        words = [f"_{name}:={value}" for name, value in shown.items()]
        with (self.folder / "node.log").open("ab") as log:
            self.node = subprocess.Popen([sys.executable, "-m", "tidemap_ros.node1", *words], stdout=log, stderr=log)

    def values(self, name: str) -> dict[str, str]:
        if not self.heard:
            return {}
        for line in self.heard[-1].status:
            if line.name == f"tidemap: {name}":
                return {"level": str(line.level), **{pair.key: pair.value for pair in line.values}}
        return {}

    def history(self, state: str) -> list[tuple[int, float]]:
        try:
            times, values = tidemap._native.history(self.client._native, "office", state, 0, 2**63 - 1)
        except tidemap.NotFound:
            return []
        return list(zip(times.tolist(), values.tolist()))


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.subscriber.unregister()
    if made.node is not None and made.node.poll() is None:
        made.node.send_signal(signal.SIGINT)
        assert made.node.wait(20) == 0
    made.daemon.stop()


def publisher(kind, topic: str, **options):
    made = rospy.Publisher(topic, kind, queue_size=1000, **options)
    until(lambda: made.get_num_connections() > 0, f"a subscriber of {topic}")
    return made


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
    bench.daemon = tidemap.serve(bench.folder / "data", listen=bench.server)
    bench.client = bench.daemon.connect()
    say(rows[200:])
    until(lambda: len(bench.history("door")) >= 300, "all observations", 90)
    assert bench.history("door") == rows
