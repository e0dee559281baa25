"""Observations as they come.

Invariant: observations that were taken are sent in order, and durable after a flush. With a queue they are sent also
after the end of this program.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap import frames
from tidemap import times as _times
from tidemap._native import NativeQueue, OpenProducer
from tidemap.errors import InvalidArgument
from tidemap.times import Time

Pose = tuple[float, float, float, float, float, float, float]
"""A pose: x, y, z in metres, and the turn as a quaternion x, y, z, w."""


@dataclass(frozen=True)
class Progress:
    """The progress of a producer."""

    phase: str
    """``connecting``, ``connected``, ``waiting`` (the daemon cannot be reached now) or ``ended``."""
    error: str | None
    """Why it waits or has ended."""
    durable_sequence: int
    """Everything up to this number is on the daemon's disk, or refused."""
    last_sequence: int
    """Number of the last that was taken."""
    store_id: str
    """Id of the data folder of the daemon."""
    unreported: int
    """The number of observations that became durable while the connection broke, so that it is not known whether they
    were refused."""
    dropped_refusals: int
    """The number of refusals that were dropped because nobody took the earlier ones."""


@dataclass(frozen=True)
class Refusal:
    """An observation that the daemon did not take. Its number is used."""

    sequence: int
    reason: str | None
    """For programs, such as ``Empty`` or ``Frame``; ``None``: a reason that this version does not know."""
    detail: str
    """In words."""


