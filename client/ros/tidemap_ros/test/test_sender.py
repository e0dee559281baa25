"""The sender against a stand-in for a producer: order, numbers, restarts, and records that cannot be sent."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

import tidemap.times
from tidemap_ros import records, sender
from tidemap_ros.poses import IDENTITY
from tidemap_ros.sender import MapGrid, Sender
from tidemap_ros.spool import Spool

MEGABYTE = 1 << 20


class Daemon:
    """Keeps the records that were sent, by number, as a daemon does."""

    def __init__(self) -> None:
        self.kept: dict[int, object] = {}
        self.doubled: list[int] = []
        self.is_there = True
        self.acknowledges = True
        self.opened = 0

    def open(self) -> Producer:
        if not self.is_there:
            raise ConnectionError("no daemon answers")
        self.opened += 1
        return Producer(self)


def nanos(given) -> int:
    """A time as the real producer reads it: small integers are refused."""
    return int(tidemap.times.read(given).nanos[0])


class Producer:
    """An open producer."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.last = self.durable = max(daemon.kept, default=0)
        self.refused: list[SimpleNamespace] = []
        self.ended: str | None = None

    @property
    def progress(self) -> SimpleNamespace:
        if self.daemon.acknowledges and self.daemon.is_there:
            self.durable = self.last
        elif not self.daemon.is_there:
            self.ended = "gave up"
        phase = "ended" if self.ended else "connected"
        return SimpleNamespace(
            phase=phase, error=self.ended, durable_sequence=self.durable, unreported=0, dropped_refusals=0
        )

    def take_refusals(self) -> list[SimpleNamespace]:
        taken, self.refused = self.refused, []
        return taken

    def keep(self, what: object) -> int:
        if not self.daemon.is_there:
            raise ConnectionError("gone")
        self.last += 1
        if self.last in self.daemon.kept:
            self.daemon.doubled.append(self.last)
        self.daemon.kept[self.last] = what
        return self.last

    def send(self, state, time, value):
        if "/" in state:
            self.refused.append(SimpleNamespace(sequence=self.last + 1, reason="StateName", detail="a slash"))
        return self.keep((state, nanos(time), value))

    def send_grid(self, time, cells, *, first_cell):
        return self.keep((nanos(time), cells.tolist(), first_cell))

    def send_cloud(self, time, pose, points, **rest):
        raise ValueError("a cloud from the future")

    def send_traversal(self, from_node, to_node, start, end, success, **rest):
        return self.keep((from_node, to_node, nanos(start), nanos(end), success))

    def abandon(self) -> None:
        pass


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(sender, "RETRY_SECS", (0.01,))


def until(goal) -> None:
    deadline = time.monotonic() + 20
    while not goal():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)


def started(spool: Spool, daemon: Daemon, grid: MapGrid | None = None) -> Sender:
    thread = Sender(spool, daemon.open, lambda: grid, 0.05)
    thread.start()
    return thread


def value(number: int) -> bytes:
    return records.encoded(records.Value("door", number, float(number)))


def test_what_waited_is_sent_once_and_in_order(tmp_path):
    daemon = Daemon()
    daemon.is_there = False
    spool = Spool(tmp_path, MEGABYTE)
    for number in range(1, 51):
        spool.append(value(number))
    thread = started(spool, daemon)
    until(lambda: thread.state.error is not None)
    state = thread.state
    assert (state.connected, state.waiting_records, state.oldest_waiting_nanos) == (False, 50, 1)
    daemon.is_there = True
    until(lambda: len(daemon.kept) == 50)
    spool.append(value(51))
    until(lambda: thread.state.durable_records == 51)
    assert [kept[1] for kept in daemon.kept.values()] == list(range(1, 52)) and daemon.doubled == []
    assert thread.state.error is None and thread.state.waiting_records == 0
    thread.stop()


