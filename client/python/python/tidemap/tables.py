"""Answers of the daemon as DataFrames of pandas.

Invariant: times are in the zone of the map and keep their nanoseconds; numbers are the numbers of the wire.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tidemap import reports
from tidemap import times as _times
from tidemap.errors import TidemapError

if TYPE_CHECKING:
    import pandas


def pandas_needed() -> Any:
    """The module pandas, or an error in words."""
    try:
        import pandas
    except ImportError as error:
        raise TidemapError(
            "this result is a DataFrame: install pandas (pip install pandas), or use call() and stream(), which give "
            "dictionaries", "FAILED_PRECONDITION",
        ) from error
    return pandas


def frame(data: Any, **options: Any) -> pandas.DataFrame:
    """A DataFrame of data."""
    made: pandas.DataFrame = pandas_needed().DataFrame(data, **options)
    return made


def zoned(nanos: Any, zone: str) -> Any:
    """Times as a DatetimeIndex in a zone."""
    pd = pandas_needed()
    index = pd.DatetimeIndex(np.asarray(nanos, dtype=np.int64).astype("datetime64[ns]")).tz_localize("UTC")
    if _times.is_utc(zone):
        return index
    try:
        return index.tz_convert(zone)
    except Exception:  # noqa: BLE001 the machine has no database of zones: pip install tzdata
        return index


def moments(texts: Sequence[str | None], zone: str) -> Any:
    """Timestamps of JSON as a DatetimeIndex in a zone; ``None`` is NaT."""
    least = np.iinfo(np.int64).min
    return zoned([least if not text else _times.from_timestamp(text) for text in texts], zone)


def _or(value: Any, otherwise: float) -> float:
    """A number of the wire, where it is given."""
    return otherwise if value is None else float(value)


def name_of(value: Any, prefix: str) -> str:
    """A value of an enum in lower case: ``STATE_KIND_COUNT`` is ``count``."""
    return str(value).removeprefix(prefix).lower().replace("_", "-")


def of_states(states: list[dict[str, Any]], zone: str) -> pandas.DataFrame:
    """States: a row each."""
    sensors = [state.get("sensor") or {} for state in states]
    said = [reports.of_state(state) for state in states]
    return frame({
        "state": [state["name"] for state in states],
        "kind": [name_of(state["kind"], "STATE_KIND_") for state in states],
        "observations": [state["observations"] for state in states],
        "order": [state["order"] for state in states],
        "pending": [state["pending"] for state in states],
        "last_time": moments([state.get("last_time") for state in states], zone),
        "hit": [_or(sensor.get("hit"), 1.0 if sensor else np.nan) for sensor in sensors],
        "false_alarm": [_or(sensor.get("false_alarm"), 0.0 if sensor else np.nan) for sensor in sensors],
        "reports": [one.kind for one in said],
        "hold_max": _durations([one.max_secs for one in said]),
        "hold_step": _durations([one.step_secs for one in said]),
        "labels": [state["labels"] for state in states],
    })


def _durations(secs: list[int | None]) -> npt.NDArray[np.timedelta64]:
    """Seconds as durations; ``None`` is NaT."""
    known = [np.timedelta64("NaT") if one is None else np.timedelta64(one, "s") for one in secs]
    return np.array(known, dtype="timedelta64[ns]")


def of_surprises(found: list[dict[str, Any]], zone: str) -> pandas.DataFrame:
    """Runs of unusual observations: a row each."""
    return frame({
        "from": moments([run["first_time"] for run in found], zone),
        "to": moments([run["last_time"] for run in found], zone),
        "state": [run["state"] for run in found],
        "observations": [run["observations"] for run in found],
        "surprise_bits": [run["bits"] for run in found],
        "above": [run["above"] for run in found],
        "value": [run["value"] for run in found],
        "probability": [run["probability"] for run in found],
    })


def of_series(times: Any, zone: str, **columns: Any) -> pandas.DataFrame:
    """A row a time."""
    return frame({"time": zoned(times, zone), **columns})


def of_routes(reply: dict[str, Any], zone: str) -> pandas.DataFrame:
    """Routes: a row for each edge; ``route`` 0 is the best. ``attrs`` has what holds for whole routes."""
    steps = [
        (number, place, step) for number, route in enumerate(reply["routes"])
        for place, step in enumerate(route["steps"], start=1)
    ]
    table = frame({
        "route": [number for number, _, _ in steps],
        "step": [place for _, place, _ in steps],
        "from": [step["edge"]["from"] for _, _, step in steps],
        "to": [step["edge"]["to"] for _, _, step in steps],
        "action": [step["edge"]["action"] for _, _, step in steps],
        "time": zoned([step["start_nanos"] for _, _, step in steps], zone),
        "probability": [step["success"] for _, _, step in steps],
        "lower": [step["success_lower"] for _, _, step in steps],
        "upper": [step["success_upper"] for _, _, step in steps],
        "duration_secs": [step["duration_secs"] for _, _, step in steps],
        "reports": [step["reports"] for _, _, step in steps],
    })
    whole = ("success", "success_lower", "success_upper", "expected_secs", "cost")
    table.attrs["routes"] = [
        {**{name: route[name] for name in whole}, "departure": zoned([route["departure_nanos"]], zone)[0],
         "arrival": zoned([route["arrival_nanos"]], zone)[0]}
        for route in reply["routes"]
    ]
    table.attrs["certainty"] = name_of(reply["certainty"], "ROUTE_CERTAINTY_")
    return table


_ACTIONS = {"edge": "take", "none": "nothing"}


def of_policy(reply: dict[str, Any], zone: str) -> pandas.DataFrame:
    """A policy: a row for each node and slot."""
    begin = _times.from_timestamp(reply["start_time"])
    step, slots = round(float(reply["slot"].removesuffix("s")) * _times.SECOND), reply["slots"]
    entries = [entry for node in reply["nodes"] for entry in _entries(node)]
    return frame({
        "slot": zoned(np.tile(begin + step * np.arange(slots), len(reply["nodes"])), zone),
        "node": np.repeat(np.array([node["node"] for node in reply["nodes"]], dtype=object), slots),
        **dict(zip(("next", "action", "expected_secs", "probability"), zip(*entries) if entries else [[]] * 4)),
    })


def _entries(node: dict[str, Any]) -> Iterator[tuple[str | None, str, float, float]]:
    """The actions at a node in each slot: the next node, the action, seconds and probability."""
    for action, place, secs, reach in zip(node["actions"], node["edge_indices"], node["expected_secs"], node["reach"]):
        word = name_of(action, "POLICY_ACTION_")
        edge = node["edges"][place] if word == "edge" else {}
        word = ":".join([_ACTIONS.get(word, word), *filter(None, [edge.get("action")])])
        yield edge.get("to"), word, float(secs), float(reach)


def of_search(reply: dict[str, Any]) -> pandas.DataFrame:
    """A search: a row for each place to search."""
    steps = reply["steps"]
    table = frame({
        "step": np.arange(1, len(steps) + 1),
        **{name: [step[name] for step in steps] for name in ("node", "arrival_secs", "probability")},
    })
    table.attrs.update({name: value for name, value in reply.items() if name != "steps"})
    return table


def of_tour(reply: dict[str, Any]) -> pandas.DataFrame:
    """A tour: a row for each viewpoint."""
    steps = reply["steps"]
    places = [step.get("at") or {} for step in steps]
    table = frame({
        "step": np.arange(1, len(steps) + 1),
        **{axis: [float(place.get(f"{axis}_m", 0.0)) for place in places] for axis in ("x", "y")},
        **{
            name: [float(step[name]) for step in steps]
            for name in ("information_bits", "reachability", "arrival_secs")
        },
    })
    table.attrs.update({name: value for name, value in reply.items() if name not in ("steps", "path")})
    table.attrs["path"] = [(float(point.get("x_m", 0.0)), float(point.get("y_m", 0.0))) for point in reply["path"]]
    return table


def of_day(reply: dict[str, Any], zone: str) -> pandas.DataFrame:
    """A day of exploration: a row a slot."""
    slots = reply["slots"]
    return frame({
        "slot": np.arange(1, len(slots) + 1),
        "start": zoned([slot["start_nanos"] for slot in slots], zone),
        "location": [slot["location"] for slot in slots],
        "information_bits": [float(slot["information_bits"]) for slot in slots],
    })


def of_planned(
    steps: list[dict[str, Any]], zone: str, words: Sequence[str], numbers: Sequence[str]
) -> pandas.DataFrame:
    """Steps of a plan: a row a step."""
    times = {name: zoned([step[f"{name}_nanos"] for step in steps], zone) for name in ("departure", "start", "end")}
    return frame({
        **{name: [step[name] for step in steps] for name in words},
        **times,
        **{name: [float(step[name]) for step in steps] for name in numbers},
    })


def of_information(
    replies: list[dict[str, Any]], times: npt.NDArray[np.int64], zone: str
) -> pandas.DataFrame:
    """The information gain of observations: a row for each target and time."""
    return frame({
        "time": zoned(np.tile(times, len(replies)), zone),
        "target": np.repeat(np.array([reply["target"] for reply in replies], dtype=object), len(times)),
        **{
            name: np.array([number for reply in replies for number in reply[name]], dtype=np.float64)
            for name in ("information_bits", "entropy_bits")
        },
    })


def of_nodes(nodes: list[dict[str, Any]]) -> pandas.DataFrame:
    """Nodes of a topology: a row each."""
    poses = [node.get("pose") or {} for node in nodes]
    return frame({
        "name": [node["name"] for node in nodes],
        **{axis: [_or(pose.get(axis), np.nan) for pose in poses] for axis in ("x_m", "y_m", "yaw_rad")},
        "dwell_secs": [_or(node.get("dwell_secs"), 0.0) for node in nodes],
    })


def of_edges(edges: list[dict[str, Any]]) -> pandas.DataFrame:
    """Edges of a topology: a row each direction."""
    return frame({
        **{name: [edge["ends"][name] for edge in edges] for name in ("from", "to", "action")},
        **{name: [_or(edge.get(name), np.nan) for edge in edges] for name in ("length_m", "nominal_secs")},
    })


def of_flows(
    header: dict[str, Any], cells: list[dict[str, Any]], times: npt.NDArray[np.int64], zone: str
) -> pandas.DataFrame:
    """Flows: a row for each cell of each time, ascending by cell; coordinates are middles of cells, metres."""
    (low_x, low_y), edge_m = header["low_m"], header["resolution_m"]
    width, directions = header["counts"][0], header["directions"]
    indices = np.concatenate([np.zeros(0, np.int64), *(np.asarray(piece["indices"], np.int64) for piece in cells)])
    shares = np.concatenate([np.zeros(0), *(np.asarray(piece["shares"], float) for piece in cells)])
    shares = shares.reshape(-1, directions)
    counts = np.concatenate([np.zeros(0), *(np.asarray(piece["expected_counts"], float) for piece in cells)])
    lengths = [len(piece["indices"]) for piece in cells]
    likeliest = shares.argmax(axis=1)
    turns = likeliest / directions
    return frame({
        "time": zoned(np.repeat([times[piece["time_index"]] for piece in cells], lengths), zone),
        "x": low_x + (indices % width + 0.5) * edge_m,
        "y": low_y + (indices // width + 0.5) * edge_m,
        "expected_count": counts,
        "direction_rad": 2 * np.pi * np.where(turns < 0.5, turns, turns - 1),
        "share": shares[np.arange(len(shares)), likeliest],
    })


def of_positions(
    header: dict[str, Any], cells: list[dict[str, Any]], times: npt.NDArray[np.int64], zone: str
) -> pandas.DataFrame:
    """Positions: a row for each cell of each time, the most probable first; coordinates are middles of cells, metres.
    """
    counts, low_m, edge_m = header["counts"], header["low_m"], header["resolution_m"]
    axes = ["x", "y", "z"][: len(counts)]
    empty = [np.zeros(0, dtype=np.int64)]
    indices = np.concatenate([np.asarray(piece["indices"], dtype=np.int64) for piece in cells] or empty)
    lengths = [len(piece["indices"]) for piece in cells]
    table: dict[str, Any] = {"time": zoned(np.repeat([times[piece["time_index"]] for piece in cells], lengths), zone)}
    rest = indices
    for axis, count, low in zip(axes, counts, low_m):
        table[axis] = low + (rest % count + 0.5) * edge_m
        rest = rest // count
    table["probability"] = np.concatenate([np.asarray(piece["probabilities"]) for piece in cells] or empty)
    first = {piece["time_index"]: piece for piece in reversed(cells)}
    for place, axis in enumerate(axes):
        expected = [first[piece["time_index"]]["expected_m"][place] for piece in cells]
        table[f"expected_{axis}"] = np.repeat(expected, lengths)
    for name in ("outside", "expected_count"):
        table[name] = np.repeat([first[piece["time_index"]][name] for piece in cells], lengths)
    return frame(table)
