"""A robot drives for an hour of data time, and the map that Nav2 gets changes when a door closes."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import LATCHED, RELIABLE, cell, until
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import LoadMap
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from test_node import SECOND, last_values, stamped, transform

MINUTE = 60 * SECOND
STEP_NANOS = 10 * SECOND
# The corridor of `tidemap sample recording`: half its length and width, the door in its left wall, and how far the
# room behind it reaches; metres.
HALF_LENGTH, HALF_WIDTH, DOOR, DEPTH = 6.0, 1.0, (1.5, 2.5), 4.0
RAYS = 360


def command() -> str:
    """The program ``tidemap``, which makes the sample and imports it."""
    beside = Path(os.environ.get("TIDEMAPD") or "tidemapd").with_name("tidemap")
    found = os.environ.get("TIDEMAP") or (str(beside.resolve()) if beside.is_file() else shutil.which("tidemap"))
    if not found:
        reason = "the program tidemap is not there: set TIDEMAP to its path"
        print(f"SKIPPED: {reason}")
        pytest.skip(reason)
    return found


def nanos_of(clock: str) -> int:
    return int(np.datetime64(f"2025-01-20T{clock}", "ns").astype(np.int64))


def clock_of(nanos: int) -> str:
    return str(np.datetime64(nanos, "ns").astype("datetime64[s]"))[-8:]


# A Monday, the first day that the recording does not have. The door closes at six.
STARTS, CLOSES, ENDS = nanos_of("17:30"), nanos_of("18:00"), nanos_of("18:30")


def seen(x: float, is_open: bool, nanos: int) -> LaserScan:
    """The view of a scanner in the middle of the corridor."""
    angles = 2 * np.pi * np.arange(RAYS) / RAYS
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        end = np.where(cos > 0, HALF_LENGTH - x, -HALF_LENGTH - x) / cos
        side = HALF_WIDTH / np.abs(sin)
        along = x + side * cos
        back = np.minimum((HALF_WIDTH + DEPTH) / np.abs(sin), end)
    passes = is_open & (sin > 0) & (DOOR[0] <= along) & (along < DOOR[1])
    message = stamped(LaserScan(), "laser", nanos)
    message.angle_min, message.angle_increment = 0.0, 2 * np.pi / RAYS
    message.angle_max = float(angles[-1])
    message.range_min, message.range_max = 0.1, 30.0
    message.ranges = np.minimum(end, np.where(passes, back, side)).astype(np.float32).tolist()
    return message


def door_cells(grid: OccupancyGrid) -> np.ndarray:
    """For each column of cells in the door, the worse one of the two rows that the wall lies between."""
    cells = np.array(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)
    edge, corner = grid.info.resolution, grid.info.origin.position
    row = round((HALF_WIDTH - corner.y) / edge)
    columns = slice(round((DOOR[0] - corner.x) / edge), round((DOOR[1] - corner.x) / edge))
    return cells[row - 1:row + 1, columns].max(axis=0)


def corridor_learned(bench) -> int:
    """The map `corridor`, made from two weeks in which the door was open from 8 to 18 o'clock; the number of scans."""
    program, told = command(), {**os.environ, "TIDEMAP_SERVER": bench.server}
    folder = bench.folder / "recording"
    subprocess.run([program, "sample", "recording", folder], check=True, capture_output=True)
    subprocess.run(
        [program, "import", "corridor", folder / "robot.mcap", "--nightly", "--producer", "robot-1",
         "--time-zone", "UTC", "--times", "stamps"], check=True, capture_output=True, env=told,
    )
    return scans_of(bench)


def scans_of(bench) -> int:
    """The scans that the map has."""
    return int(bench.client.map("corridor")["grid_summary"]["scans"])


def shown_nanos(grid: OccupancyGrid) -> int:
    return grid.info.map_load_time.sec * SECOND + grid.info.map_load_time.nanosec


def drive(bench, peer, heard: list[OccupancyGrid], before: int) -> None:
    """An hour of data time, from half past five to half past six: each minute waits for its map."""
    clock = peer.publisher(Clock, "/clock")
    transforms = peer.publisher(TransformStamped, "/transforms")
    scans = peer.publisher(LaserScan, "/scan")
    for count, nanos in enumerate(range(STARTS, ENDS + 1, STEP_NANOS), start=1):
        now = Clock()
        now.clock.sec, now.clock.nanosec = divmod(nanos, SECOND)
        clock.publish(now)
        x = 0.1 * (count % 8)
        transforms.publish(transform(x, 0.0, nanos))
        scans.publish(seen(x, nanos < CLOSES, nanos))
        if nanos % MINUTE == 0:
            until(lambda count=count: scans_of(bench) == before + count, f"the scans until {clock_of(nanos)}")

            def is_shown(now=now, nanos=nanos) -> bool:
                # /clock is not reliable: the test publishes each time more than once.
                clock.publish(now)
                return bool(heard) and shown_nanos(heard[-1]) >= nanos

            until(is_shown, f"a map of {clock_of(nanos)}")


def test_the_map_changes_when_a_door_closes(bench, peer):
    before = corridor_learned(bench)
    bench.node(
        map="corridor", producer="robot-1", use_sim_time=True, transform_topics=["/transforms"], map_period=0.1,
        # Here 30 s of data time are over in a moment: transforms are kept longer, until their scans have come.
        model="auto+memory", tf_kept=600.0,
    )
    heard = peer.heard(OccupancyGrid, "/map", LATCHED)
    told = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    # Before the first time on /clock there is no now, and no map of 1970 either.
    until(lambda: "/clock" in last_values(told, "map").get("message", ""), "that there is no time yet")
    assert heard == []
    began = time.monotonic()
    drive(bench, peer, heard, before)
    took = time.monotonic() - began
    assert len({(grid.info.width, grid.info.height, str(grid.info.origin)) for grid in heard}) == 1
    assert shown_nanos(heard[0]) >= STARTS
    for grid in heard:
        cells, at = door_cells(grid), shown_nanos(grid)
        # The wall beside the door stays.
        assert cell(grid, 1.05, 0.95) == 100 or cell(grid, 1.05, 1.05) == 100
        if at < CLOSES:
            assert (cells == 0).all(), f"the door at {clock_of(at)}: {cells}"
        elif at >= CLOSES + MINUTE:
            assert (cells == 100).all(), f"the door at {clock_of(at)}: {cells}"
    changes = next(shown_nanos(grid) for grid in heard if (door_cells(grid) == 100).all())
    assert last_values(told, "observations")["left out"] == "0"

    def door_at(words: str) -> np.ndarray:
        return door_cells(peer.ask(LoadMap, "/tidemap/get_map_at", LoadMap.Request(map_url=words)).map)

    # The door has just been seen closed, but the prediction for tomorrow is the learned one.
    assert (door_at("+4h") == 100).all() and (door_at("2025-01-21T12:00:00Z") == 0).all()
    print(f"\nan hour of data time, {scans_of(bench) - before} scans and {len(heard)} maps, took {took:.1f} s; "
          f"the door closed at {clock_of(CLOSES)}, and the map had it closed at {clock_of(changes)}")
