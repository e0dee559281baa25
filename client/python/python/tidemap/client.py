"""A client of a daemon.

Invariant: what a call sends is durable when it returns, and the same rows sent again add nothing. Errors have the
daemon's words.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tidemap import times as _times
from tidemap._native import NativeClient, OpenProducer, model_request
from tidemap.errors import InvalidArgument, TidemapError
from tidemap.times import Time

if TYPE_CHECKING:
    import pandas
    import xarray

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Observed:
    """What became of the rows of a call."""

    read: int
    """All rows."""
    accepted: int
    """Rows that are new, and durable now."""
    duplicate: int
    """Rows that the daemon had already."""
    refused: int
    """Rows that the daemon refused."""
    refusals: list[tuple[int, str]] = field(default_factory=list)
    """Row, counted from 0, and why it was refused; the first hundred."""


@dataclass(frozen=True)
class Predictions:
    """Predicted values of states at times: one row a state, one column a time."""

    states: list[str]
    times: npt.NDArray[np.datetime64]
    values: Floats
    """Probability that a state is 1, or its expected value."""
    entropy: Floats
    """Entropy in bits."""
    lower: Floats | None = None
    """Lower end of the interval, if one was asked for."""
    upper: Floats | None = None
    """Upper end of the interval."""

    def to_pandas(self) -> pandas.DataFrame:
        """One row a time, one column a state; with intervals, columns (state, value / lower / upper)."""
        import pandas as pd

        index = pd.DatetimeIndex(self.times, name="time").tz_localize("UTC")
        if self.lower is None or self.upper is None:
            return pd.DataFrame(self.values.T, index=index, columns=self.states)
        columns: dict[tuple[str, str], Floats] = {}
        for row, state in enumerate(self.states):
            parts = ("value", self.values), ("lower", self.lower), ("upper", self.upper)
            columns.update({(state, name): numbers[row] for name, numbers in parts})
        return pd.DataFrame(columns, index=index)

    def plot(self, ax: Any = None) -> Any:
        """Draws each state over time, with its interval; returns the axes of matplotlib."""
        import matplotlib.pyplot as plt

        ax = ax if ax is not None else plt.subplots(figsize=(9, 3))[1]
        for row, state in enumerate(self.states):
            (line,) = ax.plot(self.times, self.values[row], label=state)
            if self.lower is not None and self.upper is not None:
                ax.fill_between(self.times, self.lower[row], self.upper[row], alpha=0.2, color=line.get_color())
        ax.set_xlabel("time (UTC)")
        ax.set_ylabel("probability")
        ax.legend()
        return ax


@dataclass(frozen=True)
class Grid:
    """A predicted grid: axes z, y, x, from the lowest cell. Cells that were never observed are NaN."""

    time: np.datetime64
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
        """Middles of the layers, metres; of a projected grid, that of its lowest layer."""
        return self._centres_m(2, self.values.shape[0])

    def plot(self, ax: Any = None) -> Any:
        """Draws the highest value of each column of cells; returns the axes of matplotlib."""
        import matplotlib.pyplot as plt

        ax = ax if ax is not None else plt.subplots()[1]
        known = ~np.isnan(self.values)
        highest = np.where(known, self.values, -1).max(axis=0)
        half = self.resolution_m / 2
        extent = (self.x_m[0] - half, self.x_m[-1] + half, self.y_m[0] - half, self.y_m[-1] + half)
        image = ax.imshow(
            np.where(highest < 0, np.nan, highest),
            origin="lower", extent=extent, vmin=0, vmax=1, cmap="viridis", interpolation="nearest",
        )
        ax.figure.colorbar(image, ax=ax, label="probability")
        ax.set_xlabel("x (m)")
        ax.set_ylabel("y (m)")
        ax.set_title(str(self.time.astype("datetime64[s]")) + " UTC")
        return ax


class Producer:
    """Observations as they come; use it as a context manager. What it has taken is durable after ``flush()``."""

    def __init__(self, native: OpenProducer) -> None:
        self._native = native

    def send(self, state: str, time: Time, value: float) -> int:
        """Takes an observation and returns its number; it is sent in the background."""
        return self._native.send(state, _times.nanos(time), float(value))

    def flush(self) -> int:
        """Waits until everything that was taken is durable, and returns the number of the last."""
        return self._native.flush()

    def close(self) -> None:
        """Waits until everything is durable, and ends."""
        self._native.close()

    def __enter__(self) -> Producer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _bytes_of(what: str | Path | bytes | None) -> bytes | None:
    return what if what is None or isinstance(what, bytes) else Path(what).read_bytes()


class Client:
    """A client of a daemon. Methods return when the daemon has answered; other threads of Python run meanwhile."""

    def __init__(
        self,
        server: str = "127.0.0.1:7435",
        *,
        token: str | None = None,
        ca: str | Path | bytes | None = None,
        certificate: str | Path | bytes | None = None,
        key: str | Path | bytes | None = None,
    ) -> None:
        self._native = NativeClient(server, token, _bytes_of(ca), _bytes_of(certificate), _bytes_of(key))

    @property
    def server(self) -> str:
        """Its address."""
        return self._native.server

    def __repr__(self) -> str:
        return f"<tidemap.Client of {self.server}>"

    # Any RPC

    def stream(self, method: str, request: dict[str, Any] | None = None) -> Iterator[dict[str, Any]]:
        """The replies of ``SERVICE/METHOD``, one by one, as the API page of the guide describes them."""
        for reply in self._native.call(method, json.dumps(_prepared(request or {}))):
            yield json.loads(reply)

    def call(self, method: str, request: dict[str, Any] | None = None) -> dict[str, Any]:
        """The one reply of ``SERVICE/METHOD``."""
        replies = list(self.stream(method, request))
        if len(replies) != 1:
            raise TidemapError(f"{method} gave {len(replies)} replies: use stream()", "INTERNAL")
        return replies[0]

    # Maps

    def maps(self) -> list[dict[str, Any]]:
        """All maps."""
        found: list[dict[str, Any]] = []
        token = ""
        while True:
            page = self.call("MapService/ListMaps", {"page_size": 1000, "page_token": token})
            found += page["maps"]
            token = page["next_page_token"]
            if not token:
                return found

    def map(self, name: str) -> dict[str, Any]:
        """One map."""
        found: dict[str, Any] = self.call("MapService/GetMap", {"name": name})["map"]
        return found

    def create_map(
        self, name: str, *, time_zone: str = "UTC", grid_resolution_m: float | None = None, **settings: Any
    ) -> dict[str, Any]:
        """Creates a map; ``settings`` are further fields of ``CreateMapRequest``."""
        request = {"name": name, "time_zone": time_zone, **settings}
        if grid_resolution_m is not None:
            request["grid"] = {"resolution_m": grid_resolution_m, **settings.get("grid", {})}
        created: dict[str, Any] = self.call("MapService/CreateMap", request)["map"]
        return created

    def delete_map(self, name: str) -> None:
        """Deletes a map and all that it has learned."""
        self.call("MapService/DeleteMap", {"name": name})

    def states(self, map: str) -> list[dict[str, Any]]:
        """All states of a map."""
        found: list[dict[str, Any]] = []
        token = ""
        while True:
            request = {"map": map, "page_size": 10_000, "page_token": token}
            page = self.call("MapService/ListStates", request)
            found += page["states"]
            token = page["next_page_token"]
            if not token:
                return found

    # Observations

    def observe(
        self,
        map: str,
        frame: Any = None,
        *,
        states: str | Sequence[str] | None = None,
        times: Any = None,
        values: Any = None,
        producer: str = "python",
        label: str = "",
        kind: str | None = None,
        nightly: bool = False,
        progress: bool | Callable[[int, int], object] = False,
    ) -> Observed:
        """Sends observations and waits until they are durable.

        ``frame`` is a DataFrame of pandas or polars with the columns ``time``, ``state`` and ``value``; or give
        ``states`` (one name, or one for each row), ``times`` and ``values``. The rows of a producer and label are
        counted from the first: the same rows sent again add nothing, and more rows behind them are added. Data that is
        not a continuation needs a ``label`` of its own. ``nightly``: the nightly update follows the time of the data.
        """
        if frame is not None:
            states, times, values = _columns(frame, states)
        if states is None or times is None or values is None:
            raise InvalidArgument("observe() needs a frame, or states, times and values", "INVALID_ARGUMENT")
        nanos = _times.all_nanos(times)
        numbers = np.ascontiguousarray(np.asarray(values, dtype=np.float64).ravel())
        names, indices = _numbered(states, len(nanos))
        shown, done = _shown(progress)
        try:
            report = self._native.observe(
                map, names, indices, nanos, numbers, producer, label, kind, nightly, shown
            )
        finally:
            done()
        return Observed(**report)

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
        report = self._native.observe_grids(
            map, _times.all_nanos(times), cells, first_cell, producer, label, nightly
        )
        return Observed(**report)

    def producer(self, map: str, producer: str = "python", label: str = "live") -> Producer:
        """A producer that stays open, for observations as they come."""
        return Producer(self._native.open_producer(map, producer, label))

    def update(self, map: str, until: Time | None = None) -> dict[str, Any]:
        """Learns what was observed, as the nightly update does, and waits for it; returns the job."""
        request: dict[str, Any] = {"map": map}
        if until is not None:
            request["until"] = _times.timestamp(until)
        job = self.call("MaintenanceService/RunUpdate", request)["job"]
        for reply in self.stream("MaintenanceService/WatchJob", {"id": job["id"]}):
            job = reply["job"]
        if job.get("state") == "JOB_STATE_FAILED":
            raise TidemapError(f"the update of {map} failed: {job.get('error', '')}", "INTERNAL")
        return dict(job)

    def jobs(self, map: str = "") -> list[dict[str, Any]]:
        """Running jobs, and those that ended recently, the newest first; of one map, or of all."""
        jobs: list[dict[str, Any]] = self.call("MaintenanceService/ListJobs", {"page_size": 1000})["jobs"]
        return [job for job in jobs if map in ("", job["map"])]

    # Questions

    def predict(
        self,
        map: str,
        states: str | Sequence[str],
        times: Any,
        *,
        model: str = "auto",
        interval: float | None = None,
    ) -> Predictions:
        """Predicts states at times. ``interval`` is the probability of the intervals, such as 0.9."""
        names = [states] if isinstance(states, str) else list(states)
        nanos = _times.all_nanos(times)
        values, bounds, entropy = self._native.predict(map, names, nanos, model, interval)
        lower, upper = bounds if bounds is not None else (None, None)
        return Predictions(names, _times.datetimes(nanos), values, entropy, lower, upper)

    def grid(
        self,
        map: str,
        time: Time,
        *,
        model: str = "auto",
        output: str = "probability",
        threshold: float = 0.5,
        region: tuple[int, int, int, int, int, int] | None = None,
        project: bool = False,
    ) -> Grid:
        """The grid at a time: ``probability``, ``entropy``, or ``threshold`` (1 where it is at least ``threshold``).

        ``region`` has the first cell and the one beyond the last, as x, y, z, x, y, z; ``project`` gives each column
        of cells the value of its most probable one.
        """
        nanos = _times.nanos(time)
        found = self._native.predict_grid(map, nanos, model, output, threshold, region, project)
        found["first_cell"] = tuple(found["first_cell"])
        found["origin_m"] = tuple(found["origin_m"])
        return Grid(time=np.datetime64(nanos, "ns"), **found)

    def grids(self, map: str, times: Any, **options: Any) -> xarray.DataArray:
        """Projected grids at times, as ``DataArray(time, y, x)`` with metres as coordinates."""
        import xarray as xr

        options = {"project": True, **options}
        nanos = _times.all_nanos(times)
        pictures = [self.grid(map, int(time), **options) for time in nanos]
        if not pictures:
            raise InvalidArgument("grids() needs at least one time", "INVALID_ARGUMENT")
        first = pictures[0]
        return xr.DataArray(
            np.stack([np.nanmax(picture.values, axis=0) if picture.values.shape[0] > 1 else picture.values[0]
                      for picture in pictures]),
            dims=("time", "y", "x"),
            coords={"time": _times.datetimes(nanos), "y": first.y_m, "x": first.x_m},
            name=map,
            attrs={"frame_id": first.frame_id, "resolution_m": first.resolution_m},
        )

    def information(self, map: str, time: Time, **request: Any) -> list[dict[str, Any]]:
        """What observing each location at a time teaches; fields of ``GetInformationRequest``."""
        asked = {"map": map, "time": _times.timestamp(time), **request}
        return list(self.stream("ExplorationService/GetInformation", asked))

    def tour(self, map: str, time: Time, count: int, **request: Any) -> dict[str, Any]:
        """A tour to the ``count`` places where looking teaches most; fields of ``PlanTourRequest``."""
        asked = {"map": map, "time": _times.timestamp(time), "count": count, **request}
        return self.call("ExplorationService/PlanTour", asked)

    def day(self, map: str, date: str, **request: Any) -> dict[str, Any]:
        """When to explore on a day (``2026-01-05``) and where; fields of ``PlanDayRequest``."""
        return self.call("ExplorationService/PlanDay", {"map": map, "date": date, **request})

    def route(self, map: str, start: str, goal: str, depart: Time | None = None, **request: Any) -> dict[str, Any]:
        """The way from a node to another one when leaving at a time; fields of ``PlanRouteRequest``."""
        asked: dict[str, Any] = {"map": map, "from": start, "to": goal, **request}
        if depart is not None:
            asked["depart_time"] = _times.timestamp(depart)
        return self.call("RouteService/PlanRoute", asked)

    def policy(self, map: str, goal: str, start_time: Time, **request: Any) -> dict[str, Any]:
        """What to do at each node and time to reach a node; fields of ``PlanPolicyRequest``."""
        asked = {"map": map, "to": goal, "start_time": _times.timestamp(start_time), **request}
        return self.call("RouteService/PlanPolicy", asked)

    def search(self, map: str, start: str, object: str, start_time: Time, **request: Any) -> dict[str, Any]:
        """Where to look for something, in which order; fields of ``PlanSearchRequest``."""
        asked = {"map": map, "start": start, "object": object, "start_time": _times.timestamp(start_time), **request}
        return self.call("SearchService/PlanSearch", asked)

    def describe(self, map: str, state: str) -> dict[str, Any]:
        """What a state's model consists of: kind, order, rhythms, errors lately."""
        return self.call("QueryService/DescribeModel", {"map": map, "state": state})

    def anomalies(self, map: str, **request: Any) -> Iterator[dict[str, Any]]:
        """Observations that the model did not expect, live as they come; fields of ``WatchAnomaliesRequest``."""
        return self.stream("QueryService/WatchAnomalies", {"map": map, **request})

    def surprises(self, map: str, from_time: Time, to_time: Time, **request: Any) -> list[dict[str, Any]]:
        """What was unusual before it was learned, most surprising first; fields of ``ListSurprisesRequest``."""
        asked = {"map": map, "from_time": _times.timestamp(from_time), "to_time": _times.timestamp(to_time), **request}
        return self.call("QueryService/ListSurprises", asked).get("surprises", [])

    def changed_cells(self, map: str, **request: Any) -> list[dict[str, Any]]:
        """Cells of the grid whose routine seems to have changed; fields of ``ListCellAlarmsRequest``."""
        replies = self.stream("QueryService/ListCellAlarms", {"map": map, **request})
        return [cell for reply in replies for cell in reply.get("cells", [])]


