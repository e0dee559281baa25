"""Messages of ROS, made from the results of the other modules.

Invariant: nothing is decided here.
"""

from __future__ import annotations

import math
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from tidemap_ros import arrays
from tidemap_ros.charts import Region
from tidemap_ros.health import Status

EDGE_WIDTH_M, NODE_SIZE_M, TEXT_SIZE_M = 0.05, 0.2, 0.25
SHOWN_ABOVE_M = 0.05


def time_of(nanos: int) -> Time:
    """A time of ROS; its seconds end in 2038."""
    seconds, rest = divmod(max(nanos, 0), 1_000_000_000)
    return Time(sec=min(seconds, 2**31 - 1), nanosec=rest)


def occupancy_grid(cells: arrays.Cells, region: Region, frame_id: str, stamp: Time, shown_nanos: int) -> OccupancyGrid:
    """A grid; ``map_load_time`` is the time that it shows."""
    message = OccupancyGrid()
    message.header.frame_id, message.header.stamp = frame_id, stamp
    message.info.map_load_time = time_of(shown_nanos)
    message.info.resolution = region.resolution_m
    message.info.width, message.info.height = region.width, region.height
    message.info.origin.position.x, message.info.origin.position.y = region.corner_m
    message.info.origin.orientation.w = 1.0
    message.data = arrays.data_of(cells)
    return message


def diagnostics(node: str, statuses: list[Status], hardware_id: str, stamp: Time) -> DiagnosticArray:
    """All lines of diagnostics."""
    message = DiagnosticArray()
    message.header.stamp = stamp
    for status in statuses:
        line = DiagnosticStatus()
        line.name, line.message, line.hardware_id = f"{node}: {status.name}", status.message, hardware_id
        line.level = bytes([status.level])
        line.values = [KeyValue(key=key, value=value) for key, value in status.values.items()]
        message.status.append(line)
    return message


def markers(nodes: list[dict[str, Any]], edges: list[dict[str, Any]], frame_id: str, stamp: Time) -> MarkerArray:
    """The topology: nodes as spheres with names, edges from red (never passed) to green, by their success."""
    message = MarkerArray()
    first = Marker(action=Marker.DELETEALL)
    first.header.frame_id, first.header.stamp = frame_id, stamp
    message.markers.append(first)
    places = {node["name"]: node["pose"] for node in nodes if node.get("pose")}

    def added(namespace: str, number: int, kind: int) -> Marker:
        marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = frame_id, stamp
        marker.pose.orientation.w = 1.0
        message.markers.append(marker)
        return marker

    for number, (name, pose) in enumerate(places.items()):
        sphere = added("nodes", number, Marker.SPHERE)
        sphere.pose.position.x, sphere.pose.position.y = float(pose["x_m"]), float(pose["y_m"])
        sphere.scale.x = sphere.scale.y = sphere.scale.z = NODE_SIZE_M
        sphere.color = ColorRGBA(r=0.2, g=0.4, b=0.9, a=1.0)
        text = added("names", number, Marker.TEXT_VIEW_FACING)
        text.pose.position.x, text.pose.position.y = float(pose["x_m"]), float(pose["y_m"])
        text.pose.position.z = NODE_SIZE_M + TEXT_SIZE_M
        text.scale.z, text.text = TEXT_SIZE_M, name
        text.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    for number, edge in enumerate(edges):
        ends = [places.get(edge["edge"][end]) for end in ("from", "to")]
        if ends[0] is None or ends[1] is None:
            continue
        line = added("edges", number, Marker.LINE_STRIP)
        line.scale.x = EDGE_WIDTH_M
        success = min(max(float(edge["success"]), 0.0), 1.0)
        # Edges without a report are only guessed, and pale.
        line.color = ColorRGBA(r=1.0 - success, g=success, b=0.1, a=1.0 if int(edge["reports"]) > 0 else 0.3)
        line.points = _beside(ends[0], ends[1])
    return message


def _beside(start: dict[str, Any], end: dict[str, Any]) -> list[Point]:
    """The line of an edge, a little to its right, so that both directions are seen."""
    x1, y1, x2, y2 = (float(pose[axis]) for pose in (start, end) for axis in ("x_m", "y_m"))
    length = math.hypot(x2 - x1, y2 - y1) or 1.0
    right_x, right_y = (y2 - y1) / length * EDGE_WIDTH_M, -(x2 - x1) / length * EDGE_WIDTH_M
    return [Point(x=x + right_x, y=y + right_y, z=SHOWN_ABOVE_M) for x, y in ((x1, y1), (x2, y2))]
