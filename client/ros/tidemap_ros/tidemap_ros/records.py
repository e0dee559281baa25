"""Observations of a robot as bytes: the records of the spool.

Invariant: ``decoded(encoded(x)) == x``. A record has all data that sending needs; the same record is sent as the same
bytes on any day.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import asdict, dataclass
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from tidemap_ros.poses import Pose

_HEAD = struct.Struct("<BI")
VERSION = 1


class BadRecord(ValueError):
    """Bytes that are no record of this version."""


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
    frame_id: str
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
_KINDS: tuple[type[Any], ...] = (Value, Ranges, Cloud, Picture, Traversal)
_ARRAYS = {Ranges: "ranges_m", Cloud: "xyz_m", Picture: "cells"}


def encoded(record: Record) -> bytes:
    """The bytes of a record."""
    kind = type(record)
    name = _ARRAYS.get(kind)
    if name is None:
        fields, blob = asdict(record), b""
    else:
        fields = {key: value for key, value in vars(record).items() if key != name}
        array = getattr(record, name)
        if kind is Picture:
            fields["shape"] = list(array.shape)
            blob = zlib.compress(np.ascontiguousarray(array, dtype=np.int8).tobytes(), 1)
        else:
            blob = np.ascontiguousarray(array, dtype="<f4").tobytes()
    text = json.dumps(fields, ensure_ascii=False, allow_nan=True).encode()
    return _HEAD.pack(_KINDS.index(kind) | VERSION << 4, len(text)) + text + blob


def decoded(raw: bytes) -> Record:
    """The record of bytes that :func:`encoded` has made."""
    try:
        tag, length = _HEAD.unpack_from(raw)
        kind = _KINDS[tag & 0xF]
        fields = json.loads(raw[_HEAD.size : _HEAD.size + length])
        blob = memoryview(raw)[_HEAD.size + length :]
        if tag >> 4 != VERSION:
            raise BadRecord(f"a record of version {tag >> 4}; this program reads {VERSION}")
        if "pose" in fields:
            fields["pose"] = tuple(fields["pose"])
        if kind is Picture:
            cells = np.frombuffer(zlib.decompress(blob), dtype=np.int8)
            fields["cells"] = cells.reshape(fields.pop("shape"))
        elif kind is Cloud:
            fields["xyz_m"] = np.frombuffer(blob, dtype="<f4").reshape(-1, 3)
        elif kind is Ranges:
            fields["ranges_m"] = np.frombuffer(blob, dtype="<f4")
        record: Record = kind(**fields)
        return record
    except BadRecord:
        raise
    except (struct.error, IndexError, KeyError, TypeError, ValueError, zlib.error) as error:
        raise BadRecord(f"{len(raw)} bytes are no record: {error}") from None


def time_of(record: Record) -> int:
    """The observation time of a record, nanoseconds since 1970."""
    return record.start_nanos if isinstance(record, Traversal) else record.time_nanos
