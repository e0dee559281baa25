"""Fixtures of the tests of the node for ROS 1: one master of ROS for all tests, a daemon and a node for each test."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import tidemap

try:
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray
except ImportError:
    # Each module of tests is skipped then, and pytest reports it.
    rospy = None


def until(goal, what: str, patience: float = 60.0):
    deadline = time.monotonic() + patience
    while True:
        found = goal()
        if found:
            return found
        assert time.monotonic() < deadline, f"not within {patience:.0f} s: {what}"
        time.sleep(0.02)


@pytest.fixture(scope="session", autouse=True)
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

    def restart(self) -> None:
        """Starts the daemon again, where it was."""
        self.daemon = tidemap.serve(self.folder / "data", listen=self.server)
        self.client = self.daemon.connect()

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
