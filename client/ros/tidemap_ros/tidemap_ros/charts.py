"""The map at a time, in a region that does not change.

Invariant: all charts of one node have the same cells, even if more was observed since. Rows go up, columns to the
right, as in ``nav_msgs/OccupancyGrid``.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap_ros import arrays, clock_words
from tidemap_ros.parameters import Settings
from tidemap_ros.records import MapGrid

Floats = npt.NDArray[np.float64]

_ALL_LAYERS = (-(1 << 20), 1 << 20)


class NoMap(Exception):
    """There is nothing to show yet; the message states why."""


def moment(words: str, now_nanos: int) -> int:
    """The time of words such as ``+2h``, nanoseconds. ``now_nanos`` is 0 before the first time on ``/clock``."""
    if now_nanos == 0 and clock_words.needs_now(words):
        # Until then ROS time is in 1970, for which no user wants a map.
        raise NoMap("there is no time yet: use_sim_time is set, and nothing has come on /clock")
    return clock_words.nanos(words, now_nanos)


@dataclass(frozen=True)
class Region:
    """Cells of the map: from the first index up to, but not including, the last."""

    min_x: int
    min_y: int
    max_x: int
    max_y: int
    resolution_m: float
    origin_m: tuple[float, float]
    """Lower corner of the cell with the index 0, 0."""

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.max_x - self.min_x

    @property
    def height(self) -> int:
        """Number of rows."""
        return self.max_y - self.min_y

    @property
    def corner_m(self) -> tuple[float, float]:
        """Lower corner of the first cell, metres."""
        return (
            self.origin_m[0] + self.min_x * self.resolution_m,
            self.origin_m[1] + self.min_y * self.resolution_m,
        )


def grid_of(known: dict[str, Any]) -> MapGrid | None:
    """The grid of a map, as ``GetMap`` describes it."""
    grid = known.get("grid")
    if not grid:
        return None
    origin = tuple(float(grid.get(f"origin_{axis}_m", 0.0)) for axis in "xyz")
    return MapGrid(float(grid["resolution_m"]), (origin[0], origin[1], origin[2]))


def region_of(settings: Settings, known: dict[str, Any]) -> Region:
    """The region of the parameter ``map_region``, or the region that the map has now."""
    grid = grid_of(known)
    if grid is None:
        raise NoMap(f"the map {settings.text('map')} has no grid")
    edge, origin = grid.resolution_m, (grid.origin_m[0], grid.origin_m[1])
    box = settings.numbers("map_region")
    if box:
        low = [math.floor((box[axis] - origin[axis]) / edge + 1e-6) for axis in (0, 1)]
        high = [math.ceil((box[axis + 2] - origin[axis]) / edge - 1e-6) for axis in (0, 1)]
    else:
        shown = (known.get("grid_summary") or {}).get("region")
        if not shown:
            raise NoMap(f"nothing of the map {settings.text('map')} was observed yet, and map_region is not set")
        low = [int(shown.get(f"min_{axis}", 0)) for axis in "xy"]
        high = [int(shown.get(f"max_{axis}", 0)) for axis in "xy"]
    found = Region(low[0], low[1], max(high[0], low[0] + 1), max(high[1], low[1] + 1), edge, origin)
    if found.width * found.height > arrays.CELLS_MAX:
        raise NoMap(f"the region has {found.width} x {found.height} cells; at most {arrays.CELLS_MAX} are shown")
    return found


class Charts:
    """Requests the map at given times from the daemon. ``client`` is a client of ``tidemap``."""

    def __init__(self, settings: Settings, client: Callable[[], Any]) -> None:
        self._settings = settings
        self._client = client
        self._lock = threading.Lock()
        self._region: Region | None = None
        self._layers: tuple[int, int] | None = None
        self.grown_beyond = False
        """Whether the map has cells outside the region, which are not shown."""

    @property
    def region(self) -> Region:
        """The region of all charts; raises :class:`NoMap` while there is none."""
        with self._lock:
            if self._region is None:
                known = self._client().call("MapService/GetMap", {"name": self._settings.text("map")})["map"]
                self._region = region_of(self._settings, known)
                self._layers = self._layers_of(known)
            return self._region

    def _layers_of(self, known: dict[str, Any]) -> tuple[int, int] | None:
        heights = self._settings.numbers("map_heights")
        grid = grid_of(known)
        if not heights or grid is None or (known.get("grid") or {}).get("flat"):
            return None
        low = math.floor((heights[0] - grid.origin_m[2]) / grid.resolution_m + 1e-6)
        high = math.ceil((heights[1] - grid.origin_m[2]) / grid.resolution_m - 1e-6)
        return low, max(high, low + 1)

    def values(self, nanos: int, output: str) -> Floats:
        """``probability`` or ``entropy`` (bits) of each cell of the region; NaN where nothing was observed."""
        region = self.region
        low, high = self._layers or _ALL_LAYERS
        asked = (region.min_x, region.min_y, low, region.max_x, region.max_y, high)
        options = {"output": output, "region": asked, "project": True}
        name, model = self._settings.text("map"), self._settings.text("model")
        found = self._client().grid(name, clock_words.stated(nanos), model=model, **options)
        if model == "auto" and found.generation == 0:
            # Nothing is learned before the first nightly update; the newest observations are better than nothing.
            found = self._client().grid(name, clock_words.stated(nanos), model="latest", **options)
        layer = np.asarray(found.values[0], dtype=np.float64)
        if layer.shape != (region.height, region.width):
            raise NoMap(f"the daemon gave {layer.shape} cells where {(region.height, region.width)} were requested")
        return layer

    def cells(self, nanos: int, output: str) -> arrays.Cells:
        """The map at a time as an OccupancyGrid has it; ``output`` is a value of the parameter ``map_output``."""
        if output == "three_values":
            limits = self._settings.number("occupied_from"), self._settings.number("free_up_to")
            return arrays.three_values(self.values(nanos, "probability"), *limits)
        return arrays.percents(self.values(nanos, output))

    def people(self, nanos: int) -> Floats:
        """The expected number of people in each cell of the region in the hour around a time."""
        region = self.region
        low = region.corner_m
        high = low[0] + region.width * region.resolution_m, low[1] + region.height * region.resolution_m
        source = {
            "state": self._settings.text("people_state"), "motion_state": self._settings.text("people_motion"),
            "region": {"low_m": list(low), "high_m": list(high)},
        }
        asked = {"map": self._settings.text("map"), "times_nanos": [nanos], "source": source}
        header: dict[str, Any] = {}
        counts: dict[int, float] = {}
        for reply in self._client().stream("QueryService/PredictFlow", asked):
            if reply.get("header"):
                header = reply["header"]
            elif reply.get("cells"):
                take_flow(reply["cells"], counts)
        return spread(header, counts, region)

    def check_growth(self) -> None:
        """Checks whether the map has outgrown the region."""
        region = self.region
        known = self._client().call("MapService/GetMap", {"name": self._settings.text("map")})["map"]
        shown = (known.get("grid_summary") or {}).get("region") or {}
        self.grown_beyond = bool(shown) and not self._settings.numbers("map_region") and (
            int(shown.get("min_x", 0)) < region.min_x or int(shown.get("min_y", 0)) < region.min_y
            or int(shown.get("max_x", 0)) > region.max_x or int(shown.get("max_y", 0)) > region.max_y
        )


def take_flow(cells: dict[str, Any], into: dict[int, float]) -> None:
    """The expected counts of one page of ``PredictFlow``, by the number of the cell."""
    for index, count in zip(cells["indices"], cells["expected_counts"]):
        into[int(index)] = float(count)


def spread(header: dict[str, Any], counts: dict[int, float], region: Region) -> Floats:
    """Counts of the raster of flows in the cells of a region: each cell has the count of the raster's cell it lies in,
    and 0 where nobody was ever seen.
    """
    found = np.zeros((region.height, region.width))
    if not header or not counts:
        return found
    columns, rows = (int(count) for count in header["counts"][:2])
    edge = float(header["resolution_m"])
    cells = np.zeros(columns * rows)
    cells[list(counts)] = list(counts.values())
    raster = cells.reshape(rows, columns)
    half = region.resolution_m / 2
    at = [
        np.floor((corner + half + np.arange(count) * region.resolution_m - float(low)) / edge).astype(np.int64)
        for corner, count, low in zip(region.corner_m, (region.width, region.height), header["low_m"])
    ]
    inside = [(index >= 0) & (index < size) for index, size in zip(at, (columns, rows))]
    picked = raster[np.ix_(at[1][inside[1]], at[0][inside[0]])]
    found[np.ix_(inside[1], inside[0])] = picked
    return found
