"""Rows of observations from the data of users: frames of pandas and polars, dictionaries of columns, arrays.

A long frame has a row for each observation, with the columns ``time``, ``state`` and ``value`` (or ``x``, ``y`` and
``z`` for positions). A wide frame has a row for each time and a column for each state. The time may be the index.

Invariant: rows keep their order, and every row is read, dropped with its reason counted, or named in an error. A marker
for "nothing measured" (NaN, ``None``, ``unavailable``, ``unknown``) is not a measurement: in samples it is dropped, in
changes and events it means that no value is known from then on. An empty cell of a wide frame is no row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import usual_words
from tidemap.errors import InvalidArgument

Floats = npt.NDArray[np.float64]

_ONES, _ZEROS, _NO_VALUE = usual_words()
WORDS: dict[str, float] = {**dict.fromkeys(_ONES, 1.0), **dict.fromkeys(_ZEROS, 0.0)}
"""Words that are values, in any case; the command line has the same ones."""
NO_VALUE = frozenset(_NO_VALUE)
"""Words for "nothing measured", in any case."""
_NAMED = 5


LABELS = "labels"
"""A value in place of the kind of reporting: values are labels of categorical states, and each name is
``STATE/LABEL``."""


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
    """The number of values of each marker for "nothing measured"."""
    mapped: int = 0
    """The number of values that were words."""


class Numbers(NamedTuple):
    """Values as numbers."""

    values: Floats
    """NaN where nothing was measured."""
    missing: dict[str, int]
    """The number of values of each marker for "nothing measured"."""
    mapped: int
    """The number of values that were words."""
    said: npt.NDArray[np.bool_]
    """True where a word means that nothing was measured; elsewhere NaN is an empty cell."""


def _wrong(message: str) -> InvalidArgument:
    return InvalidArgument(message, "INVALID_ARGUMENT")


def numbers(
    values: Any, words: Mapping[Any, float | None] | None = None, where: str = "value", reports: str = "samples"
) -> Numbers:
    """Values as numbers.

    ``words`` has values of further words; ``None`` means "nothing measured". In events any word is one event.
    """
    array = values if isinstance(values, np.ndarray) else np.asarray(values)
    array = array.ravel()
    own = {str(word).strip().lower(): value for word, value in (words or {}).items()}
    if array.dtype.kind in "biuf" and not own:
        found = np.array(array, dtype=np.float64)
        bare = np.isnan(found)
        # One NaN of the many, so that the same rows are the same bytes; and no minus zero.
        found[bare] = np.nan
        found += 0.0
        return Numbers(found, {"NaN": int(bare.sum())} if bare.any() else {}, 0, np.zeros(len(found), dtype=np.bool_))
    known: dict[Any, _Meaning] = {}
    counts: dict[str, dict[str, int]] = {"missing": {}, "strange": {}}
    found = np.empty(len(array), dtype=np.float64)
    said = np.zeros(len(array), dtype=np.bool_)
    mapped = 0
    for row, value in enumerate(array.tolist()):
        # True is equal to 1, and may have a word of its own.
        key = (value.__class__, value)
        try:
            meaning = known.get(key)
        except TypeError:
            raise _wrong(f"{where} of row {row} is {value!r}: a value is a number or a word") from None
        if meaning is None:
            meaning = _meaning(value, own, reports)
            if meaning.marker != "NaN":
                known[key] = meaning
        found[row] = meaning.number
        mapped += meaning.is_word
        if meaning.marker is not None:
            said[row] = meaning.is_said
            kind = counts["strange" if meaning.is_strange else "missing"]
            kind[meaning.marker] = kind.get(meaning.marker, 0) + 1
    if counts["strange"]:
        raise _unknown_words(counts["strange"], where)
    return Numbers(found, counts["missing"], mapped, said)


class _Meaning(NamedTuple):
    """The meaning of a value of a frame."""

    number: float
    is_word: bool = False
    marker: str | None = None
    """The marker for "nothing measured", or for an unknown value."""
    is_said: bool = False
    """Whether the value is a word, and no empty cell."""
    is_strange: bool = False


def _meaning(value: Any, own: Mapping[str, float | None], reports: str) -> _Meaning:
    word = str(value).strip().lower()
    if word in own:
        number = own[word]
        return _Meaning(np.nan, marker=word, is_said=True) if number is None else _Meaning(float(number) + 0.0, True)
    if isinstance(value, (int, float)):
        return _Meaning(np.nan, marker="NaN") if value != value else _Meaning(float(value) + 0.0)
    if value is None or word in ("<na>", "nat"):
        return _Meaning(np.nan, marker="none")
    if word in NO_VALUE:
        return _Meaning(np.nan, marker=word or "empty", is_said=word not in ("", "nan"))
    try:
        return _Meaning(float(word) + 0.0)
    except ValueError:
        if reports == "events":
            return _Meaning(1.0, True)
        return _Meaning(WORDS[word], True) if word in WORDS else _Meaning(np.nan, marker=str(value), is_strange=True)


def _unknown_words(strange: dict[str, int], where: str) -> InvalidArgument:
    first = list(strange.items())[:_NAMED]
    listed = ", ".join(f"{word!r} ({count} row{'s' if count > 1 else ''})" for word, count in first)
    more = f", and {len(strange) - len(first)} more" if len(strange) > len(first) else ""
    return _wrong(
        f"{where}: {listed}{more}: neither a number nor a usual word such as on, off, open, closed, home or away. Give "
        f"its meaning: values={{{first[0][0]!r}: 1}}, or None for \"nothing measured\""
    )


def is_empty(cell: Any) -> bool:
    """Whether a cell of a frame has no value: ``None``, NaN, NaT or the NA of pandas."""
    if cell is None:
        return True
    # NA is equal to nothing: the comparison gives NA, not a truth value.
    equal = cell == cell
    return equal is not True and str(equal) in ("False", "<NA>")


def numbered(states: Any, rows: int) -> tuple[list[str], npt.NDArray[np.uint32]]:
    """Names, and the index of each row's."""
    if isinstance(states, str):
        return [states], np.zeros(rows, dtype=np.uint32)
    listed = states.tolist() if hasattr(states, "tolist") else states
    indices = np.empty(rows, dtype=np.uint32)
    known: dict[str, int] = {}
    count = 0
    for count, name in enumerate(listed, start=1):
        if is_empty(name):
            raise _wrong(f"row {count - 1} has no state")
        if count <= rows:
            indices[count - 1] = known.setdefault(str(name), len(known))
    if count != rows:
        raise _wrong(f"{count} states for {rows} times")
    return list(known), indices


