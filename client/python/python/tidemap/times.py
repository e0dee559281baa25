"""Times as people have them, as nanoseconds UTC.

Invariant: a time without a zone is UTC; nothing passes through floating point but floats themselves.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable
from typing import Any, Union

import numpy as np
import numpy.typing as npt

Time = Union[int, np.datetime64, dt.datetime, str]
Nanos = npt.NDArray[np.int64]

_EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.timezone.utc)
_MICROSECOND = dt.timedelta(microseconds=1)


def nanos(time: Time) -> int:
    """One time as nanoseconds UTC."""
    if isinstance(time, (bool, float)):
        raise TypeError(f"{time!r} is not a time: use datetime64, datetime, an ISO 8601 text, or integer nanoseconds")
    if isinstance(time, (int, np.integer)):
        return int(time)
    if isinstance(time, str):
        return nanos(_parsed(time))
    if isinstance(time, dt.datetime):
        aware = time if time.tzinfo else time.replace(tzinfo=dt.timezone.utc)
        whole = (aware - _EPOCH) // _MICROSECOND * 1_000
        # A pandas.Timestamp has nanoseconds, too.
        return whole + int(getattr(time, "nanosecond", 0))
    if isinstance(time, np.datetime64):
        if np.isnat(time):
            raise ValueError("NaT is not a time")
        return int(time.astype("datetime64[ns]").astype(np.int64))
    raise TypeError(f"{time!r} is not a time: use datetime64, datetime, an ISO 8601 text, or integer nanoseconds")


def _parsed(text: str) -> dt.datetime:
    try:
        # Python 3.10 does not read the Z.
        return dt.datetime.fromisoformat(text[:-1] + "+00:00" if text.endswith(("Z", "z")) else text)
    except ValueError as error:
        raise ValueError(f"{text!r} is not a time: write it as 2026-01-05T13:00:00Z") from error


def all_nanos(times: Any) -> Nanos:
    """Times as an array of nanoseconds UTC; one time gives an array of one."""
    if isinstance(times, (int, str, dt.datetime, np.datetime64)) and not isinstance(times, bool):
        return np.array([nanos(times)], dtype=np.int64)
    # Series of pandas and polars, and DatetimeIndex, with their zone.
    if hasattr(times, "dt") and hasattr(times.dt, "tz") and times.dt.tz is not None:
        times = times.dt.tz_convert("UTC").dt.tz_localize(None)
    elif getattr(times, "tz", None) is not None:
        times = times.tz_convert("UTC").tz_localize(None)
    array = np.asarray(times) if not isinstance(times, Iterable) or hasattr(times, "__array__") else _listed(times)
    if array.dtype.kind == "M":
        if np.isnat(array).any():
            raise ValueError("NaT is not a time")
        return np.ascontiguousarray(array.astype("datetime64[ns]").astype(np.int64).ravel())
    if array.dtype.kind in "iu":
        return np.ascontiguousarray(array.astype(np.int64).ravel())
    if array.dtype.kind in "OU":
        return np.array([nanos(time) for time in array.ravel().tolist()], dtype=np.int64)
    raise TypeError(
        f"times of type {array.dtype}: use datetime64, datetime, ISO 8601 texts, or integer nanoseconds"
    )


def _listed(times: Iterable[Any]) -> npt.NDArray[Any]:
    listed = list(times)
    if any(isinstance(time, (str, dt.datetime)) for time in listed):
        return np.array([nanos(time) for time in listed], dtype=np.int64)
    return np.asarray(listed, dtype=None if listed else np.int64)


def timestamp(time: Time) -> str:
    """One time as a Timestamp of JSON, with all its nanoseconds."""
    seconds, rest = divmod(nanos(time), 1_000_000_000)
    text = (_EPOCH + dt.timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{text}.{rest:09d}Z" if rest else f"{text}Z"


def datetimes(times: Nanos) -> npt.NDArray[np.datetime64]:
    """Nanoseconds UTC as datetime64."""
    return times.astype("datetime64[ns]")