class Producer:
    """Sends observations as they come; use it as a context manager. Observations that it has taken are durable after
    ``flush()``."""

    def __init__(
        self,
        native: OpenProducer | NativeQueue,
        zone: str | None,
        zone_of_map: Callable[[], str],
        reports: str = "samples",
    ) -> None:
        self._native = native
        self._zone = zone
        self._zone_of_map = zone_of_map
        self._reports = reports

    def send(self, state: str, time: Time, value: float | bool | str | None) -> int:
        """Takes an observation and returns its number; it is sent in the background.

        ``value`` may be a word. ``None``, NaN or ``unavailable`` in changes or events means that no value is known from
        then on. In events ``value`` is the number of events, usually 1.
        """
        nanos = self._nanos(time)
        number = float(frames.numbers([value], reports=self._reports).values[0])
        if number != number and self._reports == "samples":
            raise InvalidArgument(
                f"{value!r} is no value: nothing was measured. If the sensor reports changes, open the producer with "
                "reports=\"changes\"",
                "INVALID_ARGUMENT",
            )
        return self._native.send(state, nanos, number)

    def send_label(self, state: str, time: Time, label: str) -> int:
        """Takes the label of a categorical state that holds, and returns its number."""
        return self._native.send_label(state, self._nanos(time), label)

    def send_position(self, state: str, time: Time, coordinates: npt.ArrayLike) -> int:
        """Takes a position, x and y or x, y and z in metres, and returns its number."""
        found = np.asarray(coordinates, dtype=np.float64)
        if found.ndim != 1:
            raise InvalidArgument(f"coordinates with {found.ndim} axes: use x, y or x, y, z", "INVALID_ARGUMENT")
        return self._native.send_position(state, self._nanos(time), found.tolist())

    def send_ranges(
        self,
        time: Time,
        pose: Pose,
        ranges_m: npt.ArrayLike,
        *,
        angle_min_rad: float,
        angle_increment_rad: float,
        max_range_m: float,
        min_range_m: float = 0.0,
        free_range_m: float = 0.0,
        trusted_range_m: float = 0.0,
        frame_id: str = "",
    ) -> int:
        """Takes a scan of a planar range finder at ``pose`` in the map, and returns its number.

        Angles go counter-clockwise from the x axis of the sensor. Infinity, and ``max_range_m`` or more: the beam has
        no return; NaN: no reading. Beams without a return show that the way is free up to ``free_range_m``; with 0 they
        show nothing. Readings nearer than ``min_range_m`` are ignored; readings farther than ``trusted_range_m`` only
        show that the way is free up to it (0: all readings count). ``frame_id`` is the frame of the pose; empty: the
        frame of the map.
        """
        nanos, ranges = self._nanos(time), np.ascontiguousarray(ranges_m, dtype=np.float32)
        return self._native.send_ranges(
            nanos, pose, angle_min_rad, angle_increment_rad, ranges, min_range_m, max_range_m, free_range_m,
            trusted_range_m, frame_id
        )

    def send_cloud(
        self,
        time: Time,
        pose: Pose,
        xyz_m: npt.ArrayLike,
        *,
        min_range_m: float = 0.0,
        max_range_m: float = 0.0,
        frame_id: str = "",
    ) -> int:
        """Takes a point cloud, rows x, y, z in metres in the frame of the sensor at ``pose`` in the map.

        Points that are not finite or nearer than ``min_range_m`` are ignored; points farther than ``max_range_m`` only
        show that the way is free up to it (0: the limit of the daemon). Returns its number.
        """
        points = np.ascontiguousarray(xyz_m, dtype=np.float32)
        return self._native.send_cloud(self._nanos(time), pose, points, min_range_m, max_range_m, frame_id)

    def send_grid(self, time: Time, grid: npt.ArrayLike, *, first_cell: tuple[int, int, int] = (0, 0, 0)) -> int:
        """Takes a grid that was seen: axes y, x or z, y, x of integers, -1 not seen, 0 free, 1 and more occupied.

        ``first_cell`` is the index x, y, z of its first cell. The map remembers the size of the grid. Returns its
        number.
        """
        cells = _seen(grid, (2, 3), "y, x or z, y, x")
        layers = cells[np.newaxis] if cells.ndim == 2 else cells
        return self._native.send_grid(self._nanos(time), layers, first_cell)

    def send_traversal(
        self,
        from_node: str,
        to_node: str,
        start: Time,
        end: Time,
        success: bool,
        *,
        action: str = "",
        reason: str = "",
    ) -> int:
        """Takes a traversal of an edge, or the attempt at it, and returns its number."""
        return self._native.send_traversal(
            (from_node, to_node, action, self._nanos(start), self._nanos(end), bool(success), reason)
        )

    @property
    def progress(self) -> Progress:
        """The progress of the producer."""
        found: dict[str, Any] = self._native.progress()
        return Progress(**found)

    def take_refusals(self) -> list[Refusal]:
        """The observations that the daemon refused since the last call, at most 65,536."""
        return [Refusal(*row) for row in self._native.take_refusals()]

    def _nanos(self, time: Time) -> int:
        return int(_times.resolve(_times.read(time), self._zone, self._zone_of_map)[0])

    def flush(self) -> int:
        """Waits until everything that was taken is durable, and returns the number of the last."""
        return self._native.flush()

    def close(self) -> None:
        """Waits until everything is durable, and ends."""
        self._native.close()

    def abandon(self) -> None:
        """Ends at once; observations that are not durable may or may not become durable."""
        self._native.abandon()

    def __reduce__(self) -> Any:
        raise pickle.PicklingError(
            "a producer is not pickled: its observations are numbered in this process. Pickle the client, and open a "
            "producer with a label of its own in each process"
        )

    def __enter__(self) -> Producer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _seen(grid: npt.ArrayLike, axes: tuple[int, ...], names: str) -> npt.NDArray[np.int8]:
    """A grid that was seen: -1 not seen, 0 free, 1 occupied."""
    cells = np.asarray(grid)
    if cells.dtype.kind not in "iub" or cells.ndim not in axes:
        raise InvalidArgument(
            f"a grid of {cells.dtype} with {cells.ndim} axes: use integers, with the axes {names}", "INVALID_ARGUMENT"
        )
    signs = cells if cells.dtype == np.int8 else np.sign(cells.astype(np.int64))
    return np.ascontiguousarray(signs, dtype=np.int8)


