"""Queries of states and grids: expected values, observed values, unusual observations.

Invariant: answers with many numbers come as arrays, all others in the form of the daemon.
"""

from __future__ import annotations

import fnmatch
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tidemap import frames, tables
from tidemap import reports as _reports
from tidemap import times as _times
from tidemap._native import evaluate as _evaluate
from tidemap._native import history as _history
from tidemap._native import model_parameters
from tidemap.answers import Grid, ObservationWarning, Predictions
from tidemap.connection import Connection, Stream
from tidemap.errors import InvalidArgument, NotFound
from tidemap.reports import Reports
from tidemap.times import Time

if TYPE_CHECKING:
    import pandas
    import xarray

_PATTERN = frozenset("*?[")


class Questions(Connection):
    """Predictions, recall, comparisons and anomalies."""

    def _states(self, map: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = []
        token = ""
        while True:
            request = {"map": map, "page_size": 10_000, "page_token": token}
            page = self.call("MapService/ListStates", request)
            found += page["states"]
            token = page["next_page_token"]
            if not token:
                return found

    def states(self, map: str) -> pandas.DataFrame:
        """All states of a map: ``state, kind, observations, order, pending, last_time, hit, false_alarm``, and their
        reporting: ``reports, hold_max, hold_step``.
        """
        tables.pandas_needed()
        return tables.of_states(self._states(map), self._zone(map))

    def _named(self, map: str, states: str | Sequence[str] | None) -> list[str]:
        """The names of states: the given names, the names that match patterns such as ``door*``, or all."""
        given = None if states is None else [states] if isinstance(states, str) else [str(name) for name in states]
        if given is not None and not any(_PATTERN & set(name) for name in given):
            return given
        present: list[str] = []
        for state in self._states(map):
            axes = ["x", "y", "z"][: 0 if state["labels"] else state["dimensions"]]
            present += [f"{state['name']}/{axis}" for axis in axes] if axes else [state["name"]]
        if given is None:
            return present
        found: dict[str, None] = {}
        for name in given:
            matching = [name] if name in present or not _PATTERN & set(name) else fnmatch.filter(present, name)
            if not matching:
                raise NotFound(f"no state of map {map} is like {name!r}", "NOT_FOUND")
            found.update(dict.fromkeys(matching))
        return list(found)

    def predict(
        self,
        map: str,
        states: str | Sequence[str] | None = None,
        times: Any = None,
        *,
        model: str = "auto",
        interval: float | None = None,
        zone: str | None = None,
    ) -> Predictions:
        """Predicts states at times: the named states, states that match patterns like ``door*``, or without ``states``
        all states.

        A categorical state has a row for each label, ``STATE/LABEL``; they sum to 1, and their entropy is the entropy
        of the distribution.

        ``interval`` is the probability of the intervals, such as 0.9. ``zone`` is the zone of times that have none:
        ``"local"`` for the zone of the map, or the name of another one.
        """
        if times is None:
            raise InvalidArgument("predict() needs times: predict(map, states, times)", "INVALID_ARGUMENT")
        names = self._named(map, states)
        nanos = self._nanos(map, times, zone)
        values, bounds, entropy, behind, names = self._native.predict(map, names, nanos, model, interval)
        lower, upper = bounds if bounds is not None else (None, None)
        none = np.iinfo(np.int64).min
        last = np.array([none if known[4] is None else known[4] for known in behind], dtype=np.int64)
        return Predictions(
            names, _times.datetimes(nanos), values, entropy, lower, upper, self._zone(map),
            models=[known[0] for known in behind], orders=[known[1] for known in behind],
            observations=[known[2] for known in behind], pending=[known[3] for known in behind],
            last_times=_times.datetimes(last),
        )

    def classify(
        self,
        map: str,
        state: str,
        likelihoods: Mapping[str, float],
        *,
        time: Time | None = None,
        place: str | None = None,
        model: str = "auto",
        learn: str | None = None,
        producer: str = "python",
        label: str = "classify",
        sequence: int | None = None,
        zone: str | None = None,
    ) -> pandas.DataFrame:
        """Computes which label of a categorical state holds: from the likelihood of the observation under each label,
        and from the state's learned data of the time and of the place.

        A row for each label: ``label, probability, likelihood, temporal_prior, spatial_prior``. ``likelihoods`` of
        labels that are not named are 0. ``time`` is now by default. ``learn``: ``"label"`` learns the likeliest label,
        ``"shares"`` all probabilities, as an observation of the state and, with a place, of ``STATE@PLACE``. With
        ``sequence``, the number of the first observation, a call that is repeated is learned once.
        ``attrs["durable_sequence"]`` is the number of the last.
        """
        tables.pandas_needed()
        request: dict[str, Any] = {
            "map": map, "state": state, "model": model,
            "likelihoods": [{"label": str(name), "likelihood": float(number)} for name, number in likelihoods.items()],
        }
        if time is not None:
            request["time"] = _times.timestamp(self._moment(map, time, zone))
        if place is not None:
            request["place"] = place
        if learn is not None:
            if learn not in ("label", "shares"):
                raise InvalidArgument(f"learn={learn!r}: \"label\" or \"shares\"", "INVALID_ARGUMENT")
            request |= {"learn": f"ACTIVITY_LEARNING_{learn.upper()}", "producer": producer, "producer_label": label}
            if sequence is not None:
                request["first_sequence"] = sequence
        reply = self.call("ObservationService/ClassifyActivity", request)
        for refusal in reply["refused"]:
            warnings.warn(f"not learned: {refusal['detail']}", ObservationWarning, stacklevel=2)
        columns = ["label", "probability", "likelihood", "temporal_prior", "spatial_prior"]
        table = tables.frame({name: [row.get(name) for row in reply["labels"]] for name in columns})
        table["spatial_prior"] = table["spatial_prior"].astype("float64")
        table.attrs["durable_sequence"] = reply["durable_sequence"]
        return table

    def evaluate(
        self,
        map: str,
        frame: Any = None,
        *,
        states: str | Sequence[str] | None = None,
        times: Any = None,
        values: Any = None,
        columns: Mapping[str, Any] | None = None,
        models: str | Sequence[str] = "auto",
        max_order: int | None = None,
        zone: str | None = None,
        reports: Reports | None = None,
    ) -> pandas.DataFrame:
        """Compares predictions with observations that are not learned; a row for each state, model and order.

        Observations and ``reports`` as of :meth:`Client.observe`. For a state that reports changes or events, the
        daemon compares with the readings that the rows represent. ``models``: names as on the command line, or
        ``"all"``. The columns are ``state, model, order, n, mse, error_rate``. What could not be compared is in
        ``attrs["unavailable"]``, and a warning lists it.
        """
        tables.pandas_needed()
        stated = _reports.stated(reports, None, None)
        said = "samples" if stated is None else stated.kind
        rows, given_zone = self._rows(frame, states, times, values, columns, zone, said)
        if stated is None and rows.without_value:
            _reports.check_values(rows.names, self._states(map))
        nanos = self._nanos(map, rows.times, given_zone, rows.indices, rows.source)
        wanted = [models] if isinstance(models, str) else list(models)
        if wanted == ["all"]:
            wanted = list(model_parameters())
        found, missing = _evaluate(
            self._native, map, rows.names, rows.indices, nanos, rows.values, wanted, max_order
        )
        for reason in missing:
            warnings.warn(f"{reason['model']}: {reason['reason']}", ObservationWarning, stacklevel=2)
        table = tables.frame(found, columns=["state", "model", "order", "n", "mse", "error_rate"])
        table["order"] = table["order"].astype("Int64")
        table["error_rate"] = table["error_rate"].astype("float64")
        table.attrs["unavailable"] = missing
        return table

    def _rows(
        self, frame: Any, states: Any, times: Any, values: Any, columns: Mapping[str, Any] | None, zone: str | None,
        reports: str = "samples",
    ) -> tuple[frames.Rows, str | None]:
        """Rows as they were given, and the zone of times that have none."""
        if frame is not None:
            if times is not None:
                if not isinstance(times, str) or zone is not None:
                    raise InvalidArgument(
                        "with a frame, times is the zone of its times: times=\"local\", or a name",
                        "INVALID_ARGUMENT",
                    )
                zone = times
            if values is not None and not isinstance(values, Mapping):
                raise InvalidArgument(
                    "with a frame, values has the meanings of words: values={\"on\": 1, \"off\": 0}", "INVALID_ARGUMENT"
                )
            return frames.of_frame(frame, states, columns, values, reports), zone
        if states is None or times is None or (values is None and reports != "events"):
            raise InvalidArgument("give a frame, or states, times and values", "INVALID_ARGUMENT")
        return frames.of_arrays(states, times, values, reports), zone

    def history(
        self,
        map: str,
        states: str | Sequence[str] | None = None,
        from_time: Time | None = None,
        to_time: Time | None = None,
        *,
        zone: str | None = None,
    ) -> pandas.DataFrame:
        """The exact observations, where the map keeps them: the columns ``time, state, value``, as ``observe`` takes
        them.

        Without ``states`` all, without times everything; ``to_time`` is not included. For states that report changes or
        events these are their rows, NaN where a row means that no value is known from then on.
        """
        tables.pandas_needed()
        begin, end = self._span(map, from_time, to_time, zone)
        names = self._named(map, states)
        parts = [_history(self._native, map, name, begin, end) for name in names]
        lengths = [len(times) for times, _ in parts]
        nanos = np.concatenate([times for times, _ in parts] or [np.zeros(0, dtype=np.int64)])
        return tables.frame({
            "time": tables.zoned(nanos, self._zone(map)),
            "state": np.repeat(np.array(names, dtype=object), lengths),
            "value": np.concatenate([values for _, values in parts] or [np.zeros(0)]),
        })

    def anomalies(
        self,
        map: str,
        states: str | Sequence[str] | None = None,
        from_time: Time | None = None,
        to_time: Time | None = None,
        *,
        confidence: float | None = None,
        top: int = 100,
        zone: str | None = None,
        **request: Any,
    ) -> pandas.DataFrame:
        """The unusual observations.

        Over all states, or several: runs of observations, judged before they were learned, the most surprising first,
        with ``from, to, state, observations, surprise_bits, above, value, probability``. For one state, given by its
        name: each reading that the model of today does not expect, with ``time, value, probability``; ``request`` then
        has fields of ``FindAnomaliesRequest``, such as ``model``.
        """
        tables.pandas_needed()
        begin, end = self._span(map, from_time, to_time, zone)
        asked: dict[str, Any] = {
            "map": map, "from_time": _times.timestamp(begin), "to_time": _times.timestamp(end), **request
        }
        if confidence is not None:
            asked["confidence"] = confidence
        if isinstance(states, str) and not _PATTERN & set(states):
            pieces = list(self.stream("QueryService/FindAnomalies", {**asked, "state": states}))
            parts = {
                name: [number for piece in pieces for number in piece[name]]
                for name in ("times_nanos", "values", "probabilities")
            }
            return tables.of_series(
                parts["times_nanos"], self._zone(map), value=parts["values"], probability=parts["probabilities"]
            )
        names = [] if states is None else self._named(map, states)
        reply = self.call("QueryService/ListSurprises", {**asked, "states": names, "top": top})
        table = tables.of_surprises(reply["surprises"], self._zone(map))
        table.attrs["dropped_runs"] = reply["dropped_runs"]
        return table

    def _span(
        self, map: str, from_time: Time | None, to_time: Time | None, zone: str | None
    ) -> tuple[int, int]:
        begin = _times.FIRST if from_time is None else self._moment(map, from_time, zone)
        end = _times.LAST if to_time is None else self._moment(map, to_time, zone)
        return begin, end

    def watch_anomalies(self, map: str, **request: Any) -> Stream:
        """Observations that the model did not expect, live as they come; fields of ``WatchAnomaliesRequest``."""
        return self.stream("QueryService/WatchAnomalies", {"map": map, **request})

    def position(
        self, map: str, state: str, times: Any, *, top: int = 1, zone: str | None = None, **request: Any
    ) -> pandas.DataFrame:
        """The probable positions of a vector: the ``top`` most probable cells of each time (0: all), a row each.

        ``x, y`` (and ``z``) are the middle of the cell in metres, ``probability`` the probability of the cell;
        ``expected_x`` and so on the expected position, ``outside`` the probability of none of the cells. Fields of
        ``PredictPositionsRequest``.
        """
        tables.pandas_needed()
        nanos = self._nanos(map, times, zone)
        asked = {"map": map, "state": state, "times_nanos": nanos, "top": top, **request}
        header: dict[str, Any] = {}
        cells: list[dict[str, Any]] = []
        for reply in self.stream("QueryService/PredictPositions", asked, zone=zone):
            if reply.get("header"):
                header = reply["header"]
            elif reply.get("cells"):
                cells.append(reply["cells"])
        table = tables.of_positions(header, cells, nanos, self._zone(map))
        table.attrs.update({name: header[name] for name in ("resolution_m", "observations", "trained_observations")})
        return table

    def flow(
        self, map: str, state: str, motion: str, times: Any, *, zone: str | None = None, **request: Any
    ) -> pandas.DataFrame:
        """Flows of people: a row for each cell of each time in which anybody was detected.

        ``state`` has the positions of people, ``motion`` their directions at the same times: an angle, or a vector with
        their velocity. ``x, y`` are the middle of the cell in metres, ``expected_count`` the number of detections in
        the window around the time, ``direction_rad`` the likeliest direction from the x axis, counter-clockwise, and
        ``share`` its probability. ``request`` has ``count_window`` and fields of ``FlowSource``, such as
        ``resolution_m`` and ``region``.
        """
        tables.pandas_needed()
        nanos = self._nanos(map, times, zone)
        asked: dict[str, Any] = {"map": map, "times_nanos": nanos}
        if "count_window" in request:
            asked["count_window"] = request.pop("count_window")
        asked["source"] = {"state": state, "motion_state": motion, **request}
        header: dict[str, Any] = {}
        cells: list[dict[str, Any]] = []
        for reply in self.stream("QueryService/PredictFlow", asked, zone=zone):
            if reply.get("header"):
                header = reply["header"]
            elif reply.get("cells"):
                cells.append(reply["cells"])
        table = tables.of_flows(header, cells, nanos, self._zone(map))
        table.attrs.update({name: header[name] for name in ("resolution_m", "detections", "rhythmic_cells")})
        return table

    def information(
        self,
        map: str,
        times: Any,
        states: str | Sequence[str] | None = None,
        *,
        locations: Sequence[str] = (),
        zone: str | None = None,
        **request: Any,
    ) -> pandas.DataFrame:
        """The information gain of observing states, locations or a region: ``time, target, information_bits,
        entropy_bits``.

        Without ``states``, ``locations`` and ``region`` all states that are probabilities. ``request`` has further
        fields of ``GetInformationRequest``.
        """
        tables.pandas_needed()
        nanos = self._nanos(map, times, zone)
        if states is None and not locations and "region" not in request:
            names = [state["name"] for state in self._states(map) if state["kind"] == "STATE_KIND_PROBABILITY"]
        else:
            names = [] if states is None else self._named(map, states)
        asked = {"map": map, "times_nanos": nanos, "states": names, "locations": list(locations), **request}
        replies = list(self.stream("ExplorationService/GetInformation", asked, zone=zone))
        return tables.of_information(replies, nanos, self._zone(map))

    def describe(self, map: str, state: str) -> dict[str, Any]:
        """The parts of a state's model: kind, order, rhythms, errors lately."""
        return self.call("QueryService/DescribeModel", {"map": map, "state": state})

    def changed_cells(self, map: str, **request: Any) -> list[dict[str, Any]]:
        """Cells of the grid whose routine seems to have changed; fields of ``ListCellAlarmsRequest``."""
        replies = self.stream("QueryService/ListCellAlarms", {"map": map, **request})
        return [cell for reply in replies for cell in reply.get("cells", [])]

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
        zone: str | None = None,
    ) -> Grid:
        """The grid at a time: ``probability``, ``entropy``, or ``threshold`` (1 where it is at least ``threshold``).

        ``region`` has the first cell and the cell beyond the last, as x, y, z, x, y, z; ``project`` gives each column
        of cells the value of its most probable cell.
        """
        nanos = self._moment(map, time, zone)
        found = self._native.predict_grid(map, nanos, model, output, threshold, region, project)
        found["first_cell"] = tuple(found["first_cell"])
        found["origin_m"] = tuple(found["origin_m"])
        return Grid(time=np.datetime64(nanos, "ns"), time_zone=self._zone(map), **found)

    def grids(self, map: str, times: Any, *, zone: str | None = None, **options: Any) -> xarray.DataArray:
        """Projected grids at times, as ``DataArray(time, y, x)`` with metres as coordinates; its times are UTC."""
        import xarray as xr

        options = {"project": True, **options}
        nanos = self._nanos(map, times, zone)
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
