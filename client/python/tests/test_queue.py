"""A producer with a queue: through restarts of the program and of the daemon, and through kill -9 of both."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest

import tidemap

NOON = np.datetime64("2026-01-05T12:00:00", "ns")
SECOND = np.timedelta64(1_000_000_000, "ns")
HERE = (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def until(goal) -> None:
    deadline = time.monotonic() + 60
    while not goal():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


@pytest.fixture
def office(tmp_path):
    """A daemon with the map ``office``."""
    with tidemap.serve(tmp_path / "data") as daemon:
        daemon.connect().create_map("office", grid_resolution_m=0.5)
        yield daemon


def test_observations_wait_while_no_daemon_is_there(office, tmp_path):
    client, address = office.connect(), office.grpc
    office.kill()
    with client.producer("office", "robot", queue=tmp_path / "queue", zone="UTC") as robot:
        assert isinstance(robot, tidemap.QueuedProducer)
        assert [robot.send("door", NOON + number * SECOND, number % 2) for number in range(50)] == list(range(1, 51))
        until(lambda: robot.state.error is not None)
        state = robot.state
        assert (state.connected, state.waiting, state.last) == (False, 50, 50)
        assert state.oldest_waiting_nanos == NOON.astype(np.int64) and robot.progress.phase == "waiting"
        with pytest.raises(tidemap.Unavailable, match="50 observations"):
            robot.flush(0.01)
    with pytest.raises(tidemap.FailedPrecondition, match="closed"):
        robot.send("door", NOON, 1)
    with tidemap.serve(tmp_path / "data", listen=address) as daemon:
        with client.producer("office", "robot", queue=str(tmp_path / "queue")) as robot:
            assert robot.send("door", NOON + 50 * SECOND, 0) == 51
            assert robot.flush() == 51
            assert (robot.state.waiting, robot.state.refused, robot.take_refusals()) == (0, 0, [])
            assert robot.progress.durable_sequence == robot.progress.last_sequence == 51
        history = daemon.connect().history("office", "door")
        assert history["value"].tolist() == [number % 2 for number in range(51)]


def test_kill_9_of_program_and_daemon_loses_nothing_and_counts_nothing_twice(office, tmp_path):
    address = office.grpc
    program = (
        "import sys, time, numpy, tidemap\n"
        f"robot = tidemap.Client({address!r}).producer('office', 'robot', queue={str(tmp_path / 'queue')!r}, zone='UTC')\n"
        "noon, second = numpy.datetime64('2026-01-05T12:00:00', 'ns'), numpy.timedelta64(10**9, 'ns')\n"
        "while True:\n"
        "    number = robot.state.last + 1\n"
        "    print(robot.send('door', noon + number * second, number % 2), flush=True)\n"
    )
    daemon, last = office, 0
    for round_ in range(3):
        robot = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        for line in robot.stdout:
            last = int(line)
            if last % 500 == 250 and round_ != 1:
                daemon.kill()
            if last % 500 == 0:
                break
        robot.kill()
        # The program took these, and the pipe still has them.
        last = max([last, *(int(line) for line in robot.stdout.read().split("\n") if line.strip())])
        robot.wait()
        if round_ != 1:
            daemon = tidemap.serve(tmp_path / "data", listen=address)
    with daemon:
        client = daemon.connect()
        with client.producer("office", "robot", queue=tmp_path / "queue") as robot:
            taken = robot.flush()
            assert taken >= last and robot.state.refused == 0
        history = client.history("office", "door")
        assert history["value"].tolist() == [number % 2 for number in range(1, taken + 1)]


def test_a_full_queue_raises_and_keeps_the_oldest(office, tmp_path):
    client = office.connect()
    office.kill()
    with client.producer("office", "robot", queue=tmp_path / "queue", queue_bytes_max=1000) as robot:
        with pytest.raises(tidemap.Unavailable, match="times with a zone"):
            robot.send("door", NOON, 1)
        with pytest.raises(tidemap.ResourceExhausted, match="full"):
            for number in range(100):
                robot.send("door", f"{NOON + number * SECOND}Z", number % 2)
        state = robot.state
        assert (state.not_taken, state.bytes_max, state.last) == (1, 1000, number) and state.bytes <= 1000


def test_two_programs_and_two_producers_do_not_share_a_queue(office, tmp_path):
    client = office.connect()
    with client.producer("office", "robot", queue=tmp_path / "queue"):
        with pytest.raises(tidemap.AlreadyExists, match="another program"):
            client.producer("office", "robot", queue=tmp_path / "queue")
    with pytest.raises(tidemap.FailedPrecondition, match="robot-2"):
        client.producer("office", "robot-2", queue=tmp_path / "queue")
    with pytest.raises(tidemap.InvalidArgument, match="interval"):
        client.producer("office", "robot", queue=tmp_path / "queue", queue_sync_secs=0)
    (tmp_path / "queue" / "relation").write_bytes(b"nonsense")
    with pytest.raises(tidemap.TidemapError, match="Move the folder") as damaged:
        client.producer("office", "robot", queue=tmp_path / "queue")
    assert damaged.value.code == "DATA_LOSS"


def test_everything_can_be_queued(office, tmp_path):
    client = office.connect()
    client.add_state("office", "room", kind="categorical", labels=["empty", "full"])
    with client.producer("office", "robot", queue=tmp_path / "queue") as robot:
        robot.send("door", NOON, 1)
        robot.send_label("room", NOON, "empty")
        robot.send_position("anna", NOON, (1.0, 2.0))
        robot.send_ranges(NOON, HERE, [2.0], angle_min_rad=0, angle_increment_rad=0.1, max_range_m=10)
        robot.send_cloud(NOON, HERE, [[4.1, 0.1, 0.1]])
        robot.send_grid(NOON, [[0, 1]])
        # Two cells of 0.25 m are one of the map.
        robot.send_occupancy(
            NOON + SECOND, (10.0, 0, 0, 0, 0, 0, 1), [[0, 100, -1, -1], [0, 0, -1, 0]], resolution_m=0.25
        )
        robot.send_traversal("hall", "moon", NOON, NOON + 10 * SECOND, True)
        assert robot.flush() == 8
        assert [(one.sequence, one.reason) for one in robot.take_refusals()] == [(8, "Edge")]
        state = robot.state
        assert (state.refused, state.refused_by_reason, state.unsendable) == (1, {"Edge": 1}, 0)
        assert (state.resolution_m, state.origin_m) == (0.5, (0.0, 0.0, 0.0))
    grid = client.grid("office", NOON + 2 * SECOND, model="latest")
    row, column = -grid.first_cell[1], 20 - grid.first_cell[0]
    layer = -grid.first_cell[2]
    assert grid.values[layer, row, column] > 0.5 > grid.values[layer, row, column + 1]


def test_wrong_observations_raise_and_use_no_number(office, tmp_path):
    with office.connect().producer("office", "robot", queue=tmp_path / "queue") as robot:
        wrong = [
            lambda: robot.send("door", NOON, None),
            lambda: robot.send("d" * 10_000, NOON, 1),
            lambda: robot.send_position("anna", NOON, [1.0]),
            lambda: robot.send_cloud(NOON, (0, 0, 0, 0, 0, 0, 0), np.zeros((1, 3))),
            lambda: robot.send_occupancy(NOON, HERE, [[0, 1]], resolution_m=0.0),
            lambda: robot.send_occupancy(NOON, HERE, [[0.5]], resolution_m=1.0),
        ]
        for call in wrong:
            with pytest.raises(tidemap.InvalidArgument):
                call()
        assert robot.send("door", NOON, 1) == 1


def test_a_fork_leaves_the_queue_alone(office, tmp_path):
    with office.connect().producer("office", "robot", queue=tmp_path / "queue") as robot:
        robot.send("door", NOON, 1)
        child = os.fork()
        if child == 0:
            try:
                robot.send("door", NOON, 0)
            except tidemap.FailedPrecondition:
                os._exit(0)
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert (robot.flush(), robot.send("door", NOON + SECOND, 0)) == (1, 2)
