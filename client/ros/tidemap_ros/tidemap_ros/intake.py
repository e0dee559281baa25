"""Converts messages to records, once their transform is known.

This module does not use rclpy: messages are read by the names of their fields, and the node calls these methods.

Invariant: every message that arrives is counted exactly once: as taken, waiting for a transform, left out for a reason
that diagnostics shows, or thinned out by a parameter.
"""

from __future__ import annotations

import json
import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import tidemap
from tidemap import frames
from tidemap_ros import arrays, clock_words, poses, records
from tidemap_ros.parameters import Settings
from tidemap_ros.poses import BadPose, Pose
from tidemap_ros.records import MapGrid
from tidemap_ros.transforms import NotYet, NoTransform, Transforms

WAITING_MAX = 256
"""Most observations that wait for a transform."""
REASONS_KEPT = 20
TEXT_BYTES_MAX = 65_536
DOOR_CLOSED, DOOR_OPEN = 0, 2
"""The modes of ``rmf_door_msgs/DoorMode`` that are readings: closed and open; moving, offline and unknown are none."""


@dataclass
class Counts:
    """The counts of messages."""

    taken: int = 0
    thinned: int = 0
    left_out: int = 0
    reasons: dict[str, int] = field(default_factory=dict)
    never_arrived: int = 0
    """Messages that ROS reports as lost before the node had them."""
    spool_refused: int = 0
    """Observations that the queue did not take, because it was full or the disk failed: lost."""
    last_problem: str = ""


@dataclass
class _Waiting:
    until: float
    frame_id: str
    stamp_nanos: int
    made: Callable[[Pose], records.Record | None]


