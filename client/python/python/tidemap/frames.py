"""Rows of observations out of what people have: frames of pandas and polars, dictionaries of columns, arrays.

A long frame has a row for each observation, with the columns ``time``, ``state`` and ``value`` (or ``x``, ``y`` and
``z`` for positions). A wide frame has a row for each time and a column for each state. The time may be the index.

Invariant: rows keep their order, and every row is read, dropped with its reason counted, or named in an error. A marker
for "nothing measured" (NaN, ``None``, ``unavailable``, ``unknown``) is not a measurement.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap.errors import InvalidArgument

Floats = npt.NDArray[np.float64]

WORDS: dict[str, float] = {
    "on": 1, "off": 0, "open": 1, "opened": 1, "closed": 0, "close": 0, "true": 1, "false": 0, "yes": 1, "no": 0,
}
"""Words that are values, in any case."""
NO_VALUE = frozenset({"", "unavailable", "unknown", "none", "null", "nan", "na", "n/a"})
"""Words for "nothing measured", in any case."""
_NAMED = 5


@dataclass(frozen=True)
class Rows:
    """Observations in columns: row i is of ``names[indices[i]]``."""

    names: list[str]
    indices: npt.NDArray[np.uint32]
    times: _times.Read
    values: Floats
    positions: Floats | None
    """Coordinates in the place of the values, one row each."""
    source: npt.NDArray[np.intp]
    """The row of the frame from which each comes."""
    read: int
    """Values of the frame, those without a measurement included."""
    without_value: dict[str, int] = field(default_factory=dict)
    """How many had each marker for "nothing measured"."""


def _wrong(message: str) -> InvalidArgument:
    return InvalidArgument(message, "INVALID_ARGUMENT")


def numbers(
    values: Any, words: Mapping[Any, float | None] | None = None, where: str = "value"
) -> tuple[Floats, dict[str, int]]:
    """Values as numbers, NaN where nothing was measured, and how often each marker for that was there.

    ``words`` has values of further words; ``None`` stands for "nothing measured".
    """
    array = values if isinstance(values, np.ndarray) else np.asarray(values)
    array = array.ravel()
    own = {str(word).strip().lower(): value for word, value in (words or {}).items()}
    if array.dtype.kind in "biuf" and not own:
        found = np.ascontiguousarray(array, dtype=np.float64)
        empty = int(np.isnan(found).sum())
        return found, {"NaN": empty} if empty else {}
    known: dict[Any, float] = {}
    missing: dict[str, int] = {}
    strange: dict[str, int] = {}
    found = np.empty(len(array), dtype=np.float64)
    for row, value in enumerate(array.tolist()):
        try:
            number = known.get(value)
        except TypeError:
            raise _wrong(f"{where} of row {row} is {value!r}: a value is a number or a word") from None
        if number is None:
            number, marker = _number(value, own)
            if number is None:
                strange[str(value)] = strange.get(str(value), 0) + 1
                number = np.nan
            elif marker is not None:
                missing[marker] = missing.get(marker, 0) + 1
            else:
                known[value] = number
        found[row] = number
    if strange:
        first = list(strange.items())[:_NAMED]
        told = ", ".join(f"{word!r} ({count} row{'s' if count > 1 else ''})" for word, count in first)
        more = f", and {len(strange) - len(first)} more" if len(strange) > len(first) else ""
        example = first[0][0]
        raise _wrong(
            f"{where}: {told}{more}: neither a number nor a word that is known (on, off, open, closed, true, false, "
            f"yes, no). Say what it means: values={{{example!r}: 1}}, or None for \"nothing measured\""
        )
    return found, missing


def _number(value: Any, own: Mapping[str, float | None]) -> tuple[float | None, str | None]:
    """A number, and the marker if it stands for nothing measured; no number for a word that is not known."""
    word = str(value).strip().lower()
    if word in own:
        number = own[word]
        return (np.nan, word) if number is None else (float(number), None)
    if isinstance(value, (int, float)):
        return (np.nan, "NaN") if value != value else (float(value), None)
    if value is None or word in ("<na>", "nat"):
        return np.nan, "none"
    if word in WORDS:
        return WORDS[word], None
    if word in NO_VALUE:
        return np.nan, word or "empty"
    try:
        return float(word), None
    except ValueError:
        return None, None


def numbered(states: Any, rows: int) -> tuple[list[str], npt.NDArray[np.uint32]]:
    """Names, and the index of each row's."""
    if isinstance(states, str):
        return [states], np.zeros(rows, dtype=np.uint32)
    listed = states.tolist() if hasattr(states, "tolist") else states
    indices = np.empty(rows, dtype=np.uint32)
    known: dict[str, int] = {}
    count = 0
    for count, name in enumerate(listed, start=1):
        if name is None or name != name:
            raise _wrong(f"row {count - 1} has no state")
        if count <= rows:
            indices[count - 1] = known.setdefault(str(name), len(known))
    if count != rows:
        raise _wrong(f"{count} states for {rows} times")
    return list(known), indices


def of_arrays(states: Any, times: Any, values: Any) -> Rows:
    """Rows of columns; ``values`` of positions have two axes."""
    given = _times.read(times)
    names, indices = numbered(states, len(given.nanos))
    return _rows(names, indices, given, values, None)


