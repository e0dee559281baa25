"""A client of a daemon.

Invariant: the rows that a call sends are durable when it returns, and the same rows sent again add nothing. Errors have
the daemon's words.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, overload

import numpy as np

from tidemap import advice, frames
from tidemap import reports as _reports
from tidemap import times as _times
from tidemap.answers import Map, Observed, observed
from tidemap.errors import InvalidArgument, TidemapError, Unavailable
from tidemap.landmarks import Landmarks
from tidemap.producer import Producer, QueuedProducer
from tidemap.questions import Questions
from tidemap.reports import Duration, Reports
from tidemap.routes import Routes
from tidemap.tasks import Tasks
from tidemap.times import Time


class Client(Questions, Routes, Landmarks, Tasks):
    """A client of a daemon. Methods return when the daemon has answered; other threads of Python run meanwhile.

    Wherever a call takes times, ``zone`` is the zone of times that have none: ``"local"`` for the zone of the map, or
    the name of another one. Without ``zone`` such times are refused, unless the map is in UTC.
    """

    # Maps

    def maps(self) -> list[Map]:
        """All maps."""
        found: list[Map] = []
        token = ""
        while True:
            page = self.call("MapService/ListMaps", {"page_size": 1000, "page_token": token})
            found += [Map(one) for one in page["maps"]]
            token = page["next_page_token"]
            if not token:
                return found

    def map(self, name: str) -> Map:
        """One map."""
        return Map(self.call("MapService/GetMap", {"name": name})["map"])

    def create_map(
        self, name: str, *, time_zone: str = "UTC", grid_resolution_m: float | None = None, **settings: Any
    ) -> Map:
        """Creates a map; ``settings`` are further fields of ``CreateMapRequest``."""
        request = {"name": name, "time_zone": time_zone, **settings}
        if grid_resolution_m is not None:
            request["grid"] = {"resolution_m": grid_resolution_m, **settings.get("grid", {})}
        created = Map(self.call("MapService/CreateMap", request)["map"])
        self._zones[name] = str(created["time_zone"])
        return created

    def delete_map(self, name: str) -> None:
        """Deletes a map and all that it has learned."""
        self._zones.pop(name, None)
        self.call("MapService/DeleteMap", {"name": name})

    def add_state(
        self,
        map: str,
        state: str,
        *,
        kind: str | None = None,
        dimensions: int = 0,
        labels: Sequence[str] = (),
        hit: float | None = None,
        false_alarm: float | None = None,
        reports: Reports | None = None,
        hold_max: Duration | None = None,
        hold_step: Duration | None = None,
    ) -> dict[str, Any]:
        """Adds a state before its first observation; the same again changes nothing.

        ``kind``: ``probability``, ``continuous``, ``count``, ``vector`` (with ``dimensions`` 2 or 3) ``angle``, or
        ``categorical`` (with 2 to 64 ``labels``); by default ``probability``, and for events ``count``. ``reports``,
        ``hold_max`` and ``hold_step`` as in :meth:`observe`; by default samples. ``hit`` and ``false_alarm`` are the
        sensor of a state that is 0 or 1: the probability that it reads 1 when the state is 1, and when it is 0. Without
        them the daemon estimates how often the sensor errs.
        """
        stated = _reports.stated(reports, hold_max, hold_step)
        if kind is None:
            kind = "count" if stated is not None and stated.kind == "events" else "probability"
        request: dict[str, Any] = {
            "map": map, "state": state, "kind": f"STATE_KIND_{kind.upper()}", "dimensions": dimensions
        }
        if len(labels) > 0:
            request["labels"] = [str(label) for label in labels]
        if stated is not None:
            request["reporting"] = stated.request()
        sensor = {name: number for name, number in (("hit", hit), ("false_alarm", false_alarm)) if number is not None}
        if sensor:
            request["sensor"] = sensor
        added: dict[str, Any] = self.call("MapService/AddState", request)["state"]
        return added

    # Observations

    def observe(
        self,
        map: str,
        frame: Any = None,
        *,
        states: str | Sequence[str] | None = None,
        times: Any = None,
        values: Any = None,
        columns: Mapping[str, Any] | None = None,
        producer: str = "python",
        label: str = "",
        kind: str | None = None,
        nightly: bool = False,
        zone: str | None = None,
        progress: bool | Callable[[int, int], object] = False,
        reports: Reports | None = None,
        hold_max: Duration | None = None,
        hold_step: Duration | None = None,
        replace: bool = False,
    ) -> Observed:
        """Sends observations and waits until they are durable.

        ``frame`` is a DataFrame of pandas or polars, or a dictionary of columns. A long one has a row for each
        observation, with ``time``, ``state`` and ``value`` (or ``x``, ``y``, ``z`` in metres); a wide one has a row for
        each time and a column for each state. The time may be the index. ``columns={"time": "last_changed"}`` gives the
        frame's own names. With a frame, ``times="local"`` is the same as ``zone="local"``, and ``values={"ajar": 1}``
        gives the meanings of words, besides ``on/off``, ``open/closed``, ``home/away`` and other usual ones. Rows
        without a measurement (NaN, ``unavailable``, ``unknown``) are counted and not sent.

        With ``kind="categorical"`` values are labels; the states were added with these labels (:meth:`add_state`).

        Instead of a frame, give ``states`` (one name, or one for each row), ``times`` and ``values``; positions are
        values with two or three columns.

        ``reports`` is the kind of a row. ``"samples"``: a reading, such as one of a robot that passes by.
        ``"changes"``: the value from then on, such as one of a door contact or a smart home; a row without a value
        means that no value is known from then on, and an empty cell of a wide frame is no row. ``"events"``: one event,
        or a number of events, such as those of a light barrier; values may be left out. ``hold_max`` is the longest
        time for which a row of changes or events is valid (a week), ``hold_step`` the time between two readings that
        are learned from the rows (five minutes, and an hour for events): texts such as ``"7d"``, or a timedelta. New
        states keep this reporting; rows of states with another reporting are refused before anything is sent. Without
        ``reports`` each state keeps its reporting, and new states are reported by samples.

        The rows of a producer and label are counted from the first: the same rows sent again add nothing, and more rows
        behind them are added. Data that is not a continuation needs a ``label`` of its own, or ``replace=True``, which
        withdraws the rows that the producer has sent with the label before. ``nightly``: the nightly update follows the
        time of the data.
        """
        stated = _reports.stated(reports, hold_max, hold_step)
        said = "samples" if stated is None else stated.kind
        if kind == "categorical":
            said = frames.LABELS
        rows, given_zone = self._rows(frame, states, times, values, columns, zone, said)
        nanos = self._nanos(map, rows.times, given_zone, rows.indices, rows.source)
        if stated is not None:
            _reports.check(stated, rows.names, self._states(map))
        elif rows.without_value:
            _reports.check_values(rows.names, self._states(map))
        self._native.check_states(kind, None if stated is None else stated.native())
        if kind != "categorical":
            advice.of_one_time(rows, nanos)
        if replace:
            self._withdraw(map, producer, label)
        shown, done = _shown(progress)
        try:
            report = self._native.observe(
                map, rows.names, rows.indices, nanos, rows.values, producer, label, kind, nightly, rows.positions,
                shown, None if stated is None else stated.native(),
            )
        finally:
            done()
        if stated is None and kind != "categorical":
            advice.of_changes(rows, lambda: self._states(map))
        if report["duplicate"] and not report["accepted"]:
            advice.of_refused_before(rows, self._states(map))
        return observed(report, rows.source, rows.read, rows.without_value, rows.mapped, may_replace=True)

    def observe_grids(
        self,
        map: str,
        times: Any,
        grids: Any,
        *,
        first_cell: tuple[int, int, int] = (0, 0, 0),
        producer: str = "python",
        label: str = "",
        nightly: bool = False,
        zone: str | None = None,
    ) -> Observed:
        """Sends grids that were seen, and waits until they are durable; the same grids again add nothing.

        ``grids`` has the axes time, y, x, or time, z, y, x; ``first_cell`` is the index x, y, z of its first cell.
        Floats: NaN was not seen, from 0.5 on a cell is occupied. Integers: -1 was not seen, 0 is free, 1 occupied; or
        as ROS has it, -1 and percent from 0 to 100, of which 50 and more are occupied.
        """
        seen = np.asarray(grids)
        if seen.ndim == 3:
            seen = seen[:, np.newaxis]
        if seen.ndim != 4:
            raise InvalidArgument(
                f"grids have {seen.ndim} axes: use time, y, x, or time, z, y, x", "INVALID_ARGUMENT"
            )
        if seen.dtype.kind == "f":
            occupied = seen >= 0.5
            unseen = np.isnan(seen)
        else:
            occupied = seen >= (50 if seen.size and seen.max() > 1 else 1)
            unseen = seen < 0
        cells = np.ascontiguousarray(np.where(unseen, -1, occupied).astype(np.int8))
        nanos = self._nanos(map, times, zone)
        return observed(self._native.observe_grids(map, nanos, cells, first_cell, producer, label, nightly))

    @overload
    def producer(
        self,
        map: str,
        producer: str = "python",
        label: str = "live",
        *,
        kind: str | None = None,
        zone: str | None = None,
        reports: Reports | None = None,
        hold_max: Duration | None = None,
        hold_step: Duration | None = None,
        patience_secs: float = 60.0,
        queue: None = None,
    ) -> Producer: ...

    @overload
    def producer(
        self,
        map: str,
        producer: str = "python",
        label: str = "live",
        *,
        kind: str | None = None,
        zone: str | None = None,
        reports: Reports | None = None,
        hold_max: Duration | None = None,
        hold_step: Duration | None = None,
        queue: str | os.PathLike[str],
        queue_bytes_max: int = 1 << 30,
        queue_sync_secs: float = 1.0,
    ) -> QueuedProducer: ...

    def producer(
        self,
        map: str,
        producer: str = "python",
        label: str = "live",
        *,
        kind: str | None = None,
        zone: str | None = None,
        reports: Reports | None = None,
        hold_max: Duration | None = None,
        hold_step: Duration | None = None,
        patience_secs: float = 60.0,
        queue: str | os.PathLike[str] | None = None,
        queue_bytes_max: int = 1 << 30,
        queue_sync_secs: float = 1.0,
    ) -> Producer:
        """A producer that stays open, for observations as they come; ``kind`` and ``reports`` as in :meth:`observe`.

        If the daemon cannot be reached, the producer tries again for ``patience_secs`` before it gives up.

        With ``queue``, the name of a folder, observations wait in files there until the daemon has them: they survive
        the end of this program and, after ``queue_sync_secs``, a power cut. The producer is a
        :class:`tidemap.QueuedProducer`, which does not wait for the daemon and never gives up. More than
        ``queue_bytes_max`` bytes are refused. Each producer needs a folder of its own. Use times with a zone, or set
        ``zone``: the zone of the map is not known before the daemon was reached.
        """
        stated = _reports.stated(reports, hold_max, hold_step)
        said = None if stated is None else stated.native()
        reported = "samples" if stated is None else stated.kind
        if queue is not None:
            folder = os.fspath(queue)
            kept = self._native.open_queue(
                map, producer, label, folder, queue_bytes_max, queue_sync_secs, kind, said
            )
            return QueuedProducer(kept, zone, lambda: self._zone_offline(map), reported)
        native = self._native.open_producer(map, producer, label, kind, said, patience_secs)
        return Producer(native, zone, lambda: self._zone(map), reported)

    def _zone_offline(self, map: str) -> str:
        """The zone of a map, for a program that may run without the daemon."""
        try:
            return self._zone(map)
        except Unavailable as error:
            raise Unavailable(
                f"the zone of the map {map} is not known yet: use times with a zone, or open the producer with "
                f"zone=\"UTC\" ({error})",
                "UNAVAILABLE",
            ) from None

    def update(self, map: str, until: Time | None = None, *, zone: str | None = None) -> dict[str, Any]:
        """Learns the new observations, as the nightly update does, and waits until this ends; returns the job."""
        request: dict[str, Any] = {"map": map}
        if until is not None:
            request["until"] = _times.timestamp(self._moment(map, until, zone))
        return self._ended(self.call("MaintenanceService/RunUpdate", request)["job"], f"the update of {map}")

    def erase(
        self,
        map: str,
        state: str | None = None,
        from_time: Time | None = None,
        to_time: Time | None = None,
        *,
        producer: str | None = None,
        label: str | None = None,
        zone: str | None = None,
    ) -> dict[str, Any]:
        """Erases a state, or the observations of a producer, or an interval, as if it had never been observed.

        The data is gone from history, models, log and later backups when this returns; ``to_time`` is not included.
        Returns the job, whose ``observations`` were erased. Data that cannot be erased exactly is refused, and nothing
        changes.
        """
        request: dict[str, Any] = {"map": map, "state": state or "", "producer": producer or ""}
        if label is not None:
            request["label"] = label
        for name, time in (("from_time", from_time), ("to_time", to_time)):
            if time is not None:
                request[name] = _times.timestamp(self._moment(map, time, zone))
        return self._ended(self.call("MaintenanceService/Erase", request)["job"], f"the erasure in {map}")

    def forget_producer(self, map: str, producer: str, *, label: str | None = None) -> int:
        """Frees the places of a producer that will not come back: of all its labels, or of one.

        Its observations stay and keep their numbers. Returns the number of labels that have given their places up.
        ``NotFound``: the map has no such producer; ``FailedPrecondition``: it has an open stream.
        """
        request: dict[str, Any] = {"map": map, "producer": producer}
        if label is not None:
            request["label"] = label
        return int(self.call("MaintenanceService/ForgetProducer", request)["forgotten"])

    def _withdraw(self, map: str, producer: str, label: str) -> None:
        """Erases the rows that a producer has sent with a label, if there are any, so that they count when they are
        sent again."""
        token = ""
        while True:
            page = self.call("MaintenanceService/ListProducers", {"map": map, "page_size": 10_000, "page_token": token})
            if any((known["producer"], known["label"]) == (producer, label) for known in page["producers"]):
                break
            token = page["next_page_token"]
            if not token:
                return
        request = {"map": map, "producer": producer, "label": label, "forget_sequence": True}
        self._ended(self.call("MaintenanceService/Erase", request)["job"], f"the erasure in {map}")

    def _ended(self, job: dict[str, Any], what: str) -> dict[str, Any]:
        """A job when it has ended."""
        for reply in self.stream("MaintenanceService/WatchJob", {"id": job["id"]}):
            job = reply["job"]
        if job.get("state") == "JOB_STATE_FAILED":
            raise TidemapError(f"{what} failed: {job.get('error', '')}", "INTERNAL")
        return dict(job)

    def jobs(self, map: str = "") -> list[dict[str, Any]]:
        """Running jobs, and those that ended recently, the newest first; of one map, or of all."""
        jobs: list[dict[str, Any]] = self.call("MaintenanceService/ListJobs", {"page_size": 1000})["jobs"]
        return [job for job in jobs if map in ("", job["map"])]


def connect(server: str = "127.0.0.1:7435", **credentials: Any) -> Client:
    """A client of the daemon at ``server``, checked: ``HOST:PORT``, ``https://HOST:PORT`` or ``unix:PATH``.

    ``token``, ``token_file``, ``ca``, ``certificate`` and ``key`` as of :class:`Client`.
    """
    client = Client(server, **credentials)
    client.maps()
    return client


def _shown(
    progress: bool | Callable[[int, int], object],
) -> tuple[Callable[[int, int], object] | None, Callable[[], None]]:
    """The function that is called with the number of durable rows and of all rows, and the function that ends the
    display."""
    if callable(progress):
        return progress, lambda: None
    if not progress:
        return None, lambda: None
    try:
        from tqdm import auto as tqdm_auto
    except ImportError:
        def plain(durable: int, rows: int) -> None:
            print(f"\r{durable:,} of {rows:,} observations", end="", flush=True)

        return plain, print
    bars: Any = tqdm_auto
    bar = bars.tqdm(unit="obs", unit_scale=True)

    def step(durable: int, rows: int) -> None:
        bar.total = rows
        bar.update(durable - bar.n)

    return step, bar.close