def stamp_nanos(stamp: Any) -> int:
    """A time of ``builtin_interfaces``, or of ROS 1, in nanoseconds."""
    if hasattr(stamp, "secs"):
        return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Intake:
    """Takes messages into the queue by ``put``. ``clock`` gives ROS time in nanoseconds, ``monotonic`` seconds."""

    def __init__(
        self,
        settings: Settings,
        put: Callable[[records.Record], object],
        transforms: Transforms,
        clock: Callable[[], int],
        monotonic: Callable[[], float],
        log: Callable[[str], object],
    ) -> None:
        self._settings = settings
        self._put = put
        self._transforms = transforms
        self._clock = clock
        self._monotonic = monotonic
        self._log = log
        self.grid_of_map: Callable[[], MapGrid | None] = lambda: None
        """The grid of the map, once the daemon has sent it."""
        self._lock = threading.RLock()
        self._counts = Counts()
        self._waiting: deque[_Waiting] = deque()
        self._taken_at: dict[str, int] = {}
        self._doors: dict[str, tuple[int, float]] = {}

    @property
    def counts(self) -> Counts:
        """The counts of messages until now."""
        with self._lock:
            copied = Counts(**vars(self._counts))
            copied.reasons = dict(self._counts.reasons)
            return copied

    @property
    def waiting(self) -> int:
        """Observations that wait for a transform."""
        return len(self._waiting)

    # Messages

    def transform(self, message: Any, is_static: bool) -> None:
        """A ``geometry_msgs/TransformStamped``."""
        with self._lock:
            try:
                found = poses.from_message(message.transform.translation, message.transform.rotation)
                stamp = stamp_nanos(message.header.stamp)
                frame = message.header.frame_id
                self._transforms.add(frame, message.child_frame_id, stamp, found, is_static=is_static)
            except (BadPose, NoTransform) as error:
                self._left_out("transform", str(error))

    def scan(self, topic: str, message: Any) -> None:
        """A ``sensor_msgs/LaserScan``."""
        settings = self._settings
        stamp = self._stamp(message)
        if not self._is_due(topic, stamp, settings.number("scan_period")):
            return
        try:
            ranges = arrays.ranges(message)
        except arrays.BadMessage as error:
            return self._left_out("malformed", str(error))
        low = max(settings.number("min_range"), _finite(message.range_min, 0.0))
        trusted = settings.number("max_range")
        high = _finite(message.range_max, 0.0)
        if high <= 0:
            high = trusted
        if high <= 0:
            return self._left_out("malformed", f"a scan of {topic} without range_max: set the parameter max_range")
        angles = float(message.angle_min), float(message.angle_increment)
        self._placed(message, stamp, lambda pose: records.Ranges(
            stamp, pose, settings.text("map_frame"), *angles, low, high, settings.number("free_range"), trusted, ranges
        ))

    def cloud(self, topic: str, message: Any) -> None:
        """A ``sensor_msgs/PointCloud2``."""
        settings = self._settings
        stamp = self._stamp(message)
        if not self._is_due(topic, stamp, settings.number("cloud_period")):
            return
        try:
            points = arrays.points(message)
        except arrays.BadMessage as error:
            return self._left_out("malformed", str(error))
        heights = settings.number("cloud_min_height"), settings.number("cloud_max_height")
        whole = heights[0] <= -1e9 and heights[1] >= 1e9

        def made(pose: Pose) -> records.Record | None:
            kept = points if whole else arrays.between_heights(points, pose, *heights)
            kept = self._thinned(kept, pose)
            if len(kept) == 0:
                self._left_out("empty", f"a cloud of {topic} without a point that counts")
                return None
            low, high = settings.number("min_range"), settings.number("max_range")
            return records.Cloud(stamp, pose, settings.text("map_frame"), low, high, kept)

        self._placed(message, stamp, made)

    def _thinned(self, points: arrays.Points, pose: Pose) -> arrays.Points:
        """One point for each cell of the map, or as the parameter ``cloud_cell`` states."""
        edge, grid = self._settings.number("cloud_cell"), self.grid_of_map()
        if edge < 0 or (edge == 0 and grid is None):
            return points
        origin = (0.0, 0.0, 0.0) if grid is None else grid.origin_m
        return arrays.one_in_each_cell(points, pose, edge or (grid.resolution_m if grid is not None else edge), origin)

    def grid(self, topic: str, message: Any) -> None:
        """A ``nav_msgs/OccupancyGrid``."""
        stamp = self._stamp(message)
        if not self._is_due(topic, stamp, self._settings.number("grid_period")):
            return
        try:
            cells = arrays.seen_cells(message)
            corner = poses.from_message(message.info.origin.position, message.info.origin.orientation)
        except (arrays.BadMessage, BadPose) as error:
            return self._left_out("malformed", str(error))
        resolution = float(message.info.resolution)
        self._placed(message, stamp, lambda pose: records.Picture(
            stamp, poses.product(pose, corner), resolution, cells
        ))

    def observe(self, text: str) -> None:
        """A value as JSON: ``{"state": "door", "value": "open", "stamp": 1767614400.5}``."""
        try:
            fields = _object(text, ("state", "value"), ("stamp",))
            state = _text(fields, "state")
            if "/" in state or not state or len(state) > 128:
                raise arrays.BadMessage(f"the name {state!r}: 1 to 128 letters, without /")
            value = _number(fields["value"])
            nanos = self._moment(fields.get("stamp"))
        except (arrays.BadMessage, clock_words.BadTime) as error:
            return self._left_out("malformed", f"observe: {error}")
        self.take(records.Value(state, nanos, value))

    def traverse(self, text: str) -> None:
        """A traversal as JSON: ``from``, ``to``, ``start``, ``end``, ``success`` and perhaps ``action``, ``reason``."""
        try:
            fields = _object(text, ("from", "to", "start", "end", "success"), ("action", "reason"))
            if not isinstance(fields["success"], bool):
                raise arrays.BadMessage(f"success is {fields['success']!r}: true or false")
            names = [_text(fields, name) if name in fields else "" for name in ("from", "to", "action", "reason")]
            start, end = self._moment(fields["start"]), self._moment(fields["end"])
            traversal = records.Traversal(names[0], names[1], start, end, fields["success"], names[2], names[3])
        except (arrays.BadMessage, clock_words.BadTime) as error:
            return self._left_out("malformed", f"traverse: {error}")
        self.traversal(traversal)

    def traversal(self, traversal: records.Traversal) -> None:
        """An edge that was driven, or tried."""
        if not traversal.from_node or not traversal.to_node:
            return self._left_out("malformed", "a traversal without the names of its nodes")
        if traversal.end_nanos < traversal.start_nanos:
            return self._left_out("malformed", "a traversal that ends before it starts")
        self.take(traversal)

    def door(self, message: Any) -> None:
        """An ``rmf_door_msgs/DoorState``: 1 is open, 0 closed."""
        mode = int(message.current_mode.value)
        name = str(message.door_name).replace("/", "_")[:128]
        if mode not in (DOOR_CLOSED, DOOR_OPEN) or not name:
            return self._left_out("door without a reading", f"the door {name!r} is in mode {mode}")
        stamp = stamp_nanos(message.door_time) or self._clock()
        with self._lock:
            last_mode, last_nanos = self._doors.get(name, (None, 0.0))
            if last_mode == mode and 0 <= stamp - last_nanos < self._settings.number("door_period") * 1e9:
                self._counts.thinned += 1
                return
            self._doors[name] = (mode, stamp)
        self.take(records.Value(name, stamp, float(mode == DOOR_OPEN)))

    def never_arrived(self, count: int) -> None:
        """ROS has lost messages on their way."""
        with self._lock:
            if self._counts.never_arrived == 0:
                self._log(f"ROS lost {count} messages before they arrived: raise queue_depth, or set reliable")
            self._counts.never_arrived += max(count, 0)

    # Results of messages

    def retry(self) -> None:
        """Takes the messages that have their transform now; leaves out messages that waited for too long."""
        with self._lock:
            kept: deque[_Waiting] = deque()
            while self._waiting:
                one = self._waiting.popleft()
                try:
                    pose = self._lookup(one.frame_id, one.stamp_nanos)
                except NotYet as error:
                    if self._monotonic() < one.until:
                        kept.append(one)
                    else:
                        self._left_out("no transform", str(error))
                except NoTransform as error:
                    self._left_out("no transform", str(error))
                else:
                    self._made(one.made, pose)
            self._waiting = kept

    def _placed(self, message: Any, stamp: int, made: Callable[[Pose], records.Record | None]) -> None:
        frame = str(message.header.frame_id)
        with self._lock:
            try:
                pose = self._lookup(frame, stamp)
            except NotYet as error:
                if self._settings.number("tf_wait") <= 0 or len(self._waiting) >= WAITING_MAX:
                    return self._left_out("no transform", str(error))
                until = self._monotonic() + self._settings.number("tf_wait")
                self._waiting.append(_Waiting(until, frame, stamp, made))
            except NoTransform as error:
                self._left_out("no transform", str(error))
            else:
                self._made(made, pose)

    def _lookup(self, frame: str, stamp: int) -> Pose:
        return self._transforms.lookup(self._settings.text("map_frame"), frame, stamp)

    def _made(self, made: Callable[[Pose], records.Record | None], pose: Pose) -> None:
        record = made(pose)
        if record is not None:
            self.take(record)

    def take(self, record: records.Record) -> None:
        """Takes a record into the queue."""
        nanos = records.time_of(record)
        if nanos == 0:
            return self._left_out("no time", "an observation without a stamp, while nothing has come on /clock")
        if not 0 <= nanos < 2**63:
            return self._left_out("malformed", f"the time {nanos} ns is before 1970 or after 2262")
        try:
            self._put(record)
        except tidemap.InvalidArgument as error:
            return self._left_out("malformed", str(error))
        except (tidemap.TidemapError, OSError) as error:
            with self._lock:
                if self._counts.spool_refused == 0:
                    self._log(f"an observation is lost: {error}")
                self._counts.spool_refused += 1
                self._counts.last_problem = str(error)
            return
        with self._lock:
            self._counts.taken += 1

    def _left_out(self, reason: str, detail: str) -> None:
        with self._lock:
            counts = self._counts
            counts.left_out += 1
            if reason not in counts.reasons and len(counts.reasons) < REASONS_KEPT:
                self._log(f"left out ({reason}): {detail}")
            if reason in counts.reasons or len(counts.reasons) < REASONS_KEPT:
                counts.reasons[reason] = counts.reasons.get(reason, 0) + 1
            counts.last_problem = detail

    # Times

    def _stamp(self, message: Any) -> int:
        return stamp_nanos(message.header.stamp) or self._clock()

    def _is_due(self, topic: str, stamp: int, period_secs: float) -> bool:
        """Whether a message of a topic is taken, and not thinned out."""
        with self._lock:
            last = self._taken_at.get(topic)
            # A time that jumped back, as with a bag that is played again, begins anew.
            if last is not None and period_secs > 0 and 0 <= stamp - last < period_secs * 1e9:
                self._counts.thinned += 1
                return False
            self._taken_at[topic] = stamp
            return True

    def _moment(self, stamp: Any) -> int:
        """The time of a JSON message: seconds since 1970, a text such as 2026-01-05T12:00:00Z, or nothing for now."""
        if stamp is None:
            return self._clock()
        if isinstance(stamp, str):
            return clock_words.nanos(stamp, self._clock())
        if isinstance(stamp, dict) and set(stamp) <= {"sec", "nanosec"}:
            sec, nanosec = stamp.get("sec", 0), stamp.get("nanosec", 0)
            if isinstance(sec, int) and isinstance(nanosec, int):
                return sec * 1_000_000_000 + nanosec
        if isinstance(stamp, bool) or not isinstance(stamp, (int, float)) or not math.isfinite(stamp):
            raise arrays.BadMessage(f"the stamp {stamp!r}: seconds since 1970, or a text such as 2026-01-05T12:00:00Z")
        # Whole seconds and the rest apart: a float of seconds has no nanoseconds.
        return int(stamp) * 1_000_000_000 + int(round((stamp - int(stamp)) * 1e9))


