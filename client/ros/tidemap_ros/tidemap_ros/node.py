"""The node ``tidemap``: its parts, its start and its end.

Invariant: messages that were taken before the end are on the disk when the node has ended.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tidemap_ros import clock_words, health, messages
from tidemap_ros.graph import BadGraph
from tidemap_ros.inputs import Inputs
from tidemap_ros.intake import Intake
from tidemap_ros.link import Link
from tidemap_ros.outputs import Outputs
from tidemap_ros.parameters import TABLE, BadParameter, Settings, checked
from tidemap_ros.queue import Queue
from tidemap_ros.transforms import Transforms

CHANGEABLE = ("map_time", "map_output")
# One thread for arriving messages, one for publishing, and one each for services and diagnostics.
THREADS = 4
ENDS_WITHIN_SECS = 0.2


class TidemapNode(Node):  # type: ignore[misc]
    """The node."""

    def __init__(self, **options: Any) -> None:
        super().__init__("tidemap", **options)
        self._queue: Queue | None = None
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        settings = Settings(self._declared())
        clock_words.nanos(settings.text("map_time"), time.time_ns())
        self._settings, self._link = settings, Link(settings)
        log = self.get_logger().warning
        self._queue = queue = Queue(settings, self._link, log)
        transforms = Transforms(settings.number("tf_kept"), settings.number("tf_tolerance"))
        self._intake = Intake(
            settings, queue.put, transforms, lambda: int(self.get_clock().now().nanoseconds), time.monotonic, log
        )
        self._intake.grid_of_map = lambda: queue.grid
        inputs = Inputs(self, settings, self._intake, self._link)
        self._outputs = Outputs(self, settings, self._link, inputs)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(
            settings.number("diagnostics_period"), self._diagnose, callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self.add_on_set_parameters_callback(self._changed)

    def _declared(self) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for known in TABLE:
            descriptor = ParameterDescriptor(
                description=known.meaning, dynamic_typing=True, read_only=known.name not in CHANGEABLE
            )
            values[known.name] = self.declare_parameter(known.name, known.default, descriptor).value
        return values

    def _changed(self, parameters: list[Any]) -> SetParametersResult:
        """Takes another time, or another output, of the map."""
        words = {"map_time": self._outputs.map_time, "map_output": self._outputs.map_output}
        try:
            for parameter in parameters:
                if parameter.name in words:
                    words[parameter.name] = str(checked(parameter.name, parameter.value))
            clock_words.nanos(words["map_time"], int(self.get_clock().now().nanoseconds))
        except (BadParameter, clock_words.BadTime) as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._outputs.show(words["map_time"], words["map_output"])
        return SetParametersResult(successful=True)

    def _diagnose(self) -> None:
        queue = self._queue
        if queue is None:
            return
        state, now, counts = queue.state, int(self.get_clock().now().nanoseconds), self._intake.counts
        statuses = [
            health.of_sending(state, now, self._settings.text("server")),
            health.of_spool(str(queue.folder), state, counts),
            health.of_intake(counts, self._intake.waiting),
            *self._outputs.statuses,
        ]
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(messages.diagnostics(self.get_name(), statuses, self._settings.text("map"), stamp))

    def close(self) -> None:
        """Ends the started parts. Waiting records stay on the disk."""
        if self._queue is not None:
            self._queue.close()


def main(arguments: list[str] | None = None) -> int:
    """Runs the node until a signal or ROS ends it."""
    ending = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ending.set())
    # rclpy's own handlers end the context while threads of the executor still use it.
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = TidemapNode()
    except (BadParameter, BadGraph, clock_words.BadTime) as error:
        print(f"tidemap_node: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 2
    executor = MultiThreadedExecutor(THREADS)
    executor.add_node(node)
    try:
        while rclpy.ok() and not ending.is_set():
            executor.spin_once(timeout_sec=ENDS_WITHIN_SECS)
    except ExternalShutdownException:
        pass
    finally:
        # First nothing arrives any more, then what arrived is put on the disk.
        executor.shutdown(timeout_sec=2.0)
        node.close()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
