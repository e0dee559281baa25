"""The durable queue of the client library, as the node uses it.

Invariant: a record that was put into the queue is on the disk, and the daemon counts it once. A thread creates the map
if the parameters say so, and logs each new problem once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import tidemap
from tidemap_ros import records
from tidemap_ros.clock_words import stated
from tidemap_ros.link import Link
from tidemap_ros.parameters import BadParameter, Settings
from tidemap_ros.records import MapGrid

WATCHED_EVERY_SECS = 0.2
MAP_RETRY_SECS = 2.0


class Queue:
    """The queue of the node's map, producer and label. All calls may come from any thread."""

    def __init__(self, settings: Settings, link: Link, log: Callable[[str], object] = lambda message: None) -> None:
        self.folder: Path = settings.spool_folder(link.producer_name)
        self._link = link
        self._log = log
        try:
            self._producer = link.open_queue(
                self.folder, int(settings.number("spool_megabytes") * 1e6), settings.number("spool_sync_seconds")
            )
        except (tidemap.TidemapError, OSError) as error:
            raise BadParameter(f"the spool {self.folder} cannot be opened: {error}") from None
        self._grid: MapGrid | None = None
        # The loss of an earlier run was logged by that run; all else is new.
        self._error: str | None = None
        self._lost = self._producer.state.lost
        self._unsendable = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="tidemap-queue", daemon=True)
        self._thread.start()

    @property
    def grid(self) -> MapGrid | None:
        """The grid of the map; ``None`` before the daemon was reached, or if the map has none."""
        return self._grid

    @property
    def state(self) -> tidemap.QueueState:
        """The counts until now."""
        return self._producer.state

    def put(self, record: records.Record) -> None:
        """Takes a record. Raises TidemapError if there is no room, or the disk refuses it."""
        producer = self._producer
        if isinstance(record, records.Value):
            producer.send(record.state, stated(record.time_nanos), record.value)
        elif isinstance(record, records.Ranges):
            producer.send_ranges(
                stated(record.time_nanos), record.pose, record.ranges_m, angle_min_rad=record.angle_min_rad,
                angle_increment_rad=record.angle_increment_rad, min_range_m=record.min_range_m,
                max_range_m=record.max_range_m, free_range_m=record.free_range_m,
                trusted_range_m=record.trusted_range_m, frame_id=record.frame_id,
            )
        elif isinstance(record, records.Cloud):
            producer.send_cloud(
                stated(record.time_nanos), record.pose, record.xyz_m, min_range_m=record.min_range_m,
                max_range_m=record.max_range_m, frame_id=record.frame_id,
            )
        elif isinstance(record, records.Picture):
            producer.send_occupancy(
                stated(record.time_nanos), record.pose, record.cells, resolution_m=record.resolution_m
            )
        else:
            producer.send_traversal(
                record.from_node, record.to_node, stated(record.start_nanos), stated(record.end_nanos),
                record.success, action=record.action, reason=record.reason,
            )

    def close(self) -> None:
        """Ends. Records that the daemon does not have stay on the disk."""
        self._ending.set()
        self._thread.join(2.0)
        self._producer.close()

    # The thread

    def _watch(self) -> None:
        pause = 0.0
        while not self._ending.wait(WATCHED_EVERY_SECS):
            pause -= WATCHED_EVERY_SECS
            if pause <= 0 and self._link.needs_map:
                pause = MAP_RETRY_SECS
                self._create_map()
            self._show(self._producer.state)

    def _create_map(self) -> None:
        try:
            self._link.ensure_map()
        except tidemap.Unavailable:
            return  # The queue shows that no daemon responds.
        except tidemap.TidemapError as error:
            self._log(f"the map cannot be created: {error}")
            return
        self._producer.retry_now()

    def _show(self, state: tidemap.QueueState) -> None:
        if self._grid is None and state.resolution_m is not None and state.origin_m is not None:
            self._grid = MapGrid(state.resolution_m, state.origin_m)
        if state.error is not None and state.error != self._error:
            self._log(f"nothing is sent now, and all is kept on the disk: {state.error}")
        if state.lost > self._lost:
            self._log(
                f"the daemon no longer has {state.lost - self._lost} records that it had acknowledged; "
                "was a backup restored?"
            )
        if state.unsendable > self._unsendable:
            self._log(
                f"{state.unsendable - self._unsendable} records cannot be sent, and are left out; the last: "
                f"{state.last_unsendable}"
            )
        self._error, self._lost, self._unsendable = state.error, state.lost, state.unsendable