def of_arrays(states: Any, times: Any, values: Any, reports: str = "samples") -> Rows:
    """Rows of columns; ``values`` of positions have two axes. An event without a value counts as one."""
    given = times if isinstance(times, _times.Read) else _times.read(times)
    names, indices = numbered(states, len(given.nanos))
    if values is None and reports == "events":
        values = np.ones(len(given.nanos))
    return _rows(names, indices, given, values, None, reports)


def _rows(
    names: list[str], indices: npt.NDArray[np.uint32], given: _times.Read, values: Any,
    words: Mapping[Any, Any] | None, reports: str,
) -> Rows:
    count = len(given.nanos)
    if reports == LABELS:
        return _labelled([names[index] for index in indices], given, values)
    places = np.asarray(values) if getattr(values, "ndim", 1) == 2 else None
    if places is not None:
        return _positions(names, indices, given, places, reports)
    found = numbers(values, words, reports=reports)
    if len(found.values) != count:
        raise _wrong(f"{count} times, {len(found.values)} values: they must be as many")
    kept = np.arange(count) if reports != "samples" else np.flatnonzero(~np.isnan(found.values))
    if len(kept) == count:
        return Rows(names, indices, given, found.values, None, kept, count, found.missing, found.mapped)
    return Rows(
        names, indices[kept], _picked(given, kept), found.values[kept], None, kept, count, found.missing, found.mapped
    )


def _labelled(states: list[str], given: _times.Read, values: Any) -> Rows:
    """Rows of labels; a cell without a label is no row."""
    labels = list(values.tolist() if hasattr(values, "tolist") else values)
    if len(labels) != len(states):
        raise _wrong(f"{len(states)} times, {len(labels)} labels: they must be as many")
    kept = np.array([row for row, label in enumerate(labels) if not is_empty(label)], dtype=np.intp)
    names, indices = numbered([f"{states[row]}/{labels[row]}" for row in kept], len(kept))
    dropped = len(labels) - len(kept)
    return Rows(
        names, indices, _picked(given, kept), np.ones(len(kept)), None, kept, len(labels),
        {"none": dropped} if dropped else {},
    )


