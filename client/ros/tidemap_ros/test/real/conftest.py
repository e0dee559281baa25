"""A real daemon, the real node in a process of its own, and a peer that exchanges ROS messages with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

import tidemap

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# The depth holds all messages of a test: a sender forgets messages that do not fit, also if it is reliable.
RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
PATIENCE_SECS = 60.0


def until(goal: Callable[[], Any], what: str, patience: float = PATIENCE_SECS) -> Any:
    """Waits for something, and returns it."""
    deadline = time.monotonic() + patience
    while True:
        found = goal()
        if found:
            return found
        assert time.monotonic() < deadline, f"not within {patience:.0f} s: {what}"
        time.sleep(0.02)


class Peer:
    """A node of the test, which spins in a thread."""

    def __init__(self, number: int) -> None:
        self.node = rclpy.create_node(f"peer_{number}")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self._thread = threading.Thread(target=self.executor.spin, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=2.0)
        self._thread.join(5.0)
        self.node.destroy_node()

    def publisher(self, kind: Any, topic: str, qos: QoSProfile = RELIABLE) -> Any:
        """A publisher that has a subscriber."""
        made = self.node.create_publisher(kind, topic, qos)
        until(lambda: made.get_subscription_count() > 0, f"a subscription of {topic}")
        return made

    def heard(self, kind: Any, topic: str, qos: QoSProfile = LATCHED) -> list[Any]:
        """The messages of a topic, as they come."""
        found: list[Any] = []
        self.node.create_subscription(kind, topic, found.append, qos)
        return found

    def ask(self, kind: Any, name: str, request: Any, patience: float = PATIENCE_SECS) -> Any:
        """The reply of a service."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(patience), f"no service {name}"
        future = client.call_async(request)
        return until(lambda: future.done() and future.result(), f"a reply of {name}", patience)


@pytest.fixture(scope="session")
def ros() -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def peer(ros) -> Iterator[Peer]:
    made = Peer(time.time_ns() % 10**9)
    yield made
    made.close()


class Running:
    """The node in a process of its own."""

    def __init__(self, folder: Path, server: str, **parameters: Any) -> None:
        self.parameters = {
            "server": server, "map": "office", "producer": "robot", "spool_dir": str(folder / "spool"),
            "diagnostics_period": 0.2, "map_period": 1.0, "markers_period": 1.0, "reliable": True, **parameters,
        }
        self.log = folder / "node.log"
        self.process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        words = [sys.executable, "-m", "tidemap_ros.node", "--ros-args"]
        for name, value in self.parameters.items():
            shown = str(value).lower() if isinstance(value, bool) else str(value).replace("'", '"')
            words += ["-p", f"{name}:={shown}" if not isinstance(value, str) else f'{name}:="{value}"']
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(words, stdout=log, stderr=log)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                return self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.kill()
                raise AssertionError("the node did not end") from None
        return self.process.returncode

    def cpu_secs(self) -> float:
        """CPU seconds of the process until now."""
        return cpu_secs(self.process.pid)


def cpu_secs(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Bench:
    """A daemon whose data stays while it is killed and started, and nodes beside it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.daemon = tidemap.serve(folder / "data")
        self.server = self.daemon.grpc
        self.client = self.daemon.connect()
        self.nodes: list[Running] = []

    def node(self, **parameters: Any) -> Running:
        self.nodes.append(Running(self.folder, self.server, **parameters))
        return self.nodes[-1]

    def daemon_again(self) -> None:
        self.daemon = tidemap.serve(self.folder / "data", listen=self.server)
        self.client = self.daemon.connect()

    def history(self, state: str) -> list[tuple[int, float]]:
        """The times, in nanoseconds, and the values of a state; none before its first."""
        try:
            return self._history(state)
        except tidemap.NotFound:
            return []

    def _history(self, state: str) -> list[tuple[int, float]]:
        times, values = tidemap._native.history(self.client._native, "office", state, 0, 2**63 - 1)
        return list(zip(times.tolist(), values.tolist()))


@pytest.fixture
def bench(tmp_path, request) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    failed = getattr(request.node, "failed", False)
    ends = [node.stop() for node in made.nodes]
    if failed and made.nodes:
        print(made.nodes[0].log.read_text()[-4000:])
    made.daemon.stop()
    # 2: the parameters were wrong, as a test wanted it.
    assert set(ends) <= {0, 2}


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    outcome = yield
    if call.when == "call":
        item.failed = outcome.get_result().failed


def values(message: Any) -> dict[str, dict[str, str]]:
    """The values of each line of a diagnostics message, with its level and message."""
    found = {}
    for line in message.status:
        name = line.name.partition(": ")[2]
        found[name] = {
            "level": str(line.level[0] if isinstance(line.level, bytes) else line.level), "message": line.message,
            **{pair.key: pair.value for pair in line.values},
        }
    return found


def cell(grid: Any, x_m: float, y_m: float) -> int:
    """The value of an OccupancyGrid at a place."""
    column = int(np.floor((x_m - grid.info.origin.position.x) / grid.info.resolution))
    row = int(np.floor((y_m - grid.info.origin.position.y) / grid.info.resolution))
    return grid.data[row * grid.info.width + column]