def connect(server: str = "127.0.0.1:7435", **credentials: Any) -> Client:
    """A client of the daemon at ``server``, checked: ``HOST:PORT``, ``https://HOST:PORT`` or ``unix:PATH``.

    ``token``, ``ca``, ``certificate`` and ``key`` as of :class:`Client`.
    """
    client = Client(server, **credentials)
    client.maps()
    return client


def _prepared(value: Any) -> Any:
    """A request as JSON has it: times become texts, and the name of a model what it stands for."""
    if isinstance(value, dict):
        prepared = {key: _prepared(item) for key, item in value.items()}
        if isinstance(value.get("model"), str):
            prepared["model"] = json.loads(model_request(value["model"]))
        return prepared
    if isinstance(value, (list, tuple)):
        return [_prepared(item) for item in value]
    if isinstance(value, np.generic) and not isinstance(value, np.datetime64):
        return value.item()
    if isinstance(value, np.datetime64) or hasattr(value, "tzinfo"):
        return _times.timestamp(value)
    return value


def _columns(frame: Any, states: Any) -> tuple[Any, Any, Any]:
    names = list(frame.columns)
    missing = [name for name in ("time", "value") if name not in names]
    if states is None and "state" not in names:
        missing.append("state")
    if missing:
        raise InvalidArgument(
            f"the frame has the columns {', '.join(map(str, names))}, but no {' and no '.join(missing)}",
            "INVALID_ARGUMENT",
        )
    return (states if states is not None else frame["state"]), frame["time"], frame["value"]


