"""The operations of STRANDS' fremenserver, answered by tidemap; without ROS.

Invariant: ``add`` and ``addvalues`` succeed only when the daemon has the readings on its disk, and a prediction
includes all readings that were added before it. An operation returns its results in the same fields as fremenserver.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

import tidemap
from tidemap_ros.link import Link
from tidemap_ros.predecessors import (
    FAILED, IDS_MAX, LENGTHS_DIFFER, ORDER_MAX, SECOND, TIMES_MAX, UNKNOWN, Floats, Refused, Seconds, States,
    checked_count, nanos,
)

PATIENCE_SECS = 5.0
"""The time for which a call waits for an unreachable daemon, before readings are refused."""
ORDER_ACCEPTED_MAX = 100
"""A higher order is refused, as fremenserver does."""
BETTER_BY = 0.001
"""An order is better than a lower one only if its error is lower by more than this."""


@dataclass
class Answer:
    """A result of the action, and whether the goal has succeeded."""

    is_done: bool
    success: int
    message: str
    probabilities: list[float] = field(default_factory=list)
    entropies: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    anomaly_times: list[int] = field(default_factory=list)
    anomaly_values: list[int] = field(default_factory=list)


class Fremen:
    """The server of operations on states."""

    def __init__(
        self, link: Link, map_name: str, label: str, learn_period_secs: float,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._link, self._states, self._label = link, States(link, map_name), label
        self._period_secs, self._monotonic = learn_period_secs, monotonic
        self._learned_at = -math.inf
        self._operations: dict[str, Callable[[Any], Answer]] = {
            "add": self._add, "addvalues": self._add, "predict": self._predict, "entropy": self._predict,
            "forecast": self._forecast, "forecastEntropy": self._forecast, "evaluate": self._evaluate,
            "detect": self._detect, "remove": self._remove, "delete": self._remove, "update": self._update,
            "view": self._view, "debug": self._debug,
        }

    def answer(self, goal: Any) -> Answer:
        """The result of any goal."""
        operation = self._operations.get(goal.operation)
        if operation is None or (goal.operation == "detect" and not hasattr(goal, "confidence")):
            known = ", ".join(self._operations)
            return Answer(False, 0, f"Unknown action requested: {goal.operation[:100]!r}; known are {known}")
        try:
            checked_count(len(goal.times), TIMES_MAX, "times")
            checked_count(len(goal.ids), IDS_MAX, "ids")
            if goal.order > ORDER_ACCEPTED_MAX:
                raise Refused(f"the order {goal.order} is too high: usual is 2, and at most {ORDER_MAX} rhythms count")
            return operation(goal)
        except Refused as refusal:
            return Answer(False, refusal.code, str(refusal))
        except tidemap.TidemapError as error:
            return Answer(False, FAILED, f"tidemap: {error}")

    # Readings

    def _add(self, goal: Any) -> Answer:
        name, is_words = _id(goal), goal.operation == "add"
        seconds = _seconds(goal)
        given = goal.states if is_words else goal.values
        _same_lengths(goal, "states" if is_words else "values")
        values = np.asarray(given, dtype=np.float64)
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise Refused(f"values has no number at index {row}: {values[row]}")
        self._link.ensure_map()
        try:
            last, kind = self._states.described(name).get("last_time"), None
        except Refused as refusal:
            if refusal.code != UNKNOWN:
                raise
            # A state is of the kind of its first readings, and probabilities are from 0 to 1.
            last, kind = None, None if ((values >= 0) & (values <= 1)).all() else "continuous"
        fresh = seconds * SECOND > (nanos(last) if last else -1)
        self._send(name, seconds[fresh], values[fresh], kind)
        count = int(fresh.sum())
        return Answer(True, count, f"Added {count} of {len(seconds)} readings to the state {name}.")

    def _send(self, name: str, seconds: Seconds, values: Floats, kind: str | None) -> None:
        """Sends readings and waits until they are durable."""
        if not len(seconds):
            return
        producer = self._link.client.producer(
            self._states.map_name, self._link.producer_name, self._label, kind=kind, patience_secs=PATIENCE_SECS
        )
        try:
            for second, value in zip(seconds.tolist(), values.tolist()):
                # Floats are seconds; small integers are refused, and simulated clocks begin at 0.
                producer.send(name, float(second), value)
            producer.flush()
            refusals = producer.take_refusals()
        except BaseException:
            producer.abandon()
            raise
        producer.close()
        if refusals:
            raise Refused(
                f"{len(refusals)} of {len(seconds)} readings of the state {name} were refused: {refusals[0].detail}"
            )

    # Predictions

    def _predicted(self, names: list[str], seconds: Seconds, order: int) -> Floats:
        """Predictions that include all added readings: fremenserver learns on request, tidemap in updates."""
        values, pending = self._states.predicted(names, seconds, order)
        if pending and self._monotonic() - self._learned_at >= self._period_secs:
            self._states.update()
            self._learned_at = self._monotonic()
            values, _ = self._states.predicted(names, seconds, order)
        return values

    def _of_one(self, name: str, seconds: Seconds, order: int) -> Floats:
        if not len(seconds):
            self._states.described(name)
            return np.zeros(0)
        try:
            return np.asarray(self._predicted([name], seconds, order)[0])
        except tidemap.NotFound:
            raise self._states.missing(name) from None

    def _predict(self, goal: Any) -> Answer:
        name, seconds = _id(goal), _seconds(goal)
        values = self._of_one(name, seconds, goal.order)
        if goal.operation == "entropy":
            message = f"Performed {len(seconds)} entropy estimations of the state {name}."
            return Answer(True, len(seconds), message, entropies=_floats(entropies(values)))
        message = f"Performed {len(seconds)} predictions of the state {name}."
        return Answer(True, len(seconds), message, probabilities=_floats(values))

    def _forecast(self, goal: Any) -> Answer:
        if len(goal.times) != 1:
            raise Refused(f"{goal.operation} is for one time, and times has {len(goal.times)}", UNKNOWN)
        ids, seconds = list(goal.ids), _seconds(goal)
        orders = list(goal.orders) if len(goal.orders) == len(ids) else [goal.order] * len(ids)
        present = self._states.names()
        values = np.full(len(ids), -1.0)
        known = 0
        for order in dict.fromkeys(orders):
            rows = [row for row, name in enumerate(ids) if orders[row] == order and name in present]
            if rows:
                values[rows] = self._predicted([ids[row] for row in rows], seconds, order)[:, 0]
                known += len(rows)
        if goal.operation == "forecastEntropy":
            shown = np.where([name in present for name in ids], entropies(values), -1.0) if ids else values
            return Answer(True, known, f"Predicted the entropies of {known} states.", entropies=_floats(shown))
        return Answer(True, known, f"Predicted the probabilities of {known} states.", probabilities=_floats(values))

    def _evaluate(self, goal: Any) -> Answer:
        name, seconds = _id(goal), _seconds(goal)
        _same_lengths(goal, "states")
        if goal.order < 0 or not len(seconds):
            raise Refused("evaluate needs times, states and an order of at least 0")
        truth = np.asarray(goal.states, dtype=bool)
        errors: list[float] = []
        for order in range(goal.order + 1):
            if order > ORDER_MAX:
                errors.append(errors[-1])
                continue
            errors.append(float(np.mean((self._of_one(name, seconds, order) > 0.5) != truth)))
        best = 0
        for order, error in enumerate(errors):
            if error < errors[best] - BETTER_BY:
                best = order
        message = f"Compared {len(errors)} orders of the state {name} with {len(seconds)} readings. The best is {best}."
        return Answer(True, best, message, errors=_floats(np.array(errors)))

    def _detect(self, goal: Any) -> Answer:
        name, seconds = _id(goal), _seconds(goal)
        _same_lengths(goal, "values")
        values, expected = np.asarray(goal.values, dtype=np.float64), self._of_one(name, seconds, goal.order)
        strange = np.abs(values - expected) >= goal.confidence
        shown = np.clip(np.nan_to_num(values[strange]), 0, 2**32 - 1)
        return Answer(
            True, int(strange.sum()), f"Detected {int(strange.sum())} anomalies in {len(seconds)} readings of {name}.",
            probabilities=_floats(expected), anomaly_times=seconds[strange].tolist(),
            anomaly_values=shown.astype(np.int64).tolist(),
        )

    # States

    def _remove(self, goal: Any) -> Answer:
        name = _id(goal)
        self._states.described(name)
        count = len(self._states.names())
        self._link.client.erase(self._states.map_name, name)
        return Answer(True, count, f"The state {name}, of {count}, is erased.")

    def _update(self, goal: Any) -> Answer:
        self._states.update()
        return Answer(True, 1, "The map has learned the observations.")

    def _view(self, goal: Any) -> Answer:
        """Mean and rhythms, as ``mean + sum of 2 amplitude cos(2 pi t / period - phase)`` with t in seconds of UTC."""
        name, order = _id(goal), min(int(goal.order), ORDER_MAX)
        known = self._states.described(name)
        if known["learned_observations"] < known["observations"]:
            self._states.update()
            known = self._states.described(name)
        rhythms = known["components"]
        order = len(rhythms) if order < 0 else order
        offset = self._offset_secs(known.get("last_time"))
        periods, amplitudes, phases = [math.inf], [float(known["mean"])], [0.0]
        for row in range(order):
            if row >= len(rhythms):
                # Fewer rhythms were found: these add nothing.
                periods, amplitudes, phases = [*periods, math.inf], [*amplitudes, 0.0], [*phases, 0.0]
                continue
            period = float(rhythms[row]["period_secs"])
            turned = -float(rhythms[row]["phase_rad"]) - 2 * math.pi * offset / period
            periods.append(period)
            amplitudes.append(float(rhythms[row]["amplitude"]) / 2)
            phases.append(math.remainder(turned, 2 * math.pi))
        message = (
            f"The {order} strongest rhythms of the state {name}: probabilities has their periods in seconds, entropies "
            "their amplitudes, errors their phases. The first is the mean, with an infinite period."
        )
        return Answer(True, order, message, periods, amplitudes, phases)

    def _offset_secs(self, last_time: str | None) -> float:
        """The offset of the map's zone from UTC at a time: the rhythms of the map follow the wall clock."""
        zone = str(self._link.map()["time_zone"])
        if zone == "UTC" or not last_time:
            return 0.0
        moment = datetime.fromtimestamp(nanos(last_time) // SECOND, timezone.utc)
        try:
            ahead = moment.astimezone(ZoneInfo(zone)).utcoffset()
        except (OSError, LookupError, ValueError):
            raise Refused(f"this machine does not have the time zone {zone} of the map") from None
        return 0.0 if ahead is None else ahead.total_seconds()

    @staticmethod
    def _debug(goal: Any) -> Answer:
        return Answer(True, 1, "Nothing is printed: see `tidemap state list` and `tidemap model show`.")


def entropies(values: Floats) -> Floats:
    """The entropy of probabilities in bits; 0 outside of 0 to 1."""
    inside = np.where((values > 0) & (values < 1), values, 0.5)
    bits = -(inside * np.log2(inside) + (1 - inside) * np.log2(1 - inside))
    return np.asarray(np.where((values > 0) & (values < 1), bits, 0.0))


def _id(goal: Any) -> str:
    if not goal.id:
        raise Refused(f"{goal.operation} needs the id of a state")
    return str(goal.id)


def _seconds(goal: Any) -> Seconds:
    return np.asarray(goal.times, dtype=np.int64)


def _same_lengths(goal: Any, name: str) -> None:
    count = len(getattr(goal, name))
    if count != len(goal.times):
        raise Refused(f"times has {len(goal.times)} entries and {name} has {count}", LENGTHS_DIFFER)


def _floats(values: Floats) -> list[float]:
    """Numbers as the message has them, so that large ones become infinite and do not fail to be sent."""
    with np.errstate(over="ignore"):
        return [float(value) for value in values.astype(np.float32)]
