"""Questions about places: topologies, routes, searches, and where to explore.

Invariant: nothing is computed here; the daemon plans.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tidemap import frames, tables
from tidemap import times as _times
from tidemap.answers import Observed, Topology, observed
from tidemap.connection import Connection
from tidemap.errors import InvalidArgument
from tidemap.times import Time

if TYPE_CHECKING:
    import pandas


def _wrong(message: str) -> InvalidArgument:
    return InvalidArgument(message, "INVALID_ARGUMENT")


def _records(frame: Any, needed: tuple[str, ...], known: tuple[str, ...]) -> list[dict[str, Any]]:
    """The rows of a frame with these columns; cells without a value are left out."""
    names = [str(name) for name in (frame.columns if hasattr(frame, "columns") else frame.keys())]
    missing = [name for name in needed if name not in names]
    if missing:
        raise _wrong(f"the frame has the columns {', '.join(names)}, but no {' and no '.join(missing)}")
    strange = [name for name in names if name not in known]
    if strange:
        raise _wrong(f"the frame has a column {strange[0]!r}; columns are {', '.join(known)}")
    columns = [np.asarray(frame[name], dtype=object).tolist() for name in names]
    rows = [dict(zip(names, row)) for row in zip(*columns)]
    return [{name: cell for name, cell in row.items() if not frames.is_empty(cell)} for row in rows]


class Routes(Connection):
    """Topologies, no-go areas, routes, searches and exploration."""

    def topology(self, map: str) -> Topology:
        """Nodes (``name, x_m, y_m, yaw_rad, dwell_secs``) and edges (``from, to, action, length_m, nominal_secs``)."""
        reply = self.call("TopologyService/GetTopology", {"map": map})
        return Topology(tables.of_nodes(reply["nodes"]), tables.of_edges(reply["edges"]))

    def load_topology(self, map: str, edges: Any, nodes: Any = None, *, adds: bool = False) -> dict[str, Any]:
        """Loads nodes and edges, frames with the columns of :meth:`topology`; an edge needs a length or a nominal time.

        A column ``both_ways`` of the edges also makes the opposite edge. Without ``nodes``, they are the ends of the
        edges. ``adds``: the map keeps the nodes and edges that it has.
        """
        ends = ("from", "to", "action", "both_ways")
        rows = _records(edges, ("from", "to"), (*ends, "length_m", "nominal_secs"))
        if nodes is None:
            names = dict.fromkeys(str(row[end]) for row in rows for end in ("from", "to"))
            places: list[dict[str, Any]] = [{"name": name} for name in names]
        else:
            pose = ("x_m", "y_m", "yaw_rad")
            places = []
            for row in _records(nodes, ("name",), ("name", *pose, "dwell_secs")):
                place = {name: cell for name, cell in row.items() if name not in pose}
                if "x_m" in row or "y_m" in row:
                    place["pose"] = {name: row[name] for name in pose if name in row}
                places.append(place)
        request = {
            "map": map, "nodes": places, "adds": adds,
            "edges": [
                {"ends": {name: row[name] for name in ends if name in row},
                 **{name: cell for name, cell in row.items() if name not in ends}}
                for row in rows
            ],
        }
        return self.call("TopologyService/LoadTopology", request)

    def add_no_go(self, map: str, area: str, corners: Any) -> None:
        """Adds an area that nothing is planned through, or replaces the area of the same name.

        ``corners`` are pairs of metres, in their order around the polygon.
        """
        points = [{"x_m": float(x_m), "y_m": float(y_m)} for x_m, y_m in corners]
        self.call("MapService/SetNoGo", {"map": map, "area": {"name": area, "corners": points}})

    def remove_no_go(self, map: str, area: str) -> None:
        """Removes an area that nothing is planned through."""
        self.call("MapService/DeleteNoGo", {"map": map, "area": area})

    def no_go(self, map: str) -> dict[str, list[tuple[float, float]]]:
        """The areas that nothing is planned through: the corners of each, in metres, by its name."""
        areas = self.call("MapService/ListNoGo", {"map": map})["areas"]
        return {area["name"]: [(point["x_m"], point["y_m"]) for point in area["corners"]] for area in areas}

    def traverse(
        self,
        map: str,
        frame: Any,
        *,
        times: str | None = None,
        columns: Mapping[str, Any] | None = None,
        producer: str = "python",
        label: str = "",
        nightly: bool = False,
    ) -> Observed:
        """Reports traversals of edges, and waits until they are durable; the same rows again add nothing.

        ``frame`` has the columns ``from``, ``to``, ``start``, ``end`` and ``success``, and may have ``action`` and
        ``reason``; ``columns`` gives the frame's own names for them. ``times``: see :meth:`Client.observe`.
        """
        own = {name: name for name in ("from", "to", "start", "end", "success", "action", "reason")}
        own.update(columns or {})
        names = list(frame.columns if hasattr(frame, "columns") else frame.keys())
        missing = [own[name] for name in ("from", "to", "start", "end", "success") if own[name] not in names]
        if missing:
            present = ", ".join(str(name) for name in names)
            raise _wrong(f"the frame has the columns {present}, but no {' and no '.join(missing)}")
        start, end = (self._nanos(map, _times.read(frame[own[name]]), times) for name in ("start", "end"))
        success, bare, *_ = frames.numbers(frame[own["success"]], where="success")
        if bare:
            raise _wrong(f"success of row {int(np.argmax(np.isnan(success)))} is missing")

        def texts(name: str) -> list[str]:
            if own[name] not in names:
                return [""] * len(start)
            cells = np.asarray(frame[own[name]], dtype=object).tolist()
            return ["" if frames.is_empty(cell) else str(cell) for cell in cells]

        driven = list(zip(
            texts("from"), texts("to"), texts("action"), start.tolist(), end.tolist(), (success >= 0.5).tolist(),
            texts("reason"),
        ))
        return observed(self._native.traverse(map, driven, producer, label, nightly))

    def route(
        self,
        map: str,
        start: str,
        goal: str,
        depart: Time | None = None,
        *,
        arrive_by: Time | None = None,
        zone: str | None = None,
        **request: Any,
    ) -> pandas.DataFrame:
        """The way from a node to another one: a row for each edge, with ``route`` 0 for the best and more for
        alternatives.

        The robot leaves at ``depart``, or arrives by ``arrive_by``. ``attrs["routes"]`` has success, departure, arrival
        and cost of each route. Further fields of ``PlanRouteRequest``: ``alternatives=1``, ``objective=…``.
        """
        asked: dict[str, Any] = {"map": map, "from": start, "to": goal, **request}
        for name, time in (("depart_time", depart), ("arrive_by_time", arrive_by)):
            if time is not None:
                asked[name] = _times.timestamp(self._moment(map, time, zone))
        return tables.of_routes(self.call("RouteService/PlanRoute", asked, zone=zone), self._zone(map))

    def policy(
        self, map: str, goal: str, start_time: Time, *, zone: str | None = None, **request: Any
    ) -> pandas.DataFrame:
        """The action at each node and time to reach a node: ``slot

        ``action`` is ``take`` (the edge to ``next``, with its action as in ``take:elevator``), ``wait``, ``nothing`` or
        ``arrived``. ``request`` has further fields of ``PlanPolicyRequest``.
        """
        tables.pandas_needed()
        asked = {"map": map, "to": goal, "start_time": self._text(map, start_time, zone), **request}
        return tables.of_policy(self.call("RouteService/PlanPolicy", asked, zone=zone), self._zone(map))

    def search(
        self, map: str, start: str, object: str, start_time: Time, *, zone: str | None = None, **request: Any
    ) -> pandas.DataFrame:
        """The places to search for a target, in order: ``step, node, arrival_secs, probability``.

        ``attrs`` has what holds for the whole search, such as ``expected_secs``. ``request`` has further fields of
        ``PlanSearchRequest``.
        """
        tables.pandas_needed()
        asked = {
            "map": map, "start": start, "object": object, "start_time": self._text(map, start_time, zone), **request
        }
        return tables.of_search(self.call("SearchService/PlanSearch", asked, zone=zone))

    def tour(
        self,
        map: str,
        time: Time,
        count: int,
        *,
        start: tuple[float, float] | Mapping[str, float] | None = None,
        zone: str | None = None,
        **request: Any,
    ) -> pandas.DataFrame:
        """A tour to the ``count`` places where observations give most information, in driving order.

        The columns are ``step, x, y, information_bits, reachability, arrival_secs``; ``attrs`` has what holds for the
        whole tour: its ``path``, ``length_m``, ``expected_bits`` and so on. ``start`` is x and y in metres; without it
        the tour starts at the charger. ``request`` has further fields of ``PlanTourRequest``.
        """
        tables.pandas_needed()
        asked = {"map": map, "time": self._text(map, time, zone), "count": count, **request}
        if start is not None:
            asked["start"] = dict(start) if isinstance(start, Mapping) else {"x_m": start[0], "y_m": start[1]}
        return tables.of_tour(self.call("ExplorationService/PlanTour", asked, zone=zone))

    def day(self, map: str, date: Any, **request: Any) -> pandas.DataFrame:
        """The slots in which to explore on a local day (``2026-01-05``), and the locations: ``slot, start, location,
        information_bits``.

        Where ``location`` is empty, the robot rests. The amount of exploration is set by ``explore`` (slots) or
        ``ratio``, fields of ``PlanDayRequest``, and needs one of them; ``request`` has further fields.
        """
        tables.pandas_needed()
        asked = {"map": map, "date": str(date)[:10], **request}
        return tables.of_day(self.call("ExplorationService/PlanDay", asked), self._zone(map))

    def _text(self, map: str, time: Time, zone: str | None) -> str:
        return _times.timestamp(self._moment(map, time, zone))
