"""The replies of the daemon, as values of Python.

Invariant: an answer holds the numbers of the wire, and never changes.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from tidemap import plots, tables
from tidemap import times as _times

if TYPE_CHECKING:
    import pandas

Floats = npt.NDArray[np.float64]
_ROWS_SHOWN = 20


class ObservationWarning(UserWarning):
    """Rows of observations that were refused, or not used."""


@dataclass(frozen=True)
class Observed:
    """The counts of the rows of a call."""

    read: int
    """All rows; of a wide frame, all values."""
    accepted: int
    """Rows that are new, and durable now."""
    duplicate: int
    """Rows that the daemon had already."""
    refused: int
    """Rows that the daemon refused."""
    refusals: list[tuple[int, str]] = field(default_factory=list)
    """Row, counted from 0, and why it was refused; the first hundred."""
    without_value: dict[str, int] = field(default_factory=dict)
    """Rows in which nothing was measured: the number of each marker, such as ``unavailable``. Such rows of samples are
    not sent. Such rows of changes and events are sent as "no value is known from then on", except for empty cells of a
    wide frame."""
    mapped: int = 0
    """Rows whose value was a word."""


class Map(dict[str, Any]):
    """A map: a dictionary of the fields of the wire, which a notebook shows as a table."""

    def _repr_html_(self) -> str:
        last = self.get("last_update") or {}
        rows = [
            ("time zone", self.get("time_zone")), ("states", self.get("states")),
            ("observations", self.get("observations")), ("not yet learned", self.get("pending_observations")),
            ("updates", last.get("generation")), ("created", self.get("create_time")),
        ]
        grid = self.get("grid")
        if grid:
            rows.append(("grid", f"{grid.get('resolution_m')} m, frame {grid.get('frame_id')!r}"))
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(_plain(value))}</td></tr>"
            for name, value in rows if value is not None
        )
        return f"<table><caption>map <b>{escape(str(self.get('name', '')))}</b></caption><tbody>{cells}</tbody></table>"


def _plain(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)


class Topology(NamedTuple):
    """Nodes and edges of a map."""

    nodes: pandas.DataFrame
    edges: pandas.DataFrame


@dataclass(frozen=True, repr=False)
class Predictions:
    """Predicted values of states at times: one row a state, one column a time."""

    states: list[str]
    times: npt.NDArray[np.datetime64]
    """UTC."""
    values: Floats
    """Probability that a state is 1, or its expected value."""
    entropy: Floats
    """Entropy in bits."""
    lower: Floats | None = None
    """Lower end of the interval, if one was requested."""
    upper: Floats | None = None
    """Upper end of the interval."""
    time_zone: str = "UTC"
    """The zone of the map."""
    models: list[str | None] = field(default_factory=list)
    """The model that answered for each state; ``None``: nothing was learned, and the prior answered."""
    orders: list[int] = field(default_factory=list)
    """Number of rhythms of that model."""
    observations: list[int] = field(default_factory=list)
    """Acknowledged observations of each state."""
    pending: list[int] = field(default_factory=list)
    """Observations of each state that no update has learned."""
    last_times: npt.NDArray[np.datetime64] | None = None
    """Time of the newest observation of each state, UTC; NaT: there is none."""

    @property
    def _nanos(self) -> npt.NDArray[np.int64]:
        return self.times.astype("datetime64[ns]").astype(np.int64)

    def to_pandas(self, *, long: bool = False) -> pandas.DataFrame:
        """One row a time, one column a state; with intervals, columns (state, value / lower / upper).

        ``long``: a row for each time and state, with the columns ``time``, ``state``, ``probability``, ``entropy_bits``
        and, with intervals, ``lower`` and ``upper``. Times are in the zone of the map.
        """
        tables.pandas_needed()
        index = tables.zoned(self._nanos, self.time_zone).rename("time")
        if long:
            columns: dict[Any, Any] = {
                "time": np.tile(np.arange(len(index)), len(self.states)),
                "state": np.repeat(np.array(self.states, dtype=object), len(index)),
                "probability": self.values.ravel(),
            }
            columns["time"] = index.take(columns["time"])
            if self.lower is not None and self.upper is not None:
                columns.update(lower=self.lower.ravel(), upper=self.upper.ravel())
            return tables.frame({**columns, "entropy_bits": self.entropy.ravel()})
        if self.lower is None or self.upper is None:
            return tables.frame(self.values.T, index=index, columns=self.states)
        wide: dict[tuple[str, str], Floats] = {}
        for row, state in enumerate(self.states):
            parts = ("value", self.values), ("lower", self.lower), ("upper", self.upper)
            wide.update({(state, name): numbers[row] for name, numbers in parts})
        return tables.frame(wide, index=index)

    def plot(self, ax: Any = None) -> Any:
        """Draws each state over time with its interval, or with more than twelve states a heat map.

        Returns the axes of matplotlib.
        """
        bounds = None if self.lower is None or self.upper is None else (self.lower, self.upper)
        return plots.states(ax, self.states, self._nanos, self.values, bounds, self.time_zone)

    def _span(self) -> str:
        nanos = self._nanos
        if not len(nanos):
            return ""
        first, last = _times.to_clock(np.array([nanos.min(), nanos.max()]), self.time_zone).astype("datetime64[m]")
        return f", {first} to {last} ({self.time_zone})".replace("T", " ")

    def __repr__(self) -> str:
        named = ", ".join(self.states[:3]) + (", …" if len(self.states) > 3 else "")
        return f"<tidemap.Predictions: {len(self.states)} states × {len(self.times)} times{self._span()}: {named}>"

    def _repr_html_(self) -> str:
        nanos, span = self._nanos, self._span()
        rows = "".join(
            f"<tr><td style='text-align:left'>{escape(name)}</td><td>{_film(self.values[row])}</td>"
            f"<td>{np.nanmin(self.values[row]):.3g}</td><td>{np.nanmean(self.values[row]):.3g}</td>"
            f"<td>{np.nanmax(self.values[row]):.3g}</td></tr>"
            for row, name in enumerate(self.states[:_ROWS_SHOWN]) if len(nanos)
        )
        more = len(self.states) - _ROWS_SHOWN
        rest = f"<p>and {more} more states</p>" if more > 0 else ""
        return (
            f"<table><caption>{len(self.states)} × {len(nanos)} predictions{escape(span)}</caption><thead><tr>"
            "<th style='text-align:left'>state</th><th>over time</th><th>least</th><th>mean</th><th>most</th></tr>"
            f"</thead><tbody>{rows}</tbody></table>{rest}"
        )


def _film(values: Floats) -> str:
    """A line of a hundred points, as a picture of a notebook."""
    parts = np.array_split(values, min(len(values), 100))
    points = np.array([np.nanmean(part) if not np.isnan(part).all() else 0.0 for part in parts])
    low, high = min(0.0, float(points.min())), max(1.0, float(points.max()))
    heights = 19 - 18 * (points - low) / (high - low)
    steps = 200 / max(len(points) - 1, 1)
    line = " ".join(f"{place * steps:.0f},{height:.1f}" for place, height in enumerate(heights))
    return (
        "<svg width='200' height='20' viewBox='0 0 200 20'><polyline fill='none' stroke='currentColor' "
        f"points='{line}'/></svg>"
    )


@dataclass(frozen=True)
class Grid:
    """A predicted grid: axes z, y, x, from the lowest cell. Cells that were never observed are NaN."""

    time: np.datetime64
    """UTC."""
    values: npt.NDArray[np.float32] = field(repr=False)
    changing: npt.NDArray[np.bool_] = field(repr=False)
    """Cells that have been read as both free and occupied."""
    first_cell: tuple[int, int, int]
    """Index x, y, z of the first cell."""
    resolution_m: float
    origin_m: tuple[float, float, float]
    """Lower corner of cell (0, 0, 0) in the map's frame, metres."""
    frame_id: str
    generation: int
    """Number of updates at the time of the answer."""
    time_zone: str = "UTC"
    """The zone of the map."""

    def _centres_m(self, axis: int, count: int) -> Floats:
        cells = self.first_cell[axis] + np.arange(count) + 0.5
        return np.asarray(self.origin_m[axis] + cells * self.resolution_m, dtype=np.float64)

    @property
    def x_m(self) -> Floats:
        """Middles of the columns, metres."""
        return self._centres_m(0, self.values.shape[2])

    @property
    def y_m(self) -> Floats:
        """Middles of the rows, metres."""
        return self._centres_m(1, self.values.shape[1])

    @property
    def z_m(self) -> Floats:
        """Middles of the layers, metres; of a projected grid, the middle of its lowest layer."""
        return self._centres_m(2, self.values.shape[0])

    def plot(self, ax: Any = None) -> Any:
        """Draws the highest value of each column of cells; returns the axes of matplotlib."""
        half = self.resolution_m / 2
        extent = (self.x_m[0] - half, self.x_m[-1] + half, self.y_m[0] - half, self.y_m[-1] + half)
        clock = _times.to_clock(np.array([self.time.astype("datetime64[ns]").astype(np.int64)]), self.time_zone)[0]
        title = f"{str(clock.astype('datetime64[s]')).replace('T', ' ')} ({self.time_zone})"
        return plots.grid(ax, self.values, extent, title)


def observed(
    report: dict[str, Any], source: npt.NDArray[np.intp] | None = None, read: int | None = None,
    without_value: dict[str, int] | None = None, mapped: int = 0, may_replace: bool = False,
) -> Observed:
    """The counts of rows, with their numbers in the frame ``source``; warns of refused rows."""
    known = () if source is None else source
    told = [(int(known[row]) if row < len(known) else row, why) for row, why in report["refusals"]]
    found = Observed(
        **{**report, "refusals": told, "read": report["read"] if read is None else read},
        without_value=without_value or {}, mapped=mapped,
    )
    if found.refused:
        first = "; ".join(f"row {row}: {why}" for row, why in found.refusals[:3])
        more = ", …" if found.refused > 3 else ""
        kind = any("not between 0 and 1" in why for _, why in found.refusals)
        hint = "; values that are no probabilities need kind=\"continuous\" or kind=\"count\"" if kind else ""
        warnings.warn(
            f"{found.refused} of {found.read} rows were refused: {first}{more} (all in .refusals){hint}. Corrected "
            f"rows need {'replace=True, or ' if may_replace else ''}a label of their own",
            ObservationWarning, stacklevel=3,
        )
    return found