def _finite(number: float, otherwise: float) -> float:
    return float(number) if math.isfinite(number) else otherwise


def _object(text: str, needed: tuple[str, ...], known: tuple[str, ...]) -> dict[str, Any]:
    if len(text) > TEXT_BYTES_MAX:
        raise arrays.BadMessage(f"{len(text)} letters; at most {TEXT_BYTES_MAX} are read")
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise arrays.BadMessage(f"no JSON: {error}") from None
    if not isinstance(fields, dict):
        raise arrays.BadMessage("no JSON object")
    missing = [name for name in needed if name not in fields]
    if missing:
        raise arrays.BadMessage(f"{missing[0]!r} is missing")
    strange = [name for name in fields if name not in (*needed, *known)]
    if strange:
        raise arrays.BadMessage(f"{strange[0]!r} is no field; fields are {', '.join((*needed, *known))}")
    return fields


def _text(fields: dict[str, Any], name: str) -> str:
    if not isinstance(fields[name], str):
        raise arrays.BadMessage(f"{name} is {fields[name]!r}: a text")
    return str(fields[name])


def _number(value: Any) -> float:
    """A number, true or false, or a word such as open, off or home."""
    if not isinstance(value, (bool, int, float, str)):
        raise arrays.BadMessage(f"the value {value!r}: a number, true or false, or a word such as open")
    try:
        found = float(frames.numbers([value]).values[0])
    except (ValueError, OverflowError) as error:
        raise arrays.BadMessage(str(error)) from None
    if not math.isfinite(found):
        raise arrays.BadMessage(f"the value {value!r} is no measurement")
    return found