def test_a_node_that_ends_before_the_acknowledgement_sends_nothing_twice(tmp_path):
    daemon = Daemon()
    daemon.acknowledges = False
    spool = Spool(tmp_path, MEGABYTE)
    thread = started(spool, daemon)
    for number in range(1, 11):
        spool.append(value(number))
    until(lambda: len(daemon.kept) == 10)
    thread.stop()
    spool.close()
    again = Spool(tmp_path, MEGABYTE)
    assert again.last == 10, "nothing was acknowledged, so all is kept"
    again.append(value(11))
    daemon.acknowledges = True
    thread = started(again, daemon)
    until(lambda: thread.state.durable_records == 11)
    assert [kept[1] for kept in daemon.kept.values()] == list(range(1, 12)) and daemon.doubled == []
    thread.stop()


def test_a_daemon_that_goes_and_comes_gets_the_rest(tmp_path):
    daemon = Daemon()
    daemon.acknowledges = False
    spool = Spool(tmp_path, MEGABYTE)
    thread = started(spool, daemon)
    for number in range(1, 6):
        spool.append(value(number))
    until(lambda: len(daemon.kept) == 5)
    # The daemon lost the last two records: they were not acknowledged.
    daemon.is_there = False
    until(lambda: not thread.state.connected)
    del daemon.kept[4], daemon.kept[5]
    daemon.is_there = daemon.acknowledges = True
    until(lambda: thread.state.durable_records == 5)
    assert [kept[1] for kept in daemon.kept.values()] == [1, 2, 3, 4, 5]
    thread.stop()


def test_a_record_that_cannot_be_sent_uses_its_number_and_is_counted(tmp_path):
    daemon = Daemon()
    spool = Spool(tmp_path, MEGABYTE)
    spool.append(value(1))
    spool.append(b"no record")
    cloud = records.Cloud(2, IDENTITY, "map", 0.0, 0.0, np.zeros((1, 3), np.float32))
    spool.append(records.encoded(cloud))
    spool.append(value(4))
    thread = started(spool, daemon)
    until(lambda: thread.state.durable_records == 4)
    assert daemon.kept[1] == ("door", 1, 1.0) and daemon.kept[4] == ("door", 4, 4.0)
    state = thread.state
    assert (state.unsendable, state.refused, state.reasons) == (2, 2, {"StateName": 2})
    thread.stop()


def test_grids_are_sent_in_the_cells_of_the_map(tmp_path):
    daemon = Daemon()
    spool = Spool(tmp_path, MEGABYTE)
    cells = np.array([[0, 1]], dtype=np.int8)
    spool.append(records.encoded(records.Picture(7, (1.0, 0, 0, 0, 0, 0, 1), "map", 0.5, cells)))
    thread = started(spool, daemon, MapGrid(0.5, (0.0, 0.0, 0.0)))
    until(lambda: daemon.kept)
    assert daemon.kept[1] == (7, [[0, 1]], (2, 0, 0))
    thread.stop()


@pytest.mark.parametrize("record", [
    records.Value("dveře", 5, 0.1),
    records.Ranges(6, IDENTITY, "map", -1.5, 0.01, 0.1, 30.0, np.array([1.5, np.inf, np.nan], np.float32)),
    records.Cloud(7, IDENTITY, "", 0.0, 0.0, np.arange(6, dtype=np.float32).reshape(2, 3)),
    records.Picture(8, IDENTITY, "map", 0.05, np.array([[-1, 0], [1, 1]], np.int8)),
    records.Traversal("hall", "lab", 1, 2, False, "lift", "a person"),
])
def test_records_are_read_back_as_they_were(record):
    again = records.decoded(records.encoded(record))
    assert type(again) is type(record)
    for name, expected in vars(record).items():
        found = getattr(again, name)
        is_array = isinstance(expected, np.ndarray)
        assert np.array_equal(found, expected, equal_nan=True) if is_array else found == expected
    for cut in (0, 3, len(records.encoded(record)) // 2):
        with pytest.raises(records.BadRecord):
            records.decoded(records.encoded(record)[:cut])
