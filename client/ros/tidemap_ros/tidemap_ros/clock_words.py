"""Times as people write them in parameters and requests, and as the package ``tidemap`` takes them.

Invariant: a time is nanoseconds since 1970 UTC; nothing here reads a clock.
"""

from __future__ import annotations

import re
from datetime import datetime, timezone
from typing import Union

import numpy as np

_UNITS = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86_400.0, "w": 604_800.0}
_OFFSET = re.compile(r"([+-])\s*(\d+(?:\.\d+)?)\s*(s|m|min|h|d|w)")
_EARLIEST = datetime(1970, 1, 1, tzinfo=timezone.utc)


# The package refuses smaller integers as ambiguous: they could be seconds.
_PLAIN_FROM = 10**16


class BadTime(ValueError):
    """Words that are no time."""


def nanos(words: str, now_nanos: int) -> int:
    """The time of ``now``, of ``+2h`` or ``-1d`` from now, or of ``2026-01-05T12:00:00Z``."""
    text = words.strip()
    offset = text.removeprefix("now").strip()
    if not offset:
        return now_nanos
    match = _OFFSET.fullmatch(offset)
    if match:
        seconds = float(match[2]) * _UNITS[match[3]] * (-1 if match[1] == "-" else 1)
        return _checked(now_nanos + int(seconds * 1e9), words)
    try:
        moment = datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", text))
    except ValueError:
        raise BadTime(
            f"{words!r} is no time: write now, +2h, -1d (units s, min, h, d, w) or 2026-01-05T12:00:00Z"
        ) from None
    if moment.tzinfo is None:
        raise BadTime(f"{words!r} has no zone: write {text}Z for UTC, or {text}+01:00")
    since = moment - _EARLIEST
    return _checked(((since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds) * 1000, words)


def needs_now(words: str) -> bool:
    """Whether the time of these words depends on the present time."""
    text = words.strip()
    return not text or text.startswith(("now", "+", "-"))


def stated(time_nanos: int) -> Union[int, str]:
    """A time for the package ``tidemap``, to the nanosecond. A simulated clock begins at 0, so a small time is written
    in words.
    """
    if time_nanos == 0 or abs(time_nanos) >= _PLAIN_FROM:
        return time_nanos
    return f"{np.datetime64(time_nanos, 'ns')}Z"


def _checked(found: int, words: str) -> int:
    if not 0 <= found < 2**63:
        raise BadTime(f"{words!r} is before 1970 or after 2262")
    return found
