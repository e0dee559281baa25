"""The node's queue against a real daemon: every kind of record, a daemon that comes later, and what is logged."""

from __future__ import annotations

import time

import numpy as np
import pytest

import tidemap
from tidemap_ros import health, records
from tidemap_ros.intake import Counts
from tidemap_ros.link import Link
from tidemap_ros.parameters import BadParameter, Settings
from tidemap_ros.poses import IDENTITY
from tidemap_ros.queue import Queue
from tidemap_ros.records import MapGrid

SECOND = 1_000_000_000
NOON = 1_767_614_400 * SECOND


def until(goal) -> None:
    deadline = time.monotonic() + 60
    while not goal():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


class Bench:
    """A folder, and the address of a daemon that a test starts and stops."""

    def __init__(self, folder) -> None:
        self.folder = folder
        daemon = tidemap.serve(folder / "data")
        self.address = daemon.grpc
        daemon.stop()
        self.log: list[str] = []

    def daemon(self) -> tidemap.Daemon:
        return tidemap.serve(self.folder / "data", listen=self.address)

    def queue(self, **parameters) -> Queue:
        settings = Settings({
            "server": self.address, "producer": "robot", "spool_dir": str(self.folder / "spool"), **parameters,
        })
        return Queue(settings, Link(settings), self.log.append)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_the_map_is_created_and_all_records_are_sent_when_the_daemon_comes(bench):
    queue = bench.queue(create_map=True, resolution=0.5)
    ranges = np.array([1.5, np.inf, np.nan], np.float32)
    for record in (
        records.Value("door", NOON, 1.0),
        records.Value("door", 5 * SECOND, 0.0),
        records.Ranges(NOON, IDENTITY, "map", -1.5, 0.01, 0.1, 30.0, 0.0, 0.0, ranges),
        records.Cloud(NOON, IDENTITY, "map", 0.0, 0.0, np.ones((2, 3), np.float32)),
        records.Picture(NOON, (10.0, 0, 0, 0, 0, 0, 1), 0.25, np.array([[0, 1, -1, -1], [0, 0, -1, 0]], np.int8)),
        records.Traversal("hall", "moon", NOON, NOON + SECOND, False, "lift", "a person"),
    ):
        queue.put(record)
    until(lambda: queue.state.error is not None)
    assert (queue.state.connected, queue.state.waiting, queue.grid) == (False, 6, None)
    sending = health.of_sending(queue.state, NOON + 3 * SECOND, "here")
    assert (sending.level, sending.values["records waiting"]) == (health.ERROR, "6")
    assert sending.values["oldest waits for seconds"] == "3.0" and "all is kept" in sending.message
    until(lambda: bench.log)
    assert len(bench.log) == 1 and "all is kept on the disk" in bench.log[0]
    with bench.daemon() as daemon:
        until(lambda: queue.state.durable == 6)
        until(lambda: queue.grid is not None)
        assert queue.grid == MapGrid(0.5, (0.0, 0.0, 0.0))
        state = queue.state
        assert (state.waiting, state.refused_by_reason, state.unsendable) == (0, {"Edge": 1}, 0)
        assert daemon.connect().map("office")["grid_summary"]["scans"] == 3
        assert health.of_sending(state, NOON, "here").level == health.WARN
        queue.close()


def test_a_node_that_comes_back_sends_the_rest(bench):
    queue = bench.queue()
    for second in range(20):
        queue.put(records.Value("door", NOON + second * SECOND, float(second % 2)))
    queue.close()
    with bench.daemon() as daemon:
        daemon.connect().create_map("office")
        again = bench.queue()
        again.put(records.Value("door", NOON + 20 * SECOND, 0.0))
        until(lambda: again.state.durable == 21)
        assert daemon.connect().history("office", "door")["value"].tolist() == [number % 2 for number in range(21)]
        again.close()


def test_a_full_queue_is_an_error_in_diagnostics(bench):
    queue = bench.queue(spool_megabytes=1)
    cloud = records.Cloud(NOON, IDENTITY, "map", 0.0, 0.0, np.ones((50_000, 3), np.float32))
    queue.put(cloud)
    with pytest.raises(tidemap.ResourceExhausted, match="full"):
        queue.put(cloud)
    assert health.of_spool(str(queue.folder), queue.state, Counts()).level == health.OK
    lost = health.of_spool(str(queue.folder), queue.state, Counts(spool_refused=1, last_problem="full"))
    assert (lost.level, lost.values["bytes at most"]) == (health.ERROR, "1000000")
    queue.close()


def test_a_queue_that_cannot_be_opened_ends_the_node_with_a_reason(bench):
    queue = bench.queue()
    with pytest.raises(BadParameter, match="another program"):
        bench.queue()
    queue.close()
    (queue.folder / "relation").write_bytes(b"nonsense")
    with pytest.raises(BadParameter, match="Move the folder"):
        bench.queue()


def test_records_that_are_not_valid_are_refused_at_once(bench):
    queue = bench.queue()
    with pytest.raises(tidemap.InvalidArgument):
        queue.put(records.Cloud(NOON, (0.0,) * 7, "map", 0.0, 0.0, np.ones((1, 3), np.float32)))
    assert queue.state.last == 0
    queue.close()
