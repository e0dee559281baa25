"""Observations as they come.

Invariant: what was taken is sent in order, and durable after a flush.
"""

from __future__ import annotations

from collections.abc import Callable

from tidemap import frames
from tidemap import times as _times
from tidemap._native import OpenProducer
from tidemap.errors import InvalidArgument
from tidemap.times import Time


class Producer:
    """Observations as they come; use it as a context manager. What it has taken is durable after ``flush()``."""

    def __init__(
        self, native: OpenProducer, zone: str | None, zone_of_map: Callable[[], str], reports: str = "samples"
    ) -> None:
        self._native = native
        self._zone = zone
        self._zone_of_map = zone_of_map
        self._reports = reports

    def send(self, state: str, time: Time, value: float | bool | str | None) -> int:
        """Takes an observation and returns its number; it is sent in the background.

        ``value`` may be a word. ``None``, NaN or ``unavailable`` of changes or events says that no value is known from
        then on. Of events it is their number, usually 1.
        """
        nanos = int(_times.resolve(_times.read(time), self._zone, self._zone_of_map)[0])
        number = float(frames.numbers([value], reports=self._reports).values[0])
        if number != number and self._reports == "samples":
            raise InvalidArgument(
                f"{value!r} is no value: nothing was measured. If the sensor reports changes, open the producer with "
                "reports=\"changes\"",
                "INVALID_ARGUMENT",
            )
        return self._native.send(state, nanos, number)

    def flush(self) -> int:
        """Waits until everything that was taken is durable, and returns the number of the last."""
        return self._native.flush()

    def close(self) -> None:
        """Waits until everything is durable, and ends."""
        self._native.close()

    def __enter__(self) -> Producer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