def _numbered(states: Any, rows: int) -> tuple[list[str], npt.NDArray[np.uint32]]:
    """Names, and the index of each row's."""
    if isinstance(states, str):
        return [states], np.zeros(rows, dtype=np.uint32)
    numbers: dict[str, int] = {}
    indices = np.fromiter((numbers.setdefault(str(name), len(numbers)) for name in states), dtype=np.uint32)
    if len(indices) != rows:
        raise InvalidArgument(f"{len(indices)} states for {rows} times", "INVALID_ARGUMENT")
    return list(numbers), indices


def _shown(progress: bool | Callable[[int, int], object]) -> tuple[Callable[[int, int], object] | None, Callable[[], None]]:
    """What is called with the number of durable rows and of all, and what ends it."""
    if callable(progress):
        return progress, lambda: None
    if not progress:
        return None, lambda: None
    try:
        from tqdm.auto import tqdm  # type: ignore[import-untyped, unused-ignore]
    except ImportError:
        def plain(durable: int, rows: int) -> None:
            print(f"\r{durable:,} of {rows:,} observations", end="", flush=True)

        return plain, print
    bar = tqdm(unit="obs", unit_scale=True)

    def step(durable: int, rows: int) -> None:
        bar.total = rows
        bar.update(durable - bar.n)

    return step, bar.close
