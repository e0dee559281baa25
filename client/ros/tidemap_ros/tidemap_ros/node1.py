"""The node for ROS 1: scans, clouds, grids, values and traversals in, the map of any time out.

The node has the parameters of the node for ROS 2, as private ones: ``python3 -m tidemap_ros.node1 _map:=office``.
Masks, markers and Nav2 are not in it; the actions of fremenserver and frenap are.

Invariant: messages that were taken before the end are on the disk when the node has ended.
"""

from __future__ import annotations

import sys
import threading
import time
from functools import partial
from typing import Any

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap, GetMapResponse, LoadMap, LoadMapRequest, LoadMapResponse
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import String

import tidemap
from tidemap_ros import clock_words, health, optional, traversals
from tidemap_ros.actions1 import Actions
from tidemap_ros.charts import Charts, NoMap, moment
from tidemap_ros.intake import Intake
from tidemap_ros.link import Link
from tidemap_ros.parameters import TABLE, BadParameter, Settings, checked
from tidemap_ros.queue import Queue
from tidemap_ros.transforms import Transforms

TICK_SECS = 0.2
RETRY_SECS = 0.05
OUTPUT_RETRY_SECS = 5.0
WORDS_DEPTH = 1000


class Node:
    """The node."""

    def __init__(self) -> None:
        settings = Settings({known.name: rospy.get_param(f"~{known.name}", known.default) for known in TABLE})
        clock_words.nanos(settings.text("map_time"), time.time_ns())
        self._settings, self._link = settings, Link(settings)
        self._queue = queue = Queue(settings, self._link, rospy.logwarn)
        transforms = Transforms(settings.number("tf_kept"), settings.number("tf_tolerance"))
        self._intake = Intake(settings, queue.put, transforms, self._now, time.monotonic, rospy.logwarn)
        self._intake.grid_of_map = lambda: queue.grid
        self._charts = Charts(settings, lambda: self._link.client)
        self._map_error: str | None = None
        self._maps = 0
        self._is_ending = threading.Event()
        self._listen()
        self._publish()
        self._actions = Actions(settings, self._link)
        self._threads = [
            threading.Thread(target=work, daemon=True) for work in (self._retry, self._show, self._diagnose)
        ]
        for thread in self._threads:
            thread.start()

    @staticmethod
    def _now() -> int:
        return int(rospy.Time.now().to_nsec())

    # In

    def _listen(self) -> None:
        settings, intake, depth = self._settings, self._intake, int(self._settings.number("queue_depth"))
        for topic in settings.texts("scan_topics"):
            rospy.Subscriber(topic, LaserScan, partial(intake.scan, topic), queue_size=depth)
        for topic in settings.texts("cloud_topics"):
            # The buffer must have room for a whole cloud, or rospy reads late and drops.
            rospy.Subscriber(topic, PointCloud2, partial(intake.cloud, topic), queue_size=depth, buff_size=1 << 26)
        for topic in settings.texts("grid_topics"):
            rospy.Subscriber(topic, OccupancyGrid, partial(intake.grid, topic), queue_size=1, buff_size=1 << 26)
        known = optional.found("tf2_msgs.msg", "TFMessage", "/tf is not received", rospy.loginfo)
        if known is not None:
            rospy.Subscriber("/tf", known, partial(self._tf, False), queue_size=WORDS_DEPTH)
            rospy.Subscriber("/tf_static", known, partial(self._tf, True), queue_size=WORDS_DEPTH)
        for topic in settings.texts("transform_topics"):
            rospy.Subscriber(
                topic, TransformStamped, lambda message: intake.transform(message, False), queue_size=WORDS_DEPTH
            )
        words = (("observe_topic", intake.observe), ("traverse_topic", intake.traverse))
        for name, taken in words:
            # ROS 1 writes private names without the slash.
            topic = settings.text(name).replace("~/", "~")
            if topic:
                rospy.Subscriber(topic, String, partial(self._words, taken), queue_size=WORDS_DEPTH)
        topic = settings.text("statistics_topic")
        if topic:
            package = "strands_navigation_msgs.msg"
            kind = optional.found(package, "NavStatistics", f"{topic} is not received", rospy.loginfo)
            if kind is not None:
                rospy.Subscriber(topic, kind, self._statistics, queue_size=WORDS_DEPTH)

    def _tf(self, is_static: bool, message: Any) -> None:
        for transform in message.transforms:
            self._intake.transform(transform, is_static)

    @staticmethod
    def _words(taken: Any, message: Any) -> None:
        taken(message.data)

    def _statistics(self, message: Any) -> None:
        found = traversals.of_statistics(message, self._now())
        if found is not None:
            self._intake.traversal(found)

    def _retry(self) -> None:
        while not self._is_ending.wait(RETRY_SECS):
            if self._intake.waiting:
                self._intake.retry()

    # Out

    def _publish(self) -> None:
        rospy.Service("~get_map", GetMap, self._get_map)
        rospy.Service("~get_map_at", LoadMap, self._get_map_at)
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        topic = self._settings.text("map_topic")
        self._map = rospy.Publisher(topic, OccupancyGrid, queue_size=1, latch=True) if topic else None

    def _words_of(self, name: str) -> str:
        """A parameter that may be changed while the node runs."""
        return str(checked(name, rospy.get_param(f"~{name}", self._settings.text(name))))

    def _grid(self, words: str, output: str) -> OccupancyGrid:
        nanos = moment(words, self._now())
        cells, region = self._charts.cells(nanos, output), self._charts.region
        message = OccupancyGrid()
        message.header.frame_id, message.header.stamp = self._settings.text("map_frame"), rospy.Time.now()
        message.info.map_load_time = rospy.Time(*divmod(nanos, 1_000_000_000))
        message.info.resolution, message.info.width, message.info.height = (
            region.resolution_m, region.width, region.height
        )
        message.info.origin.position.x, message.info.origin.position.y = region.corner_m
        message.info.origin.orientation.w = 1.0
        message.data = cells.ravel().tolist()
        return message

    def _show(self) -> None:
        shown, due = ("", ""), 0.0
        while self._map is not None and not self._is_ending.wait(TICK_SECS):
            try:
                wanted = (self._words_of("map_time"), self._words_of("map_output"))
                if wanted == shown and time.monotonic() < due:
                    continue
                self._map.publish(self._grid(*wanted))
                self._charts.check_growth()
                shown, due = wanted, time.monotonic() + self._settings.number("map_period")
                self._map_error, self._maps = None, self._maps + 1
            except (tidemap.TidemapError, NoMap, OSError, ValueError, rospy.ROSException) as error:
                self._map_error = str(error)
                self._is_ending.wait(min(self._settings.number("map_period"), OUTPUT_RETRY_SECS))

    def _get_map(self, request: Any) -> GetMapResponse:
        response = GetMapResponse()
        try:
            response.map = self._grid(self._words_of("map_time"), self._words_of("map_output"))
        except (tidemap.TidemapError, NoMap, ValueError) as error:
            rospy.logwarn(f"get_map: {error}")
        return response

    def _get_map_at(self, request: LoadMapRequest) -> LoadMapResponse:
        response = LoadMapResponse()
        words, _, output = str(request.map_url).partition("?")
        try:
            response.map = self._grid(words, str(checked("map_output", output or self._words_of("map_output"))))
            response.result = LoadMapResponse.RESULT_SUCCESS
            return response
        except (clock_words.BadTime, BadParameter) as error:
            response.result, problem = LoadMapResponse.RESULT_INVALID_MAP_METADATA, str(error)
        except (NoMap, tidemap.NotFound) as error:
            response.result, problem = LoadMapResponse.RESULT_MAP_DOES_NOT_EXIST, str(error)
        except tidemap.TidemapError as error:
            response.result, problem = LoadMapResponse.RESULT_UNDEFINED_FAILURE, str(error)
        rospy.logwarn(f"get_map_at: {problem}")
        return response

    def _diagnose(self) -> None:
        queue, counts_of = self._queue, self._intake
        while not self._is_ending.wait(self._settings.number("diagnostics_period")):
            state, counts = queue.state, counts_of.counts
            statuses = [
                health.of_sending(state, self._now(), self._settings.text("server")),
                health.of_spool(str(queue.folder), state, counts),
                health.of_intake(counts, counts_of.waiting),
            ]
            if self._map is not None:
                is_cut = self._charts.grown_beyond
                statuses.append(health.of_output("map", self._map_error, self._maps, is_cut=is_cut))
            message = DiagnosticArray()
            message.header.stamp = rospy.Time.now()
            for status in statuses:
                line = DiagnosticStatus(level=status.level, name=f"tidemap: {status.name}", message=status.message)
                line.hardware_id = self._settings.text("map")
                line.values = [KeyValue(key=key, value=value) for key, value in status.values.items()]
                message.status.append(line)
            self._diagnostics.publish(message)

    def close(self) -> None:
        """Ends the started parts. Waiting records stay on the disk."""
        self._is_ending.set()
        for thread in self._threads:
            thread.join(2.0)
        self._queue.close()


def main() -> int:
    """Runs the node until ROS ends it."""
    rospy.init_node("tidemap")
    try:
        node = Node()
    except (BadParameter, clock_words.BadTime) as error:
        print(f"tidemap_node: {error}", file=sys.stderr)
        return 2
    rospy.spin()
    node.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