@dataclass(frozen=True)
class QueueState:
    """The counts of a queue since it was opened, unless stated otherwise."""

    connected: bool
    """Whether the daemon can be reached now."""
    error: str | None
    """Why nothing is sent now; all is kept."""
    last: int
    """Number of the last observation that was taken, ever."""
    waiting: int
    """Observations in the queue that the daemon does not have, also of earlier runs."""
    oldest_waiting_nanos: int | None
    """Time of the oldest of them, nanoseconds since 1970 UTC."""
    bytes: int
    """Bytes of the files; observations that the daemon has leave them together with their neighbours."""
    bytes_max: int
    durable: int
    """Observations that the daemon has on its disk, or has refused."""
    refused: int
    """Observations that the daemon refused."""
    refused_by_reason: dict[str, int] = field(default_factory=dict)
    last_refusal: str = ""
    """The last refusal in words."""
    unreported: int = 0
    """Observations that became durable while the connection broke, so that refusals of them are unknown."""
    unsendable: int = 0
    """Observations that cannot be sent; the daemon counts a refusal in the place of each."""
    last_unsendable: str = ""
    """Why the last of them cannot be sent."""
    not_taken: int = 0
    """Observations that the queue did not take because it was full, or because the disk failed."""
    lost: int = 0
    """Observations that the daemon had and no longer has, ever: a backup was restored."""
    cut_bytes: int = 0
    """Bytes of an observation that was not written whole when the program or the machine stopped."""
    resolution_m: float | None = None
    """Edge of the cells of the map; ``None`` before the daemon was reached, or if the map has no grid."""
    origin_m: tuple[float, float, float] | None = None
    """Lower corner of cell 0, 0, 0 in the map."""


class QueuedProducer(Producer):
    """Takes observations into files of this machine, and sends them in the background, each exactly once.

    The daemon does not have to be reachable: observations wait in the files, and are sent later, in order, also by the
    next run of this program. When a call returns, its observation is in the files; it survives the end of this program
    at once, and a power cut after ``sync()``, which is also done each second. If the queue is full, ``send`` raises
    :class:`tidemap.ResourceExhausted`, and the observation is not taken. Use it as a context manager; at the end it
    does not wait for the daemon. ``flush()`` waits.
    """

    def __init__(
        self, native: NativeQueue, zone: str | None, zone_of_map: Callable[[], str], reports: str = "samples"
    ) -> None:
        super().__init__(native, zone, zone_of_map, reports)
        self._queue = native

    def send_occupancy(self, time: Time, pose: Pose, grid: npt.ArrayLike, *, resolution_m: float) -> int:
        """Takes a grid with a resolution of its own, whose lower corner is at ``pose`` in the map, such as an
        ``OccupancyGrid`` of ROS: axes y, x of integers, -1 not seen, 0 free, 1 and more occupied.

        It becomes cells of the map when the daemon has been reached. Returns its number.
        """
        return self._queue.send_occupancy(self._nanos(time), pose, resolution_m, _seen(grid, (2,), "y, x"))

    @property
    def state(self) -> QueueState:
        """The counts now."""
        return QueueState(**self._queue.state())

    def retry_now(self) -> None:
        """Tries to reach the daemon now, without the pause after a failure."""
        self._queue.retry_now()

    def sync(self) -> None:
        """Forces everything that was taken to the disk: it survives a power cut from here on."""
        self._queue.sync()

    def flush(self, patience_secs: float | None = None) -> int:
        """Waits until the daemon has everything that was taken, and returns the number of the last.

        After ``patience_secs`` it raises :class:`tidemap.Unavailable`; everything is kept, and still sent.
        """
        return self._queue.flush(patience_secs)

    def close(self) -> None:
        """Ends sending, and forces everything to the disk; what waits is sent by the next run."""
        self._queue.close()

    def abandon(self) -> None:
        """Does the same as :meth:`close`."""
        self._queue.close()
