"""The topics that the node listens to.

Invariant: every message goes to the intake; nothing else is done here.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from action_msgs.msg import GoalStatusArray
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks, UnsupportedEventTypeError
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import String

from tidemap_ros import optional, traversals
from tidemap_ros.graph import Node as GraphNode
from tidemap_ros.graph import RouteGraph
from tidemap_ros.intake import Intake
from tidemap_ros.link import Link
from tidemap_ros.parameters import Settings

RETRY_SECS = 0.05
LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
TF_DEPTH, WORDS_DEPTH = 100, 1000


class Inputs:
    """All subscriptions."""

    def __init__(self, node: Node, settings: Settings, intake: Intake, link: Link) -> None:
        self._node = node
        self._settings = settings
        self._intake = intake
        self._link = link
        self._group = MutuallyExclusiveCallbackGroup()
        self._log = node.get_logger().info
        self.graph = RouteGraph.read(settings.text("route_graph")) if settings.text("route_graph") else None
        self._ends: dict[int, tuple[str, str]] | None = None
        self._sensors()
        self._transforms()
        self._words()
        self._navigators()
        node.create_timer(
            RETRY_SECS, self._retry, callback_group=self._group, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _listen(self, kind: Any, topic: str, callback: Any, qos: QoSProfile | int) -> None:
        events = SubscriptionEventCallbacks(
            message_lost=lambda lost: self._intake.never_arrived(int(lost.total_count_change))
        )
        try:
            self._node.create_subscription(
                kind, topic, callback, qos, callback_group=self._group, event_callbacks=events
            )
        except UnsupportedEventTypeError:
            # This middleware does not report its losses.
            self._node.create_subscription(kind, topic, callback, qos, callback_group=self._group)

    def _retry(self) -> None:
        if self._intake.waiting:
            self._intake.retry()

    def _sensors(self) -> None:
        settings, depth = self._settings, int(self._settings.number("queue_depth"))
        trust = ReliabilityPolicy.RELIABLE if settings.flag("reliable") else ReliabilityPolicy.BEST_EFFORT
        seen = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=trust)
        for topic in settings.texts("scan_topics"):
            self._listen(LaserScan, topic, partial(self._intake.scan, topic), seen)
        for topic in settings.texts("cloud_topics"):
            self._listen(PointCloud2, topic, partial(self._intake.cloud, topic), seen)
        for topic in settings.texts("grid_topics"):
            self._listen(OccupancyGrid, topic, partial(self._intake.grid, topic), LATCHED)

    def _transforms(self) -> None:
        known = optional.found("tf2_msgs.msg", "TFMessage", "/tf is not received", self._log)
        if known is not None:
            heard_static = QoSProfile(
                history=HistoryPolicy.KEEP_LAST, depth=TF_DEPTH, reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            )
            self._listen(known, "/tf", partial(self._tf, False), TF_DEPTH)
            self._listen(known, "/tf_static", partial(self._tf, True), heard_static)
        for topic in self._settings.texts("transform_topics"):
            self._listen(TransformStamped, topic, lambda message: self._intake.transform(message, False), TF_DEPTH)

    def _tf(self, is_static: bool, message: Any) -> None:
        for transform in message.transforms:
            self._intake.transform(transform, is_static)

    def _words(self) -> None:
        if self._settings.text("observe_topic"):
            topic = self._settings.text("observe_topic")
            self._listen(String, topic, lambda message: self._intake.observe(message.data), WORDS_DEPTH)
        if self._settings.text("traverse_topic"):
            topic = self._settings.text("traverse_topic")
            self._listen(String, topic, lambda message: self._intake.traverse(message.data), WORDS_DEPTH)
        for topic in self._settings.texts("door_topics"):
            kind = optional.found("rmf_door_msgs.msg", "DoorState", f"{topic} is not received", self._log)
            if kind is not None:
                self._listen(kind, topic, self._intake.door, WORDS_DEPTH)

    # Navigators

    def ends(self) -> dict[int, tuple[str, str]]:
        """The nodes of the topology at the ends of edges of the route graph; requests them from the daemon until it has
        answered once."""
        if self._ends is None and self.graph is not None:
            asked = {"map": self._settings.text("map")}
            nodes = self._link.client.call("TopologyService/GetTopology", asked)["nodes"]
            topology = [
                GraphNode(node["name"], (node.get("pose") or {}).get("x_m"), (node.get("pose") or {}).get("y_m"))
                for node in nodes
            ]
            names = self.graph.names(topology, self._settings.number("route_match"))
            self._ends = self.graph.ends(names)
            if len(self._ends) < len(self.graph.edges):
                self._node.get_logger().warning(
                    f"{len(self.graph.edges) - len(self._ends)} of {len(self.graph.edges)} edges of the route graph "
                    "are none of the topology: give nodes the same names, or raise route_match"
                )
        return self._ends or {}

    def forget_ends(self) -> None:
        """The topology may have changed: it is requested from the daemon again."""
        self._ends = None

    def _navigators(self) -> None:
        action = self._settings.text("route_action")
        if action:
            kind = optional.found(
                "nav2_msgs.action", "ComputeAndTrackRoute.Impl.FeedbackMessage", f"{action} is not followed", self._log
            )
            if kind is not None:
                follower = traversals.RouteFollower(self._ends_of, self._intake.traversal)
                self._listen(kind, f"{action}/_action/feedback", partial(self._feedback, follower), WORDS_DEPTH)
                self._listen(GoalStatusArray, f"{action}/_action/status", partial(self._states, follower), LATCHED)
        topic = self._settings.text("statistics_topic")
        if topic:
            kind = optional.found(
                "topological_navigation_msgs.msg", "NavStatistics", f"{topic} is not received", self._log
            )
            if kind is not None:
                self._listen(kind, topic, self._statistics, WORDS_DEPTH)

    def _ends_of(self, edge: int) -> tuple[str, str] | None:
        try:
            return self.ends().get(edge)
        except Exception as error:  # noqa: BLE001
            self._node.get_logger().warning(f"edge {edge} has no name yet: {error}", throttle_duration_sec=10.0)
            return None

    def _feedback(self, follower: traversals.RouteFollower, message: Any) -> None:
        goal, edge = bytes(message.goal_id.uuid), int(message.feedback.current_edge_id)
        follower.feedback(goal, edge, self._node.get_clock().now().nanoseconds)

    def _states(self, follower: traversals.RouteFollower, message: GoalStatusArray) -> None:
        now = self._node.get_clock().now().nanoseconds
        for one in message.status_list:
            follower.status(bytes(one.goal_info.goal_id.uuid), int(one.status), now)

    def _statistics(self, message: Any) -> None:
        found = traversals.of_statistics(message, self._node.get_clock().now().nanoseconds)
        if found is not None:
            self._intake.traversal(found)
