"""The publications and services of the node.

Invariant: an output that fails is tried again, reported in diagnostics, and stops no other one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap, LoadMap
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

import tidemap
from tidemap.times import timestamp
from tidemap_ros import clock_words, graph, health, masks, messages, optional
from tidemap_ros.arrays import Cells
from tidemap_ros.charts import Charts, NoMap, moment
from tidemap_ros.inputs import LATCHED, Inputs
from tidemap_ros.link import Link
from tidemap_ros.parameters import Settings

TICK_SECS = 0.2
RETRY_SECS = 5.0
OUTPUTS_OF_WORDS = {"": None, "three_values": "three_values", "probability": "probability", "entropy": "entropy"}


@dataclass
class Task:
    """Something that is done again and again."""

    name: str
    period_secs: float
    work: Callable[[], None]
    due: float = 0.0
    done: int = 0
    error: str | None = None


class Outputs:
    """All publishers, services and clients."""

    def __init__(self, node: Node, settings: Settings, link: Link, inputs: Inputs) -> None:
        self._node = node
        self._settings = settings
        self._link = link
        self._inputs = inputs
        self.charts = Charts(settings, lambda: link.client)
        self.map_time, self.map_output = settings.text("map_time"), settings.text("map_output")
        self.tasks: list[Task] = []
        self._closed: set[int] = set()
        self._map_task: Task | None = None
        self._map()
        self._mask(masks.KEEPOUT)
        self._mask(masks.SPEED)
        self._topology()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(TICK_SECS, self._tick, callback_group=MutuallyExclusiveCallbackGroup(), clock=steady)

    @property
    def statuses(self) -> list[health.Status]:
        """The diagnostics of the outputs."""
        return [
            health.of_output(task.name, task.error, task.done, is_cut=task.name == "map" and self.charts.grown_beyond)
            for task in self.tasks
        ]

    def _every(self, name: str, period_secs: float, work: Callable[[], None]) -> Task:
        task = Task(name, period_secs, work)
        self.tasks.append(task)
        return task

    def _tick(self) -> None:
        for task in self.tasks:
            if time.monotonic() < task.due:
                continue
            try:
                task.work()
            except (tidemap.TidemapError, NoMap, OSError, ValueError) as error:
                if task.error is None:
                    self._node.get_logger().warning(f"{task.name}: {error}")
                task.error = str(error)
                task.due = time.monotonic() + min(task.period_secs, RETRY_SECS)
            else:
                task.done, task.error = task.done + 1, None
                task.due = time.monotonic() + task.period_secs

    def _moment(self, words: str) -> int:
        """The time of words such as ``+2h``, nanoseconds."""
        return moment(words, int(self._node.get_clock().now().nanoseconds))

    def _message(self, cells: Cells, shown_nanos: int) -> OccupancyGrid:
        stamp = self._node.get_clock().now().to_msg()
        return messages.occupancy_grid(
            cells, self.charts.region, self._settings.text("map_frame"), stamp, shown_nanos
        )

    # The map

    def _map(self) -> None:
        settings, services = self._settings, MutuallyExclusiveCallbackGroup()
        if settings.text("map_topic"):
            publisher = self._node.create_publisher(OccupancyGrid, settings.text("map_topic"), LATCHED)

            def publish() -> None:
                publisher.publish(self._shown(self.map_time, None))
                self.charts.check_growth()

            self._map_task = self._every("map", settings.number("map_period"), publish)
        self._node.create_service(GetMap, "~/get_map", self._get_map, callback_group=services)
        self._node.create_service(LoadMap, "~/get_map_at", self._get_map_at, callback_group=services)

    def _shown(self, words: str, output: str | None) -> OccupancyGrid:
        nanos = self._moment(words)
        return self._message(self.charts.cells(nanos, output or self.map_output), nanos)

    def show(self, map_time: str, map_output: str) -> None:
        """The map shows another time, or something else, from now on."""
        self.map_time, self.map_output = map_time, map_output
        if self._map_task is not None:
            self._map_task.due = 0.0

    def _get_map(self, request: Any, response: GetMap.Response) -> GetMap.Response:
        """The map of the parameter ``map_time``. Without a map, the reply has none: its width is 0."""
        try:
            response.map = self._shown(self.map_time, None)
        except (tidemap.TidemapError, NoMap) as error:
            self._node.get_logger().warning(f"get_map: {error}")
        return response

    def _get_map_at(self, request: LoadMap.Request, response: LoadMap.Response) -> LoadMap.Response:
        """The map at the time of ``map_url``, such as ``+2h`` or ``2026-01-05T12:00:00Z?entropy``."""
        words, _, output = str(request.map_url).partition("?")
        try:
            if output not in OUTPUTS_OF_WORDS:
                raise clock_words.BadTime(f"{output!r}: three_values, probability or entropy")
            response.map = self._shown(words, OUTPUTS_OF_WORDS[output])
            response.result = LoadMap.Response.RESULT_SUCCESS
        except clock_words.BadTime as error:
            self._node.get_logger().warning(f"get_map_at: {error}")
            response.result = LoadMap.Response.RESULT_INVALID_MAP_METADATA
        except (NoMap, tidemap.NotFound) as error:
            self._node.get_logger().warning(f"get_map_at: {error}")
            response.result = LoadMap.Response.RESULT_MAP_DOES_NOT_EXIST
        except tidemap.TidemapError as error:
            self._node.get_logger().warning(f"get_map_at: {error}")
            response.result = LoadMap.Response.RESULT_UNDEFINED_FAILURE
        return response

    # Masks

    def _mask(self, kind: masks.MaskKind) -> None:
        settings, source = self._settings, self._settings.text(f"{kind.name}_source")
        if not source:
            return
        topic = f"~/{kind.name}_mask"
        publisher = self._node.create_publisher(OccupancyGrid, topic, LATCHED)

        def publish() -> None:
            nanos = self._moment(self.map_time)
            if source == "people":
                values = self.charts.people(nanos)
            else:
                values = self.charts.values(nanos, "probability" if source == "occupancy" else "entropy")
            if kind is masks.KEEPOUT:
                cells = masks.keepout(values, settings.number("keepout_from"))
            else:
                cells = masks.speed(values, settings.number("speed_full_at"), settings.number("speed_slowest"))
            publisher.publish(self._message(cells, nanos))

        self._every(f"{kind.name} mask", settings.number("mask_period"), publish)
        info_type = optional.found(
            "nav2_msgs.msg", "CostmapFilterInfo", f"no information about {topic} is published",
            self._node.get_logger().info,
        )
        if info_type is not None:
            info = info_type()
            info.header.frame_id = settings.text("map_frame")
            info.header.stamp = self._node.get_clock().now().to_msg()
            info.type, info.base, info.multiplier = kind.filter_type, kind.base, kind.multiplier
            info.filter_mask_topic = publisher.topic_name
            # Latched: it never changes.
            self._node.create_publisher(info_type, f"{topic}_info", LATCHED).publish(info)

    # Topology

    def _topology(self) -> None:
        settings = self._settings
        if settings.text("markers_topic"):
            publisher = self._node.create_publisher(MarkerArray, settings.text("markers_topic"), LATCHED)

            def publish() -> None:
                nodes = self._link.client.call("TopologyService/GetTopology", {"map": settings.text("map")})["nodes"]
                stamp = self._node.get_clock().now().to_msg()
                edges = self._predicted() if nodes else []
                publisher.publish(messages.markers(nodes, edges, settings.text("map_frame"), stamp))

            self._every("topology", settings.number("markers_period"), publish)
        name = settings.text("dynamic_edges")
        if name:
            log = self._node.get_logger().info
            kind = optional.found("nav2_msgs.srv", "DynamicEdges", f"{name} is not called", log)
            cost = optional.found("nav2_msgs.msg", "EdgeCost", f"{name} is not called", log)
            if kind is not None and cost is not None:
                client = self._node.create_client(kind, name, callback_group=MutuallyExclusiveCallbackGroup())
                self._every("edges", settings.number("edges_period"), lambda: self._reprice(client, kind, cost))

    def _predicted(self) -> list[dict[str, Any]]:
        nanos = self._moment(self.map_time)
        asked = {
            "map": self._settings.text("map"), "time": timestamp(nanos),
            "model": self._settings.text("model"),
        }
        return list(self._link.client.call("RouteService/PredictEdges", asked)["edges"])

    def _reprice(self, client: Any, kind: Any, cost: Any) -> None:
        if not client.service_is_ready():
            raise NoMap(f"the service {client.srv_name} is not there")
        self._inputs.forget_ends()
        below = self._settings.number("edge_closed_below")
        change = graph.repricing(self._inputs.ends(), self._predicted(), below, self._closed)
        request = kind.Request()
        request.closed_edges, request.opened_edges = change.closed, change.opened
        request.adjust_edges = [cost(edgeid=number, cost=secs) for number, secs in change.costs]

        def answered(future: Any) -> None:
            reply = future.result()
            if reply is not None and reply.success:
                self._closed = set(change.closed)
            else:
                self._node.get_logger().warning(f"{client.srv_name} refused the change of edges")

        client.call_async(request).add_done_callback(answered)
