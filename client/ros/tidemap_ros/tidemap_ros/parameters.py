"""The parameters of the node: name, default, unit and meaning. The table in README.md is made from this one.

Invariant: every parameter that the node reads is in the table, and has been checked when the node starts.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Union

_BEGIN, _END = "<!-- parameters -->", "<!-- end of parameters -->"

Setting = Union[str, bool, int, float, list[str], list[float]]


class BadParameter(ValueError):
    """A parameter that the node cannot work with; the message states what to do."""


@dataclass(frozen=True)
class Parameter:
    """One parameter."""

    name: str
    default: Setting
    meaning: str
    group: str
    least: float | None = None
    choices: tuple[str, ...] = ()


def _table() -> tuple[Parameter, ...]:
    found: list[Parameter] = []
    group = ""

    def add(
        name: str, default: Setting, meaning: str, least: float | None = None, choices: tuple[str, ...] = ()
    ) -> None:
        found.append(Parameter(name, default, meaning, group, least, choices))

    group = "The daemon and the map"
    add("server", "127.0.0.1:7435", "the daemon: `HOST:PORT`, `https://HOST:PORT` or `unix:PATH`")
    add("token_file", "", "file with the token; empty: none")
    add("ca_file", "", "file with the certificate that the daemon's is checked by; empty: the system's")
    add("certificate_file", "", "file with the certificate of this client; empty: none")
    add("key_file", "", "file with the key of that certificate")
    add("map", "office", "name of the map")
    add("producer", "", "name of the producer; empty: the name of this machine. Each robot needs one of its own")
    add("label", "ros", "name of the sequence of this producer")
    add("map_frame", "map", "tf frame of the map; the daemon refuses observations in another frame than its map's")
    add("create_map", False, "whether the node creates the map if the daemon has none of that name")
    add("resolution", 0.05, "edge of a cell of a map that the node creates, metres", 0.001)
    add("flat", True, "whether a map that the node creates has one layer of cells, as for a planar scanner")
    add("time_zone", "UTC", "time zone of the people there, of a map that the node creates, such as `Europe/Prague`")

    group = "Storage until the daemon has the data"
    add("spool_dir", "", "folder; empty: `$ROS_HOME/tidemap`, or `~/.ros/tidemap`")
    add("spool_megabytes", 1024, "size of all its files; new observations are refused when it is full", 1)
    add("spool_sync_seconds", 1.0, "seconds between two times at which written data is forced to the disk", 0.05)

    group = "Observations"
    add("scan_topics", ["scan"], "topics of `sensor_msgs/LaserScan`")
    add("cloud_topics", [], "topics of `sensor_msgs/PointCloud2`")
    add("grid_topics", [], "topics of `nav_msgs/OccupancyGrid`, such as the map of a SLAM")
    add("observe_topic", "~/observe", "topic of `std_msgs/String` with values of states, as JSON; empty: none")
    add("door_topics", [], "topics of `rmf_door_msgs/DoorState`, where that package is installed")
    add("scan_period", 0.0, "seconds between two scans that are taken from a topic; 0: all", 0)
    add("cloud_period", 0.0, "seconds between two clouds that are taken from a topic; 0: all", 0)
    add("grid_period", 0.0, "seconds between two grids that are taken from a topic; 0: all", 0)
    add("door_period", 60.0, "seconds between two readings of a door that stays as it is; a change is taken at once", 0)
    add("reliable", False, "whether lost scans and clouds are requested again; their sender must be "
        "reliable, too")
    add("queue_depth", 20, "messages of a topic that wait", 1)
    add("min_range", 0.0, "nearer readings are ignored, metres; those of a scan's own `range_min` always", 0)
    add("max_range", 0.0, "farther readings only show that the way is free up to here, metres; 0: `range_max` of the "
        "scan, and of clouds the limit of the daemon", 0)
    add("free_range", 0.0, "beams of scans without a return show that the way is free up to here, metres; 0: they show "
        "nothing, because dark, shiny and distant surfaces return nothing either", 0)
    add("cloud_min_height", -1e9, "points of clouds below this height in the map are left out, metres")
    add("cloud_max_height", 1e9, "points of clouds above this height in the map are left out, metres")
    add("cloud_cell", 0.0, "one point of a cloud is sent from each cube of this edge, metres; 0: in a cell of the "
        "map, so that the same cells are occupied; negative: all points")

    group = "tf"
    add("tf_wait", 1.0, "seconds that an observation waits for its transform before it is left out, and counted", 0)
    add("tf_tolerance", 0.0, "seconds by which a transform may be older than the observation", 0)
    add("tf_kept", 30.0, "seconds of transforms that are kept", 0.1)
    add("transform_topics", [], "topics of `geometry_msgs/TransformStamped`, besides `/tf` and `/tf_static`")

    group = "The map at a time"
    add("map_topic", "/map", "topic of the latched `nav_msgs/OccupancyGrid`; empty: none")
    add("map_time", "now", "the time that it shows: `now`, `+2h`, `-1d`, or `2026-01-05T12:00:00Z`")
    add("map_period", 60.0, "seconds between two maps", 0.1)
    add("map_output", "three_values", "`three_values`: 100, 0 or -1, as planners need it; `probability`: 0 to 100; "
        "`entropy`: 0 to 100", None, ("three_values", "probability", "entropy"))
    add("occupied_from", 0.65, "with `three_values`: probability from which a cell is occupied", 0)
    add("free_up_to", 0.25, "with `three_values`: probability up to which a cell is free", 0)
    add("map_region", [], "x, y of the lower and of the upper corner, metres; empty: the extent of the map when the "
        "node starts, which does not change after that")
    add("map_heights", [], "lowest and highest height that counts, metres; empty: all. Of flat maps it is ignored")
    add("model", "auto", "model that predicts; `auto` shows the newest readings until the first nightly update; with "
        "`auto+memory` readings since the last update count, too")

    group = "Masks for Nav2's costmap filters"
    add("keepout_source", "", "source of the mask that keeps robots out: `occupancy`, `entropy` or `people`; empty: no "
        "mask", None, ("", "occupancy", "entropy", "people"))
    add("keepout_from", 0.5, "value of the source from which a cell is kept out of: probability, bits, or people", 0)
    add("speed_source", "", "source of the mask that slows robots down: `occupancy`, `entropy` or `people`; empty: no "
        "mask", None, ("", "occupancy", "entropy", "people"))
    add("speed_full_at", 1.0, "value of the source at which robots are slowest", 1e-9)
    add("speed_slowest", 20.0, "percent of their speed at which robots then drive, 1 to 100", 1)
    add("people_state", "people", "state with the positions of people")
    add("people_motion", "people_velocity", "state with their directions or velocities")
    add("mask_period", 60.0, "seconds between two masks", 0.1)

    group = "Topology"
    add("markers_topic", "~/topology", "latched topic of `visualization_msgs/MarkerArray`; empty: none")
    add("markers_period", 60.0, "seconds between two of them", 0.1)
    add("traverse_topic", "~/traverse", "topic of `std_msgs/String` with traversals, as JSON; empty: none")
    add("route_action", "", "Nav2's route action, such as `/compute_and_track_route`; its feedback becomes traversals")
    add("statistics_topic", "", "topic of topological_navigation's `NavStatistics`")
    add("route_graph", "", "Nav2's route graph, a GeoJSON file: gives its edges' numbers; needed by the two below")
    add("route_match", 0.5, "metres within which a node of the graph without a name is a node of the topology", 0)
    add("dynamic_edges", "", "Nav2's service, such as `/route_server/DynamicEdgesScorer/adjust_edges`; empty: none")
    add("edges_period", 60.0, "seconds between two calls of it", 0.1)
    add("edge_closed_below", 0.2, "probability of success below which an edge is closed", 0)

    group = "Actions of fremenserver and frenap, with ROS 1 only"
    add("fremen_action", "", "name of the action that works as fremenserver does, `/fremenserver` for its clients; "
        "empty: none")
    add("fremen_detect", True, "whether clients have the operation `detect`, as the newest definition of "
        "fremenserver has it; ignored where the package `fremenserver` is installed, whose definition counts")
    add("fremen_learn_period", 0.0, "seconds between two updates of the map that a prediction starts because readings "
        "of its state were added; 0: every such prediction starts one", 0)
    add("prediction_action", "", "name of the action that works as frenap does, `/FreNaP` for its clients; empty: "
        "none")

    group = "Diagnostics"
    add("diagnostics_period", 1.0, "seconds between two messages on `/diagnostics`", 0.1)
    return tuple(found)


TABLE = _table()
_BY_NAME = {parameter.name: parameter for parameter in TABLE}


def checked(name: str, value: Any) -> Setting:
    """The value of a parameter in its type; raises :class:`BadParameter`."""
    known = _BY_NAME[name]
    default = known.default
    if isinstance(default, list):
        return _checked_list(known, value)
    if isinstance(default, bool) or isinstance(value, bool):
        if isinstance(default, bool) and isinstance(value, bool):
            return value
        raise BadParameter(f"the parameter {name} is {value!r}: use {_kind(default)}")
    if isinstance(default, str):
        if not isinstance(value, str):
            raise BadParameter(f"the parameter {name} is {value!r}: use a text")
        if known.choices and value not in known.choices:
            choices = ", ".join(choice or "an empty text" for choice in known.choices)
            raise BadParameter(f"the parameter {name} is {value!r}: use one of {choices}")
        return value
    if not isinstance(value, (int, float)) or (isinstance(default, int) and value != int(value)):
        raise BadParameter(f"the parameter {name} is {value!r}: use {_kind(default)}")
    number: int | float = int(value) if isinstance(default, int) else float(value)
    if number != number or (known.least is not None and number < known.least):
        raise BadParameter(f"the parameter {name} is {value!r}: use a number of at least {known.least}")
    return number


def _kind(default: Setting) -> str:
    if isinstance(default, bool):
        return "true or false"
    return "a whole number" if isinstance(default, int) else "a number"


def _checked_list(known: Parameter, value: Any) -> Setting:
    items = [value] if isinstance(value, str) else list(value) if value is not None else []
    # An empty list cannot be written in every launch file; [""] can.
    items = [item for item in items if item != ""]
    if known.name in ("map_region", "map_heights"):
        count = 4 if known.name == "map_region" else 2
        if len(items) not in (0, count) or any(isinstance(item, (str, bool)) for item in items):
            raise BadParameter(f"the parameter {known.name} is {items!r}: use {count} numbers, or none")
        numbers = [float(item) for item in items]
        if any(low >= high for low, high in zip(numbers[: count // 2], numbers[count // 2 :])):
            raise BadParameter(f"the parameter {known.name} is {items!r}: the lower corner comes first")
        return numbers
    if any(not isinstance(item, str) for item in items):
        raise BadParameter(f"the parameter {known.name} is {items!r}: use texts")
    return items


class Settings:
    """The parameters as attributes: ``settings["map_period"]`` with its type by the typed accessors."""

    def __init__(self, values: dict[str, Any]) -> None:
        self._values = {known.name: checked(known.name, values.get(known.name, known.default)) for known in TABLE}
        if self.number("free_up_to") >= self.number("occupied_from"):
            raise BadParameter(
                f"free_up_to is {self.number('free_up_to')}, which is not below occupied_from, "
                f"{self.number('occupied_from')}"
            )
        if self.number("speed_slowest") > 100:
            raise BadParameter(f"speed_slowest is {self.number('speed_slowest')}: use 1 to 100 percent")
        for name in ("dynamic_edges", "route_action"):
            if self.text(name) and not self.text("route_graph"):
                raise BadParameter(f"{name} needs the parameter route_graph")

    def text(self, name: str) -> str:
        """A text."""
        return str(self._values[name])

    def number(self, name: str) -> float:
        """A number."""
        value = self._values[name]
        assert isinstance(value, (int, float))
        return float(value)

    def flag(self, name: str) -> bool:
        """Whether the flag is set."""
        return bool(self._values[name])

    def texts(self, name: str) -> list[str]:
        """A list of texts."""
        value = self._values[name]
        return [str(item) for item in value] if isinstance(value, list) else []

    def numbers(self, name: str) -> list[float]:
        """A list of numbers."""
        value = self._values[name]
        return [float(item) for item in value] if isinstance(value, list) else []

    def spool_folder(self, producer: str) -> Path:
        """The folder of the spool of this map, producer and label."""
        home = os.environ.get("ROS_HOME") or str(Path.home() / ".ros")
        base = Path(self.text("spool_dir") or str(Path(home) / "tidemap"))
        return base / "_".join(_plain(part) for part in (self.text("map"), producer, self.text("label")))


def _plain(name: str) -> str:
    """A name as part of a path; different names stay different."""
    return "".join(
        letter if letter.isascii() and (letter.isalnum() or letter in "-.") else f"%{ord(letter):x}%" for letter in name
    )


def markdown() -> str:
    """The table of all parameters."""
    lines: list[str] = []
    for group in dict.fromkeys(parameter.group for parameter in TABLE):
        lines += [f"### {group}", "", "| parameter | default | meaning |", "| --- | --- | --- |"]
        for parameter in TABLE:
            if parameter.group == group:
                default = str(parameter.default).lower() if isinstance(parameter.default, bool) else parameter.default
                shown = f'"{default}"' if isinstance(parameter.default, str) else f"{default}"
                lines.append(f"| `{parameter.name}` | `{shown}` | {parameter.meaning} |")
        lines.append("")
    return "\n".join(lines)


def write_into(path: Path) -> None:
    """Puts the table into a file between its two marks."""
    text = path.read_text()
    before, _, rest = text.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    path.write_text(f"{before}{_BEGIN}\n\n{markdown()}\n{_END}{after}")


if __name__ == "__main__":
    import sys

    write_into(Path(sys.argv[1]))
