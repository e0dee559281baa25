"""Sends the records of the spool to the daemon, in order, and takes its acknowledgements.

Invariant: record n has the sequence number n + offset, on every connection and after every restart; so the daemon
counts it once. A record that cannot be sent uses its number for something that the daemon refuses.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tidemap_ros import arrays, records
from tidemap_ros.clock_words import stated
from tidemap_ros.spool import Position, Spool, SpoolError

IN_FLIGHT_RECORDS = 4096
IN_FLIGHT_BYTES = 24 << 20
"""The maximum amount in flight; less than the client library takes before it makes a caller wait."""
ACKNOWLEDGED_EVERY_SECS = 0.02
RETRY_SECS = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0)
PATIENCE_SECS = 5.0
REASONS_KEPT = 20


@dataclass
class SenderState:
    """The counts of observations; shown in diagnostics."""

    connected: bool = False
    error: str | None = None
    """Why nothing is sent now."""
    error_since: float | None = None
    durable_records: int = 0
    """Records since the start of the node that the daemon has on its disk, or has refused."""
    waiting_records: int = 0
    oldest_waiting_nanos: int | None = None
    """The time of the oldest record that waits."""
    refused: int = 0
    """Records that the daemon refused."""
    unreported: int = 0
    """Records that became durable while a connection broke, so that their refusals are not known."""
    reasons: dict[str, int] = field(default_factory=dict)
    """The refusals: reason, and number."""
    last_refusal: str = ""
    unsendable: int = 0


@dataclass(frozen=True)
class MapGrid:
    """The grid of the map, for grids that are sent."""

    resolution_m: float
    origin_m: tuple[float, float, float]


class Sender(threading.Thread):
    """The thread that sends.

    ``open_producer`` gives an open producer of ``tidemap``; ``grid_of_map`` the grid of the map, or ``None`` if it has
    none.
    """

    def __init__(
        self,
        spool: Spool,
        open_producer: Callable[[], Any],
        grid_of_map: Callable[[], MapGrid | None],
        sync_secs: float = 1.0,
        log: Callable[[str], object] = lambda message: None,
    ) -> None:
        super().__init__(name="tidemap-sender", daemon=True)
        self.spool = spool
        self._open_producer = open_producer
        self._grid_of_map = grid_of_map
        self._grid: MapGrid | None = None
        self._sync_secs = sync_secs
        self._log = log
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._state = SenderState()
        self._producer: Any = None
        self._next = spool.first
        self._at: Position | None = None
        self._in_flight: list[tuple[int, int, int]] = []
        """Number, bytes and time of the records in flight."""
        self._bytes_in_flight = 0
        self._synced = time.monotonic()
        self._failures = 0

    # State that other threads see

    @property
    def grid(self) -> MapGrid | None:
        """The grid of the map; ``None`` before the daemon was reached, or if the map has none."""
        return self._grid

    @property
    def state(self) -> SenderState:
        """The counts of observations, until now."""
        with self._lock:
            known = SenderState(**vars(self._state))
            known.reasons = dict(self._state.reasons)
            first, oldest = self._in_flight[0][::2] if self._in_flight else (self._next, None)
        known.waiting_records = max(self.spool.last - first + 1, 0)
        known.oldest_waiting_nanos = oldest if oldest is not None else self._seen_nanos(first)
        return known

    def _seen_nanos(self, number: int) -> int | None:
        """The observation time of a record of the spool."""
        try:
            found = self.spool.read(None, number)
            return None if found is None else records.time_of(records.decoded(found[0]))
        except (OSError, records.BadRecord):
            return None

    def stop(self, timeout_secs: float = 2.0) -> None:
        """Ends the thread. Records that are not acknowledged stay in the spool."""
        self._stopping.set()
        with self.spool.grown:
            self.spool.grown.notify_all()
        self.join(timeout_secs)

    # The thread

    def run(self) -> None:
        """Sends until it is stopped."""
        while not self._stopping.is_set():
            try:
                if self._producer is None:
                    self._connect()
                self._step()
            except Exception as error:  # noqa: BLE001
                # Any error is caught here: it must be shown, and observations must still be sent when it is over.
                self._failed(error)
            self._sync()
        self._abandon()

    def _connect(self) -> None:
        producer = self._open_producer()
        try:
            self._grid = self._grid_of_map()
            durable = producer.progress.durable_sequence
            lost_before = self.spool.lost
            self.spool.linked(durable)
        except BaseException:
            producer.abandon()
            raise
        if self.spool.lost > lost_before:
            self._log(
                f"the daemon no longer has {self.spool.lost - lost_before} records that it had acknowledged; "
                "was a backup restored?"
            )
        with self._lock:
            self._producer = producer
            following = max(self.spool.first, durable - (self.spool.offset or 0) + 1)
            # These records were in flight when a connection broke, and had arrived.
            self._state.durable_records += max(following - self._next, 0)
            self._next = following
            self._at = None
            self._in_flight.clear()
            self._bytes_in_flight = 0
            self._state.connected, self._state.error, self._state.error_since = True, None, None
        self._failures = 0

    def _step(self) -> None:
        self._acknowledge()
        sent = 0
        while self._has_room() and not self._stopping.is_set():
            found = self.spool.read(self._at, self._next)
            if found is None:
                break
            raw, following = found
            seen_nanos = self._send(raw)
            with self._lock:
                self._in_flight.append((self._next, len(raw), seen_nanos))
                self._bytes_in_flight += len(raw)
                self._next, self._at = self._next + 1, following
            sent += 1
        if sent == 0:
            with self.spool.grown:
                self.spool.grown.wait(ACKNOWLEDGED_EVERY_SECS if self._in_flight else ACKNOWLEDGED_EVERY_SECS * 10)

    def _has_room(self) -> bool:
        return len(self._in_flight) < IN_FLIGHT_RECORDS and self._bytes_in_flight < IN_FLIGHT_BYTES

    def _acknowledge(self) -> None:
        progress = self._producer.progress
        durable = progress.durable_sequence - (self.spool.offset or 0)
        refusals = self._producer.take_refusals()
        with self._lock:
            state, gone = self._state, 0
            while gone < len(self._in_flight) and self._in_flight[gone][0] <= durable:
                self._bytes_in_flight -= self._in_flight[gone][1]
                gone += 1
            del self._in_flight[:gone]
            state.durable_records += gone
            state.refused += len(refusals)
            state.unreported = progress.unreported + progress.dropped_refusals
            for refusal in refusals:
                reason = refusal.reason or "unknown"
                if reason in state.reasons or len(state.reasons) < REASONS_KEPT:
                    state.reasons[reason] = state.reasons.get(reason, 0) + 1
                state.last_refusal = refusal.detail
            state.connected = progress.phase == "connected"
            if progress.phase == "waiting" and state.error_since is None:
                state.error, state.error_since = progress.error, time.monotonic()
            elif progress.phase == "connected":
                state.error = state.error_since = None
        if gone:
            self.spool.acknowledged(progress.durable_sequence)
        if progress.phase == "ended":
            raise RuntimeError(progress.error or "the stream ended")

    def _send(self, raw: bytes) -> int:
        """Hands a record over, and returns when it was seen. It uses exactly one number of the sequence."""
        expected = self._next + (self.spool.offset or 0)
        seen_nanos = 0
        try:
            record = records.decoded(raw)
            seen_nanos = records.time_of(record)
            number = self._hand_over(record)
        except (records.BadRecord, ValueError) as error:
            # The name of a state has no slash: the daemon refuses it, and the number is used. Where the stream has
            # ended this raises, too, and the record is kept.
            number = self._producer.send("tidemap_ros/unsendable", stated(max(seen_nanos, 0)), 0.0)
            with self._lock:
                self._state.unsendable += 1
            self._log(f"a record cannot be sent, and is left out: {error}")
        if number != expected:
            raise SpoolError(f"the daemon counts {number} where the spool counts {expected}")
        return seen_nanos

    def _hand_over(self, record: records.Record) -> int:
        producer = self._producer
        if isinstance(record, records.Value):
            return int(producer.send(record.state, stated(record.time_nanos), record.value))
        if isinstance(record, records.Ranges):
            return int(producer.send_ranges(
                stated(record.time_nanos), record.pose, record.ranges_m, angle_min_rad=record.angle_min_rad,
                angle_increment_rad=record.angle_increment_rad, min_range_m=record.min_range_m,
                max_range_m=record.max_range_m, frame_id=record.frame_id,
            ))
        if isinstance(record, records.Cloud):
            return int(producer.send_cloud(
                stated(record.time_nanos), record.pose, record.xyz_m, min_range_m=record.min_range_m,
                max_range_m=record.max_range_m, frame_id=record.frame_id,
            ))
        if isinstance(record, records.Picture):
            if self._grid is None:
                raise ValueError("the map has no grid: create it with a resolution")
            cells, first = arrays.in_cells_of_map(
                record.cells, record.pose, record.resolution_m, self._grid.resolution_m, self._grid.origin_m
            )
            return int(producer.send_grid(stated(record.time_nanos), cells, first_cell=first))
        return int(producer.send_traversal(
            record.from_node, record.to_node, stated(record.start_nanos), stated(record.end_nanos), record.success,
            action=record.action, reason=record.reason,
        ))

    def _failed(self, error: Exception) -> None:
        self._abandon()
        pause = RETRY_SECS[min(self._failures, len(RETRY_SECS) - 1)]
        self._failures += 1
        with self._lock:
            is_new = self._state.error != str(error)
            self._state.connected, self._state.error = False, str(error)
            self._state.error_since = self._state.error_since or time.monotonic()
        if is_new:
            self._log(f"nothing is sent now, and all is kept on the disk: {error}")
        until = time.monotonic() + pause
        while time.monotonic() < until and not self._stopping.wait(0.2):
            self._sync()

    def _sync(self) -> None:
        if time.monotonic() - self._synced >= self._sync_secs:
            self._synced = time.monotonic()
            try:
                self.spool.sync()
            except OSError as error:
                with self._lock:
                    self._state.error = f"the spool cannot be written: {error}"

    def _abandon(self) -> None:
        producer, self._producer = self._producer, None
        if producer is not None:
            producer.abandon()
        with self._lock:
            if self._in_flight:
                self._next, self._at = self._in_flight[0][0], None
            self._in_flight.clear()
            self._bytes_in_flight = 0
            self._state.connected = False
