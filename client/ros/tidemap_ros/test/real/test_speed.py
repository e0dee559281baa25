"""Speed of the node, and that nothing is lost at that speed. Figures are printed, not asserted."""

from __future__ import annotations

import os
import time

import numpy as np
from conftest import LATCHED, Peer, cpu_secs, until
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import LoadMap
from sensor_msgs.msg import PointCloud2
from test_node import RELIABLE, SECOND, cloud, last_values, values

CLOUDS_FOR_SECS = float(os.environ.get("TIDEMAP_ROS_SECONDS", "10"))
RATE_HZ = 10
POINTS = 100_000


def test_a_large_map_for_a_late_joiner_and_at_another_time(bench, peer):
    client = bench.client
    client.create_map("office", grid_resolution_m=0.05, grid={"flat": True})
    chance = np.random.default_rng(3)
    seen = np.where(chance.random((48, 334, 640)) < 0.2, 1, 0).astype(np.int8)
    walls = chance.random((334, 640)) < 0.9
    seen[:, walls] = seen[0, walls]
    times = np.datetime64("2026-01-05T00", "ns") + np.arange(48) * np.timedelta64(1, "h")
    client.observe_grids("office", times, seen)
    client.update("office")
    bench.node(map_time="2026-01-08T12:00:00Z")
    heard = peer.heard(OccupancyGrid, "/map")
    until(lambda: heard, "a map")
    late: list[float] = []
    for number in range(5):
        joiner = Peer(1000 + number)
        start = time.monotonic()
        maps = joiner.heard(OccupancyGrid, "/map", LATCHED)
        until(lambda maps=maps: maps, "the latched map")
        late.append(time.monotonic() - start)
        assert len(maps[0].data) == 213_760
        joiner.close()
    asked: list[float] = []
    requests = peer.node.create_client(LoadMap, "/tidemap/get_map_at")
    assert requests.wait_for_service(20)
    for hour in range(10):
        start = time.monotonic()
        future = requests.call_async(LoadMap.Request(map_url=f"2026-01-09T{hour:02}:00:00Z"))
        until(future.done, "a map at a time")
        asked.append(time.monotonic() - start)
        assert future.result().result == 0 and len(future.result().map.data) == 213_760
    print(f"\n213,760 cells: a late joiner has them after {np.median(late):.2f} s (at most {max(late):.2f}), "
          f"a map at another time after {np.median(asked):.2f} s (at most {max(asked):.2f})")


def test_clouds_of_100_000_points_at_10_hz(bench, peer):
    bench.client.create_map("office", grid_resolution_m=0.1, grid={"extent": {
        "min_x": -300, "min_y": -300, "min_z": -20, "max_x": 300, "max_y": 300, "max_z": 60}})
    node = bench.node(
        cloud_topics=["/points"], scan_topics=[""], map_topic="", markers_topic="", max_range=25.0,
        spool_megabytes=8000, queue_depth=100,
    )
    clouds = peer.publisher(PointCloud2, "/points")
    heard = peer.heard(DiagnosticArray, "/diagnostics", RELIABLE)
    until(lambda: last_values(heard, "daemon").get("level") == "0", "a connection")
    # A spinning lidar with 64 rings in a hall of 30 m by 20 m: walls, floor and ceiling, with a noise of 1 cm.
    chance = np.random.default_rng(5)
    up, around = np.meshgrid(np.radians(np.linspace(-25, 15, 64)), np.linspace(0, 2 * np.pi, POINTS // 64 + 1))
    way = np.stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=-1)
    way = way.reshape(-1, 3)[:POINTS]
    with np.errstate(divide="ignore"):
        reach = np.min(np.array([15.0, 10.0, 3.0]) / np.abs(way), axis=1)
    pictures = []
    for _ in range(4):
        noisy = reach + chance.normal(scale=0.01, size=POINTS)
        pictures.append(cloud((way * noisy[:, None]).astype(np.float32), 0))
    count = int(CLOUDS_FOR_SECS * RATE_HZ)
    daemon_pid = bench.daemon._process.pid
    node_before, daemon_before, began = node.cpu_secs(), cpu_secs(daemon_pid), time.monotonic()
    for number in range(count):
        message = pictures[number % len(pictures)]
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), SECOND)
        clouds.publish(message)
        time.sleep(max(0.0, began + (number + 1) / RATE_HZ - time.monotonic()))
    sent = time.monotonic() - began
    try:
        until(lambda: last_values(heard, "daemon").get("records durable") == str(count), "all clouds", 120 + 2 * sent)
    finally:
        print(values(heard[-1]))
    took = time.monotonic() - began
    node_secs, daemon_secs = node.cpu_secs() - node_before, cpu_secs(daemon_pid) - daemon_before
    assert bench.client.map("office")["grid_summary"]["scans"] == count
    assert last_values(heard, "observations")["left out"] == "0"
    assert last_values(heard, "spool")["observations lost because it was full"] == "0"
    print(f"\n{count} clouds of {POINTS:,} points, sent within {sent:.1f} s, durable after {took:.1f} s: "
          f"the node took {node_secs / sent:.2f} cores, the daemon {daemon_secs / sent:.2f}")
