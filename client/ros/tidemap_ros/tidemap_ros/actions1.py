"""The action servers of fremenserver and frenap for ROS 1.

Invariant: whatever a goal contains, it ends with a result and a message, and the node goes on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rospy
from std_msgs.msg import Bool

from tidemap_ros import action_types, optional
from tidemap_ros.fremen import Answer, Fremen
from tidemap_ros.frenap import EdgesAnswer, Frenap
from tidemap_ros.link import Link
from tidemap_ros.parameters import Settings
from tidemap_ros.predecessors import FAILED

SOONEST_SECS = 0.05
"""Clients of actionlib in Python lose a result that comes before their ``send_goal`` has returned, and wait for ever.
The predecessors polled for goals every 30 ms, so that their clients seldom met this."""


class Actions:
    """The servers that the parameters select."""

    def __init__(self, settings: Settings, link: Link) -> None:
        self._servers: list[Any] = []
        self._settings, self._link = settings, link
        names = {name: settings.text(name) for name in ("fremen_action", "prediction_action")}
        wanted = ", ".join(name for name in names.values() if name)
        if not wanted:
            return
        server = optional.found("actionlib", "SimpleActionServer", f"nothing serves {wanted}", rospy.logwarn)
        if server is None:
            return
        if names["fremen_action"]:
            self._start_fremen(server, names["fremen_action"])
        if names["prediction_action"]:
            self._start_prediction(server, names["prediction_action"])

    def _start_fremen(self, server: Any, name: str) -> None:
        settings = self._settings
        definition = action_types.FREMEN if settings.flag("fremen_detect") else action_types.FREMEN_BEFORE_DETECT
        kind = action_types.action(definition, rospy.loginfo)
        fremen = Fremen(
            self._link, settings.text("map"), f"{settings.text('label')}-fremen",
            settings.number("fremen_learn_period"),
        )
        result_kind = type(kind().action_result.result)

        def execute(goal: Any) -> None:
            try:
                answer = fremen.answer(goal)
            except Exception as error:  # A goal must not end the server.
                rospy.logerr(f"{name}: {error!r}")
                answer = Answer(False, FAILED, repr(error))
            result = result_kind(
                success=answer.success, message=answer.message, probabilities=answer.probabilities,
                entropies=answer.entropies, errors=answer.errors,
            )
            if hasattr(result, "anomalyTimes"):
                result.anomalyTimes, result.anomalyValues = answer.anomaly_times, answer.anomaly_values
            self._end(running, name, answer.is_done, result)

        running = server(name, kind, execute_cb=_not_at_once(execute), auto_start=False)
        running.start()
        self._servers.append(running)
        # Clients of fremenserver build their models anew when they receive this.
        started = rospy.Publisher(f"{name}_start", Bool, queue_size=1, latch=True)
        started.publish(Bool(data=True))
        self._servers.append(started)

    def _start_prediction(self, server: Any, name: str) -> None:
        kind = action_types.action(action_types.PREDICTION, rospy.loginfo)
        frenap = Frenap(self._link, self._settings.text("map"), lambda: float(rospy.Time.now().to_sec()))
        result_kind, feedback_kind = type(kind().action_result.result), type(kind().action_feedback.feedback)

        def execute(goal: Any) -> None:
            try:
                answer = frenap.answer(goal, lambda words: running.publish_feedback(feedback_kind(status=words)))
            except Exception as error:  # A goal must not end the server.
                rospy.logerr(f"{name}: {error!r}")
                answer = EdgesAnswer(False, repr(error))
            result = result_kind(
                success=answer.success, message=answer.message, edgeName=answer.names,
                probability=answer.probabilities, duration=answer.durations,
            )
            self._end(running, name, answer.success, result)

        running = server(name, kind, execute_cb=_not_at_once(execute), auto_start=False)
        running.start()
        self._servers.append(running)

    @staticmethod
    def _end(server: Any, name: str, is_done: bool, result: Any) -> None:
        if is_done:
            server.set_succeeded(result, result.message)
        else:
            rospy.logwarn(f"{name}: {result.message}")
            server.set_aborted(result, result.message)


def _not_at_once(execute: Callable[[Any], None]) -> Callable[[Any], None]:
    """Runs the goal after a moment, see ``SOONEST_SECS``."""

    def later(goal: Any) -> None:
        time.sleep(SOONEST_SECS)
        execute(goal)

    return later
