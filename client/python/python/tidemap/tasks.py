"""Tasks of a robot: the tasks, plans of days, and reports of done tasks.

Invariant: nothing is planned here; the daemon plans, keeps plans, and learns from reports.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tidemap import tables
from tidemap import times as _times
from tidemap.connection import Connection
from tidemap.errors import InvalidArgument
from tidemap.times import Time

if TYPE_CHECKING:
    import pandas


def _seconds(clock: str) -> int:
    """A time of day, such as 09:30, in seconds."""
    try:
        hours, minutes = (int(part) for part in clock.split(":"))
    except ValueError:
        hours, minutes = 24, 60
    if not (0 <= hours <= 24 and 0 <= minutes < 60 and hours * 60 + minutes <= 24 * 60):
        raise InvalidArgument(f"{clock!r} is not a time of day: use 00:00 to 24:00", "INVALID_ARGUMENT")
    return hours * 3600 + minutes * 60


class Tasks(Connection):
    """Tasks and plans of days."""

    def add_task(
        self,
        map: str,
        kind: str,
        node: str,
        duration_secs: int,
        *,
        begin: str = "00:00",
        end: str = "24:00",
        **task: Any,
    ) -> dict[str, Any]:
        """Adds a task, or replaces the task of the same kind and node. The task is done between two local times of a
        day.

        ``task`` has further fields of ``Task``: ``value``, ``value_state``, ``weekdays``, ``date``, ``every_secs``.
        """
        window = {"from_secs": _seconds(begin), "until_secs": _seconds(end)}
        asked = {"kind": kind, "node": node, "duration_secs": duration_secs, **window, **task}
        added: dict[str, Any] = self.call("TaskService/SetTask", {"map": map, "task": asked})["task"]
        return added

    def remove_task(self, map: str, kind: str, node: str) -> None:
        """Removes a task; its learned data stays."""
        self.call("TaskService/RemoveTask", {"map": map, "kind": kind, "node": node})

    def tasks(self, map: str) -> pandas.DataFrame:
        """The tasks of a map, a row each, with the fields of ``Task``."""
        tables.pandas_needed()
        return tables.frame(self.call("TaskService/ListTasks", {"map": map})["tasks"])

    def plan_tasks(
        self,
        map: str,
        date: Any,
        *,
        start_node: str = "",
        keep: bool = False,
        **request: Any,
    ) -> pandas.DataFrame:
        """The tasks of a local day in their order: ``kind, node, departure, start, end, value, success``.

        ``attrs`` has the tasks that are ``unserved``, with the reason, the ``expected_value``, whether it is ``proven``
        that no plan is better, and the ``slots`` that are left over to explore. ``keep``: the map keeps the plan.
        ``request`` has further fields of ``PlanDayRequest``.
        """
        tables.pandas_needed()
        asked = {"map": map, "date": str(date)[:10], "tasks": True, "start_node": start_node, **request}
        if keep:
            reply = self.call("TaskService/KeepPlan", {"map": map, "day": asked})
        else:
            reply = self.call("ExplorationService/PlanDay", asked)
        zone = self._zone(map)
        planned = tables.of_planned(reply["tasks"], zone, ("kind", "node"), ("value", "success"))
        planned.attrs.update({name: reply[name] for name in ("unserved", "expected_value", "proven")})
        planned.attrs["slots"] = tables.of_day(reply, zone)
        return planned

    def kept_plan(
        self, map: str, date: Any = "", *, at: Time | None = None, zone: str | None = None
    ) -> pandas.DataFrame:
        """The kept plan of a local day, a row for each step; where ``kind`` is empty, the robot explores ``location``.

        ``attrs["current"]`` is the number of the step at the time ``at``, by default now; ``None``: nothing is planned
        then. Without ``date`` it is the day of that time.
        """
        tables.pandas_needed()
        asked: dict[str, Any] = {"map": map, "date": str(date)[:10]}
        if at is not None:
            asked["time"] = _times.timestamp(self._moment(map, at, zone))
        reply = self.call("TaskService/GetPlan", asked)
        words, numbers = ("kind", "node", "location"), ("value", "success", "information_bits")
        planned = tables.of_planned(reply["steps"], self._zone(map), words, numbers)
        planned.attrs.update({"date": reply["date"], "current": reply.get("current")})
        return planned

    def report_task(
        self,
        map: str,
        kind: str,
        node: str,
        start: Time,
        end: Time,
        success: bool,
        *,
        reason: str = "",
        intervention: bool = False,
        producer: str = "python",
        label: str = "tasks",
        sequence: int = 0,
        zone: str | None = None,
    ) -> int:
        """Reports a task that was done or has failed, and waits until it is durable.

        Returns its number in the sequence of producer and label. A report that is sent again with its ``sequence`` is
        taken once; with 0 it has the next number.
        """
        asked = {
            "map": map, "kind": kind, "node": node, "success": success, "reason": reason, "intervention": intervention,
            "producer": producer, "label": label, "sequence": sequence,
            "start_time": _times.timestamp(self._moment(map, start, zone)),
            "end_time": _times.timestamp(self._moment(map, end, zone)),
        }
        reply = self.call("TaskService/ReportTask", asked)
        for refusal in reply["refused"]:
            raise InvalidArgument(f"the report is refused: {refusal['detail']}", "INVALID_ARGUMENT")
        return int(reply["durable_sequence"])

    def task_weeks(self, map: str, begin: str = "00:00", end: str = "24:00", weekdays: int = 0) -> pandas.DataFrame:
        """The autonomy of the robots of a map, a row for each week: A % and TSL of IEEE RAM 2017, and counts."""
        tables.pandas_needed()
        hours = {"from_secs": _seconds(begin), "until_secs": _seconds(end), "weekdays": weekdays}
        return tables.frame(self.call("TaskService/ListTaskWeeks", {"map": map, **hours})["weeks"])
