"""Observations of a robot, as the node takes them: with the pose of the sensor, ready to be sent.

Invariant: a record has all data that sending needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np
import numpy.typing as npt

from tidemap_ros.poses import Pose


@dataclass(frozen=True)
class MapGrid:
    """The cells of the map."""

    resolution_m: float
    origin_m: tuple[float, float, float]


@dataclass(frozen=True)
class Value:
    """A value of a named state."""

    state: str
    time_nanos: int
    value: float


@dataclass(frozen=True)
class Ranges:
    """A scan of a planar range finder."""

    time_nanos: int
    pose: Pose
    frame_id: str
    angle_min_rad: float
    angle_increment_rad: float
    min_range_m: float
    max_range_m: float
    free_range_m: float
    trusted_range_m: float
    ranges_m: npt.NDArray[np.float32]


@dataclass(frozen=True)
class Cloud:
    """Points x, y, z in the frame of the sensor."""

    time_nanos: int
    pose: Pose
    frame_id: str
    min_range_m: float
    max_range_m: float
    xyz_m: npt.NDArray[np.float32]


@dataclass(frozen=True)
class Picture:
    """A grid: rows of cells, where -1 is not seen, 0 is free and 1 is occupied; ``pose`` is the pose of its corner."""

    time_nanos: int
    pose: Pose
    resolution_m: float
    cells: npt.NDArray[np.int8]


@dataclass(frozen=True)
class Traversal:
    """An edge that was driven, or tried."""

    from_node: str
    to_node: str
    start_nanos: int
    end_nanos: int
    success: bool
    action: str = ""
    reason: str = ""


Record = Union[Value, Ranges, Cloud, Picture, Traversal]


def time_of(record: Record) -> int:
    """The observation time of a record, nanoseconds since 1970."""
    return record.start_nanos if isinstance(record, Traversal) else record.time_nanos