def _rows(
    names: list[str], indices: npt.NDArray[np.uint32], given: _times.Read, values: Any, words: Mapping[Any, Any] | None
) -> Rows:
    count = len(given.nanos)
    places = np.asarray(values) if getattr(values, "ndim", 1) == 2 else None
    if places is not None and places.shape[1] not in (2, 3):
        raise _wrong(f"values have {places.shape[1]} columns: a position has two or three coordinates")
    if places is not None:
        positions = np.ascontiguousarray(places, dtype=np.float64)
        bare = np.isnan(positions).any(axis=1)
        found, missing = np.where(bare, np.nan, 0.0), {"NaN": int(bare.sum())} if bare.any() else {}
    else:
        positions = None
        found, missing = numbers(values, words)
    if len(found) != count:
        raise _wrong(f"{count} times, {len(found)} values: they must be as many")
    kept = np.flatnonzero(~np.isnan(found))
    if len(kept) == count:
        return Rows(names, indices, given, found, positions, kept, count, missing)
    return Rows(
        names, indices[kept], _picked(given, kept), found[kept],
        None if positions is None else np.ascontiguousarray(positions[kept]), kept, count, missing,
    )


def _picked(given: _times.Read, kept: npt.NDArray[np.intp]) -> _times.Read:
    return _times.Read(given.nanos[kept], None if given.local is None else given.local[kept])


def of_frame(
    frame: Any, states: Any = None, columns: Mapping[str, Any] | None = None, words: Mapping[Any, Any] | None = None
) -> Rows:
    """Rows of a frame: of pandas, of polars, or a dictionary of columns.

    ``columns`` gives the frame's own names for ``time``, ``state``, ``value``, ``x``, ``y`` and ``z``. ``states``: the
    state of a frame that has no such column; of a wide frame, the columns to take. ``words``: see :func:`numbers`.
    """
    if hasattr(frame, "to_frame") and not hasattr(frame, "columns"):
        name = states if isinstance(states, str) else getattr(frame, "name", None)
        if name is None:
            raise _wrong("the series has no name: say of which state it is, states=\"door\"")
        frame, states = frame.to_frame(str(name)), None
    present = [*frame.columns] if hasattr(frame, "columns") else [*frame.keys()]
    if len(set(present)) != len(present):
        twice = next(name for name in present if present.count(name) > 1)
        raise _wrong(f"the frame has two columns {twice!r}")
    own = {"time": "time", "state": "state", "value": "value", "x": "x", "y": "y", "z": "z"}
    for what, name in (columns or {}).items():
        if what not in own:
            raise _wrong(f"columns has {what!r}; it names time, state, value, x, y and z")
        if name not in present and not (what == "time" and _index_is_time(frame, name)):
            raise _wrong(f"the frame has no column {name!r}; it has {', '.join(map(str, present))}")
        own[what] = name
    given = _times.read(_time_of(frame, own["time"], present))
    axes = [own[axis] for axis in ("x", "y", "z") if own[axis] in present]
    has_state = states is not None or own["state"] in present
    if own["value"] in present or (own["state"] in present and len(axes) >= 2):
        if not has_state:
            raise _wrong(f"the frame has the columns {_list(present)}, but no state: say states=\"door\"")
        names, indices = numbered(states if states is not None else frame[own["state"]], len(given.nanos))
        if own["value"] in present:
            return _rows(names, indices, given, frame[own["value"]], words)
        places = np.column_stack([np.asarray(frame[axis], dtype=np.float64) for axis in axes])
        return _rows(names, indices, given, places, None)
    if own["state"] in present:
        raise _wrong(f"the frame has the columns {_list(present)}, but no value: say columns={{\"value\": …}}")
    wanted = [name for name in present if name != own["time"]] if states is None else (
        [states] if isinstance(states, str) else list(states)
    )
    return _of_wide(frame, wanted, given, words, present)


def _of_wide(
    frame: Any, wanted: list[Any], given: _times.Read, words: Mapping[Any, Any] | None, present: list[Any]
) -> Rows:
    if not wanted:
        raise _wrong("the frame has no column but the time")
    missing: dict[str, int] = {}
    table = np.empty((len(given.nanos), len(wanted)), dtype=np.float64)
    for place, name in enumerate(wanted):
        if name not in present:
            raise _wrong(f"the frame has no column {name!r}; it has {_list(present)}")
        table[:, place], bare = numbers(frame[name], words, f"column {name!r}")
        for marker, count in bare.items():
            missing[marker] = missing.get(marker, 0) + count
    rows, places = np.nonzero(~np.isnan(table))
    return Rows(
        [str(name) for name in wanted], places.astype(np.uint32), _picked(given, rows), table[rows, places], None, rows,
        table.size, missing,
    )


def _index_is_time(frame: Any, name: Any) -> bool:
    index = getattr(frame, "index", None)
    return index is not None and (getattr(index, "name", None) == name or hasattr(index, "tz"))


def _time_of(frame: Any, name: Any, present: list[Any]) -> Any:
    """The column of times, or the index."""
    if name in present:
        return frame[name]
    if _index_is_time(frame, name):
        return frame.index
    kinds = {column: str(getattr(frame[column], "dtype", "")).lower() for column in present}
    likely = [column for column, kind in kinds.items() if kind.startswith("datetime")]
    hint = f"columns={{\"time\": {likely[0]!r}}}" if len(likely) == 1 else "columns={\"time\": …}"
    raise _wrong(f"the frame has the columns {_list(present)}, but no {name}, and its index has no times: say {hint}")


def _list(names: list[Any]) -> str:
    shown = ", ".join(map(str, names[:20]))
    return shown if len(names) <= 20 else f"{shown}, … ({len(names)})"
