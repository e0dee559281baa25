"""Times as people have them, as nanoseconds UTC.

One rule everywhere: integers are nanoseconds since 1970 UTC, floats are seconds since 1970 UTC, and a time that has no
zone (``datetime64``, a ``datetime`` without ``tzinfo``, a text without an offset) needs a zone from the user: the zone
of the map (``"local"``), or another one by name, such as ``"UTC"``.

Invariant: nothing passes through floating point but floats themselves, and no time without a zone is taken for UTC
unless the map is in UTC or the user states it.
"""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from tidemap._native import zone_offsets
from tidemap.errors import InvalidArgument

Time = Union[int, float, np.datetime64, dt.datetime, dt.date, str]
Nanos = npt.NDArray[np.int64]

SECOND = 1_000_000_000
FIRST = 0
"""The first time of the wire, 1970."""
LAST = 9_214_646_400 * SECOND
"""The last whole year that the wire has, 2262."""

_EPOCH = dt.datetime(1970, 1, 1)
_MICROSECOND = dt.timedelta(microseconds=1)
_DAY = 86_400 * SECOND
# Integers of nanoseconds below this are all of the first four months of 1970: probably another unit.
_NANOS_LEAST = 10**16
_TEXT = re.compile(
    r"(\d{4}-\d\d-\d\d)(?:[Tt ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9})\d*)?)? ?([Zz]|[+-]\d\d:?\d\d|[+-]\d\d)?"
)
_UTC_NAMES = {"utc", "etc/utc", "gmt", "etc/gmt", "zulu", "etc/zulu", "uct", "etc/uct", "universal", "etc/universal"}
_HOW = "the argument must be datetime64, datetime, an ISO 8601 string, whole nanoseconds, or seconds as a float number"


@dataclass(frozen=True)
class Read:
    """Times as they were given."""

    nanos: Nanos
    """UTC, or the reading of a wall clock where ``local`` is set."""
    local: npt.NDArray[np.bool_] | None
    """Whether each time has no zone; ``None``: all have one."""


def is_utc(zone: str) -> bool:
    """Whether a zone is UTC by another name."""
    return zone.lower() in _UTC_NAMES


def _parsed(text: str) -> tuple[int, bool]:
    """Nanoseconds of a text, and whether it has no zone."""
    found = _TEXT.fullmatch(text.strip())
    try:
        if found is None:
            raise ValueError("form")
        date, clock, fraction, offset = found.groups()
        whole = (dt.datetime.fromisoformat(f"{date}T{clock or '00:00'}") - _EPOCH) // _MICROSECOND * 1_000
        nanos = whole + int((fraction or "").ljust(9, "0"))
        if offset is None or offset in "Zz":
            return nanos, offset is None
        digits = offset[1:].replace(":", "").ljust(4, "0")
        hours, minutes = int(digits[:2]), int(digits[2:])
        if hours > 23 or minutes > 59:
            raise ValueError("offset")
        seconds = (hours * 60 + minutes) * 60
        return nanos - (seconds if offset[0] == "+" else -seconds) * SECOND, False
    except ValueError as error:
        raise InvalidArgument(
            f"{text!r} is not a time: write it as 2026-01-05T13:00:00Z", "INVALID_ARGUMENT"
        ) from error


