"""Checks of the content of rows: warnings about rows that are probably of another kind than they were sent as.

Invariant: a warning changes nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap import frames, reports
from tidemap.answers import ObservationWarning

ROWS_AT_ONCE = 20
"""From this number of rows of a state at one time on, the times are probably rounded."""
ROWS_LEAST = 20
"""With fewer rows there is no warning about a state."""
CHANGES_LEAST = 0.95
"""Share of rows that differ from the row before from which on they are probably changes."""

# The caller of the client's method.
_LEVEL = 3


def _by_state(rows: frames.Rows, column: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], Any, Any]:
    """A column with the rows of each state together, in their order; the states that have rows, and where they begin.
    """
    counts = np.bincount(rows.indices, minlength=len(rows.names))
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    together = column if len(rows.names) == 1 else column[np.argsort(rows.indices, kind="stable")]
    numbers = np.flatnonzero(counts)
    return together, numbers, begins[numbers]


def _named(rows: frames.Rows, numbers: npt.NDArray[Any]) -> tuple[str, str]:
    name = rows.names[int(numbers[0])]
    return repr(name), f", and of {len(numbers) - 1} more states" if len(numbers) > 1 else ""


def of_one_time(rows: frames.Rows, nanos: npt.NDArray[np.int64]) -> None:
    """Warns of states whose rows all have one time."""
    if len(nanos) < ROWS_AT_ONCE:
        return
    together, numbers, begins = _by_state(rows, nanos)
    counts = np.diff(np.append(begins, len(nanos)))
    same = np.minimum.reduceat(together, begins) == np.maximum.reduceat(together, begins)
    strange = same & (counts >= ROWS_AT_ONCE)
    if strange.any():
        name, more = _named(rows, numbers[strange])
        warnings.warn(
            f"all {counts[strange][0]} rows of {name} have one time{more}: were the times rounded, as in 1.736e+09?",
            ObservationWarning, stacklevel=_LEVEL,
        )


def of_changes(rows: frames.Rows, states: Callable[[], list[dict[str, Any]]]) -> None:
    """Warns of rows that were sent as readings, but alternate like the rows of a sensor that reports changes only."""
    if rows.positions is not None or len(rows.values) < ROWS_LEAST:
        return
    together, numbers, begins = _by_state(rows, rows.values)
    counts = np.diff(np.append(begins, len(together)))
    differs = np.append(False, together[1:] != together[:-1])
    differs[begins] = False
    changes = np.add.reduceat(differs.astype(np.int64), begins)
    is_binary = np.logical_and.reduceat((together == 0) | (together == 1), begins)
    strange = is_binary & (counts >= ROWS_LEAST) & (changes >= CHANGES_LEAST * (counts - 1))
    if not strange.any():
        return
    known = {state["name"] for state in states() if reports.of_state(state).kind == "samples"}
    numbers = np.array([number for number in numbers[strange] if rows.names[number] in known], dtype=np.intp)
    if len(numbers):
        name, more = _named(rows, numbers)
        warnings.warn(
            f"nearly every row of {name} differs from the row before{more}. If the sensor reports changes only, these "
            "rows have a wrong meaning as they are: erase the state (client.erase), and send them with "
            "reports=\"changes\" and a label of its own. If they are readings, set reports=\"samples\"",
            ObservationWarning, stacklevel=_LEVEL,
        )


def of_refused_before(rows: frames.Rows, states: list[dict[str, Any]]) -> None:
    """Warns of rows that were sent before but are not in the map: they were refused then, or erased since."""
    known = {state["name"] for state in states}
    absent = [name for name in rows.names if name not in known and "/" not in name]
    if absent:
        more = f" and {len(absent) - 1} more states" if len(absent) > 1 else ""
        warnings.warn(
            f"the map has nothing of {absent[0]!r}{more}: these rows were sent before, and were refused then or erased "
            "since. To send them anew, set replace=True, or give them a label of their own",
            ObservationWarning, stacklevel=_LEVEL,
        )