def _positions(
    names: list[str], indices: npt.NDArray[np.uint32], given: _times.Read, places: Any, reports: str
) -> Rows:
    if places.shape[1] not in (2, 3):
        raise _wrong(f"values have {places.shape[1]} columns: a position has two or three coordinates")
    if reports != "samples":
        raise _wrong(f"positions are reported by samples, not by {reports}")
    count, positions = len(given.nanos), np.ascontiguousarray(places, dtype=np.float64)
    if len(positions) != count:
        raise _wrong(f"{count} times, {len(positions)} values: they must be as many")
    bare = np.isnan(positions).any(axis=1)
    kept = np.flatnonzero(~bare)
    return Rows(
        names, indices[kept], _picked(given, kept), np.zeros(len(kept)), np.ascontiguousarray(positions[kept]), kept,
        count, {"NaN": int(bare.sum())} if bare.any() else {},
    )


def _picked(given: _times.Read, kept: npt.NDArray[np.intp]) -> _times.Read:
    return _times.Read(given.nanos[kept], None if given.local is None else given.local[kept])


def of_frame(
    frame: Any, states: Any = None, columns: Mapping[str, Any] | None = None, words: Mapping[Any, Any] | None = None,
    reports: str = "samples",
) -> Rows:
    """Rows of a frame: of pandas, of polars, or a dictionary of columns.

    ``columns`` gives the frame's own names for ``time``, ``state``, ``value``, ``x``, ``y`` and ``z``. ``states``: the
    state of a frame that has no such column; of a wide frame, the columns to take. ``words``: see :func:`numbers`.
    ``reports``: the kind of the rows; a frame of events needs no values, and each row is one event.
    """
    if hasattr(frame, "to_frame") and not hasattr(frame, "columns"):
        name = states if isinstance(states, str) else getattr(frame, "name", None)
        if name is None:
            raise _wrong("the series has no name: name its state with states=\"door\"")
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
            raise _wrong(f"the frame has the columns {_list(present)}, but no state: set states=\"door\"")
        names, indices = numbered(states if states is not None else frame[own["state"]], len(given.nanos))
        if own["value"] in present:
            return _rows(names, indices, given, frame[own["value"]], words, reports)
        places = np.column_stack([np.asarray(frame[axis], dtype=np.float64) for axis in axes])
        return _rows(names, indices, given, places, None, reports)
    if reports == "events" and (own["state"] in present or (isinstance(states, str) and states not in present)):
        return of_arrays(frame[own["state"]] if states is None else states, given, None, reports)
    if own["state"] in present:
        raise _wrong(f"the frame has the columns {_list(present)}, but no value: set columns={{\"value\": …}}")
    wanted = [name for name in present if name != own["time"]] if states is None else (
        [states] if isinstance(states, str) else list(states)
    )
    return _of_wide(frame, wanted, given, words, present, reports)


def _of_wide(
    frame: Any, wanted: list[Any], given: _times.Read, words: Mapping[Any, Any] | None, present: list[Any],
    reports: str,
) -> Rows:
    if not wanted:
        raise _wrong("the frame has no column but the time")
    if reports == LABELS:
        if len(wanted) > 1:
            raise _wrong("a wide frame of labels has one column: use a long one, with time, state and value")
        return _labelled([str(wanted[0])] * len(given.nanos), given, frame[wanted[0]])
    missing: dict[str, int] = {}
    mapped = 0
    table = np.empty((len(given.nanos), len(wanted)), dtype=np.float64)
    is_row = np.ones(table.shape, dtype=np.bool_)
    for place, name in enumerate(wanted):
        if name not in present:
            raise _wrong(f"the frame has no column {name!r}; it has {_list(present)}")
        found = numbers(frame[name], words, f"column {name!r}", reports)
        table[:, place] = found.values
        is_row[:, place] = ~np.isnan(found.values) | (found.said if reports != "samples" else False)
        mapped += found.mapped
        for marker, count in found.missing.items():
            missing[marker] = missing.get(marker, 0) + count
    rows, places = np.nonzero(is_row)
    return Rows(
        [str(name) for name in wanted], places.astype(np.uint32), _picked(given, rows), table[rows, places], None, rows,
        table.size, missing, mapped,
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
    raise _wrong(f"the frame has the columns {_list(present)}, but no {name}, and its index has no times: set {hint}")


def _list(names: list[Any]) -> str:
    shown = ", ".join(map(str, names[:20]))
    return shown if len(names) <= 20 else f"{shown}, … ({len(names)})"