def _one(time: Any) -> tuple[int, bool]:
    """Nanoseconds of one time, and whether it has no zone."""
    if isinstance(time, str):
        return _parsed(time)
    if isinstance(time, dt.datetime):
        offset = time.utcoffset()
        plain = time.replace(tzinfo=None)
        # A pandas.Timestamp has nanoseconds, too.
        nanos = (dt.datetime(*plain.timetuple()[:6], plain.microsecond) - _EPOCH) // _MICROSECOND * 1_000
        nanos += int(getattr(time, "nanosecond", 0))
        return (nanos, True) if offset is None else (nanos - offset // _MICROSECOND * 1_000, False)
    if isinstance(time, dt.date):
        return (dt.datetime(time.year, time.month, time.day) - _EPOCH) // _MICROSECOND * 1_000, True
    if isinstance(time, np.datetime64):
        return int(_of_datetimes(np.asarray(time).reshape(1))[0]), True
    if isinstance(time, (bool, np.bool_)) or not isinstance(time, (int, float, np.integer, np.floating)):
        raise TypeError(f"{time!r} is not a time: {_HOW}")
    return int(_of_numbers(np.asarray([time]))[0]), False


def _of_datetimes(array: npt.NDArray[Any]) -> Nanos:
    if np.isnat(array).any():
        raise InvalidArgument(f"row {int(np.argmax(np.isnat(array)))} has no time (NaT)", "INVALID_ARGUMENT")
    # Beyond the range of nanoseconds, numpy wraps around without a word.
    if array.size and (array.min() < np.datetime64("1900") or array.max() > np.datetime64("2262-01-01")):
        wrong = array.min() if array.min() < np.datetime64("1900") else array.max()
        raise InvalidArgument(f"{wrong} is not between 1970 and 2262", "INVALID_ARGUMENT")
    nanos: Nanos = np.ascontiguousarray(array.astype("datetime64[ns]").astype(np.int64))
    return nanos


def _of_numbers(array: npt.NDArray[Any]) -> Nanos:
    """Integers of nanoseconds, or floats of seconds."""
    if array.dtype.kind in "iu":
        if array.dtype.kind == "u" and array.size and array.max() > LAST:
            raise InvalidArgument(f"{array.max()} nanoseconds is after 2262", "INVALID_ARGUMENT")
        whole: Nanos = array.astype(np.int64)
        greatest = int(np.abs(whole).max()) if whole.size else 0
        if 0 < greatest < _NANOS_LEAST:
            unit = next(
                (unit for limit, unit in ((10**11, "s"), (10**14, "ms")) if greatest < limit), "us"
            )
            raise InvalidArgument(
                f"{greatest} is ambiguous: integers are nanoseconds since 1970, and this would be "
                f"{np.datetime64(greatest, 'ns')}. If the unit is {unit}, write pd.to_datetime(times, unit=\"{unit}\", "
                f"utc=True), or np.asarray(times).astype('datetime64[{unit}]') with zone=\"UTC\"; seconds may also be "
                "floats",
                "INVALID_ARGUMENT",
            )
        return whole
    seconds = array.astype(np.float64)
    if not np.isfinite(seconds).all():
        row = int(np.argmax(~np.isfinite(seconds)))
        raise InvalidArgument(f"row {row} has no time: times must be finite, not NaN or infinity", "INVALID_ARGUMENT")
    greatest_secs = float(np.abs(seconds).max()) if seconds.size else 0.0
    if greatest_secs > LAST / SECOND:
        raise InvalidArgument(
            f"{greatest_secs:g} is not a time: floats are seconds since 1970, and this is after 2262; for another unit "
            "write pd.to_datetime(times, unit=\"ms\", utc=True)",
            "INVALID_ARGUMENT",
        )
    floor = np.floor(seconds)
    nanos: Nanos = floor.astype(np.int64) * SECOND + np.rint((seconds - floor) * 1e9).astype(np.int64)
    return nanos


def read(times: Any) -> Read:
    """Times in any form, in the order given; one time gives one."""
    if isinstance(times, (int, float, str, dt.date, np.datetime64, np.integer, np.floating)):
        nanos, local = _one(times)
        return Read(np.array([nanos], dtype=np.int64), np.array([True]) if local else None)
    # Series of pandas and polars, and DatetimeIndex, with their zone.
    if hasattr(times, "dt") and getattr(times.dt, "tz", None) is not None:
        times, zoned = times.dt.tz_convert("UTC").dt.tz_localize(None), True
    elif getattr(times, "tz", None) is not None:
        times, zoned = times.tz_convert("UTC").tz_localize(None), True
    else:
        zoned = getattr(getattr(times, "dtype", None), "time_zone", None) is not None
    array = np.asarray(times) if not isinstance(times, Iterable) or hasattr(times, "__array__") else _listed(times)
    array = array.ravel()
    if array.dtype.kind == "M":
        nanos_all = _of_datetimes(array)
        return Read(nanos_all, None if zoned else np.ones(len(nanos_all), dtype=np.bool_))
    if array.dtype.kind in "iuf":
        return Read(np.ascontiguousarray(_of_numbers(array)), None)
    if array.dtype.kind in "OUT":
        return _each(array)
    raise TypeError(f"{array.dtype} is not a type of times: {_HOW}")


def _listed(times: Iterable[Any]) -> npt.NDArray[Any]:
    listed = list(times)
    if any(isinstance(time, (str, dt.date)) for time in listed):
        array = np.empty(len(listed), dtype=object)
        array[:] = listed
        return array
    return np.asarray(listed, dtype=None if listed else np.int64)


def _each(array: npt.NDArray[Any]) -> Read:
    listed = array.tolist()
    if any(isinstance(time, (int, float)) for time in listed):
        if all(isinstance(time, (int, float)) and not isinstance(time, bool) for time in listed):
            whole = all(isinstance(time, int) for time in listed)
            return Read(_of_numbers(np.array(listed, dtype=np.int64 if whole else np.float64)), None)
    nanos = np.empty(len(listed), dtype=np.int64)
    local = np.zeros(len(listed), dtype=np.bool_)
    for row, time in enumerate(listed):
        try:
            nanos[row], local[row] = _one(time)
        except TypeError as error:
            raise TypeError(f"row {row}: {error}") from error
        except ValueError as error:
            raise InvalidArgument(f"row {row}: {error}", "INVALID_ARGUMENT") from error
    return Read(nanos, local if local.any() else None)


def resolve(
    given: Read,
    zone: str | None,
    zone_of_map: Callable[[], str],
    states: npt.NDArray[np.uint32] | None = None,
    source: npt.NDArray[np.intp] | None = None,
) -> Nanos:
    """Nanoseconds UTC of times.

    ``zone`` is the zone of times that have none: ``"local"`` for the zone of the map, or a name. ``None``: such times
    are refused, unless the map is in UTC. ``states`` has the states of the rows, for the hour that exists twice, and
    ``source`` their numbers in errors.
    """
    if given.local is None or not given.local.any():
        return given.nanos
    if zone is None:
        name = zone_of_map()
        if not is_utc(name):
            raise InvalidArgument(
                f"the times have no zone, and the map is in {name}: set zone=\"local\" if they are in the zone of the "
                "map, zone=\"UTC\" or another name if they are not, or give them a zone",
                "INVALID_ARGUMENT",
            )
    else:
        name = zone_of_map() if zone == "local" else zone
    nanos = given.nanos.copy()
    rows = np.flatnonzero(given.local)
    nanos[given.local] = from_clock(
        given.nanos[given.local], name, None if states is None else states[given.local],
        rows if source is None else source[rows],
    )
    return nanos


def from_clock(
    local: Nanos, zone: str, states: npt.NDArray[np.uint32] | None = None, rows: npt.NDArray[np.intp] | None = None
) -> Nanos:
    """The readings of a wall clock of a zone, as UTC.

    An hour that exists twice follows the order of the rows. A time that does not exist is refused.
    """
    # Offsets change at most once within a day before and after.
    before, after = (zone_offsets(zone, local + shift) * SECOND for shift in (-_DAY, _DAY))
    first, second = local - np.maximum(before, after), local - np.minimum(before, after)
    good_first = zone_offsets(zone, first) * SECOND == local - first
    good_second = zone_offsets(zone, second) * SECOND == local - second
    missing = ~good_first & ~good_second
    if missing.any():
        row = int(np.argmax(missing))
        number = row if rows is None else int(rows[row])
        raise InvalidArgument(
            f"row {number}: {_shown(int(local[row]))} does not exist in {zone}, where the clocks go forward then. Are "
            "the times in another zone (zone=\"UTC\")?",
            "INVALID_ARGUMENT",
        )
    found: Nanos = np.where(good_first, first, second)
    twice = np.flatnonzero(good_first & good_second & (first != second))
    # Rows of one such hour that follow each other; no clock goes back at noon.
    noons = (local[twice] - _DAY // 2) // _DAY
    for run in np.split(twice, np.flatnonzero((np.diff(twice) > 1) | (np.diff(noons) != 0)) + 1):
        if len(run):
            late = run[_in_second_hour(local[run], second[run] - first[run], None if states is None else states[run])]
            found[late] = second[late]
    return found


def _in_second_hour(
    local: Nanos, hour: Nanos, states: npt.NDArray[np.uint32] | None
) -> npt.NDArray[np.bool_]:
    """The rows of an hour that exists twice that belong to the second one.

    The second hour begins where the clock goes back by half of the repeated hour or more; else, for each state, where
    its clock goes back most, or stands still. If the clock of a state never does this, its rows belong to the second
    hour after the first such row of another state.
    """
    rows = np.arange(len(local))
    steps = np.diff(local)
    if len(steps) and steps.min() <= -hour[0] // 2:
        return np.asarray(rows > int(np.argmin(steps)), dtype=np.bool_)
    found = np.zeros(len(local), dtype=np.bool_)
    numbers = np.zeros(len(local), dtype=np.uint32) if states is None else states
    begins, open_ended = len(local), []
    for state in np.unique(numbers):
        own = rows[numbers == state]
        steps = np.diff(local[own])
        if len(steps) and steps.min() <= 0:
            begin = int(own[int(np.argmin(steps)) + 1])
            found[own[own >= begin]] = True
            begins = min(begins, begin)
        else:
            open_ended.append(own)
    for own in open_ended:
        found[own[own > begins]] = True
    return found


def to_clock(times: Nanos, zone: str) -> npt.NDArray[np.datetime64]:
    """The readings of a wall clock of a zone, as datetime64 without a zone."""
    return datetimes(times + zone_offsets(zone, np.ascontiguousarray(times)) * SECOND)


def _shown(nanos: int) -> str:
    return str(np.datetime64(nanos, "ns").astype("datetime64[s]"))


def timestamp(nanos: int) -> str:
    """Nanoseconds UTC as a Timestamp of JSON, with all its digits."""
    seconds, rest = divmod(nanos, SECOND)
    text = (_EPOCH + dt.timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{text}.{rest:09d}Z" if rest else f"{text}Z"


def from_timestamp(text: str) -> int:
    """A Timestamp of JSON as nanoseconds UTC."""
    return _parsed(text)[0]


def datetimes(times: Nanos) -> npt.NDArray[np.datetime64]:
    """Nanoseconds UTC as datetime64."""
    return times.astype("datetime64[ns]")
