"""A producer that stays open: scans, clouds, grids and traversals as they come, through restarts."""

from __future__ import annotations

import time

import numpy as np
import pytest

import tidemap

NOON = np.datetime64("2026-01-05T12:00:00", "ns")
SECOND = np.timedelta64(1_000_000_000, "ns")
HERE = (1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def yard(client):
    """A flat grid of cells of half a metre."""
    name = f"{client.name}-yard"[-60:].strip("-")
    client.create_map(name, grid_resolution_m=0.5)
    yield name
    client.delete_map(name)


def value(client, name: str, x_m: float, y_m: float, z_m: float = 0.1) -> float:
    grid = client.grid(name, NOON + 60 * SECOND, model="latest")
    cell = [int(np.floor((at - origin) / grid.resolution_m)) - first
            for at, origin, first in zip((x_m, y_m, z_m), grid.origin_m, grid.first_cell)]
    return float(grid.values[cell[2], cell[1], cell[0]])


def test_ranges_are_cast_from_the_pose_of_the_sensor(client, yard):
    with client.producer(yard, "robot") as robot:
        # Half a turn: the sensor points along -x, so that its echoes lie at x < 1.
        turned = (1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        number = robot.send_ranges(NOON, turned, [3.2], angle_min_rad=0, angle_increment_rad=0.1, max_range_m=10)
        assert (number, robot.flush(), robot.progress.phase) == (1, 1, "connected")
        assert robot.take_refusals() == []
    assert value(client, yard, 1 - 3.2, 2.1) > 0.5 > value(client, yard, 0.1, 2.1)


def test_clouds_and_ranges_and_values_share_one_sequence(client, yard):
    with client.producer(yard, "robot") as robot:
        robot.send("door", NOON, 1)
        points = np.array([[4.1, 0.1, 0.1], [np.nan, 0, 0], [0.01, 0, 0]])
        robot.send_cloud(NOON, HERE, points, min_range_m=0.2, max_range_m=20)
        robot.send_ranges(NOON, HERE, [np.inf, 2], angle_min_rad=0, angle_increment_rad=0.5, max_range_m=10)
        assert (robot.send("door", NOON + SECOND, 0), robot.flush()) == (4, 4)
        assert robot.take_refusals() == []
    assert client.map(yard)["observations"] == 2


def test_a_grid_keeps_its_size_where_nothing_is_known(client, yard):
    seen = np.full((20, 30), -1)
    seen[3, 4], seen[3, 5] = 100, 0
    with client.producer(yard, "robot") as robot:
        robot.send_grid(NOON, seen, first_cell=(-2, -3, 0))
    grid = client.grid(yard, NOON, model="latest")
    assert grid.values.shape == (1, 20, 30) and grid.first_cell == (-2, -3, 0)
    assert grid.values[0, 3, 4] > 0.5 > grid.values[0, 3, 5]
    assert np.isfinite(grid.values).sum() == 2


def test_traversals_come_one_by_one(client):
    client.load_topology(client.name, {"from": ["hall"], "to": ["lab"], "length_m": [5.0]})
    with client.producer(client.name, "robot") as robot:
        robot.send_traversal("hall", "lab", NOON, NOON + 10 * SECOND, True)
        robot.send_traversal("hall", "lab", NOON, NOON + 20 * SECOND, False, reason="a person")
        robot.send_traversal("hall", "moon", NOON, NOON + 20 * SECOND, True)
        robot.flush()
        refused = robot.take_refusals()
    assert [(one.sequence, one.reason) for one in refused] == [(3, "Edge")] and "moon" in refused[0].detail
    assert len(client.history(client.name, "edge/hall/lab")["value"]) == 2


def test_wrong_scans_raise_and_use_no_number(client, yard):
    with client.producer(yard, "robot") as robot:
        with pytest.raises(tidemap.InvalidArgument, match="0, 0, 0, 1"):
            robot.send_cloud(NOON, (0, 0, 0, 0, 0, 0, 0), np.zeros((1, 3)))
        with pytest.raises(tidemap.InvalidArgument, match="not finite"):
            robot.send_cloud(NOON, (np.nan, 0, 0, 0, 0, 0, 1), np.zeros((1, 3)))
        with pytest.raises(tidemap.InvalidArgument, match="three"):
            robot.send_cloud(NOON, HERE, np.zeros((1, 2)))
        with pytest.raises(tidemap.InvalidArgument, match="integers"):
            robot.send_grid(NOON, np.zeros((2, 2)))
        with pytest.raises(tidemap.InvalidArgument, match="does not exist"):
            robot.send_grid(NOON, np.zeros((2, 2), dtype=int), first_cell=(2**31 - 1, 0, 0))
        assert robot.send("door", NOON, 1) == 1


def test_scans_go_on_through_kill_9(tmp_path):
    daemon = tidemap.serve(tmp_path / "data")
    client = daemon.connect()
    client.create_map("yard", grid_resolution_m=0.5)
    address = daemon.grpc
    robot = client.producer("yard", "robot")
    robot.send_ranges(NOON, HERE, [2.0], angle_min_rad=0, angle_increment_rad=0.1, max_range_m=10)
    robot.flush()
    daemon.kill()
    for second in range(1, 5):
        robot.send_ranges(NOON + second * SECOND, HERE, [2.0], angle_min_rad=0, angle_increment_rad=0.1, max_range_m=10)
    while robot.progress.phase != "waiting":
        time.sleep(0.02)
    assert (robot.progress.durable_sequence, robot.progress.last_sequence) == (1, 5) and robot.progress.error
    with tidemap.serve(tmp_path / "data", listen=address):
        assert robot.flush() == 5
        robot.close()
        again = client.producer("yard", "robot", patience_secs=5)
        assert again.progress.durable_sequence == 5
        again.abandon()
        with pytest.raises(tidemap.TidemapError, match="closed"):
            again.send("door", NOON, 1)
