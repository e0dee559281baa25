"""Messages of ROS as arrays, and arrays as messages' data.

Messages are only read by the names of their fields, so that nothing of ROS is needed here.

Invariant: cells have the axes y, x; -1 is not seen or not known, 0 free. Nothing is invented: a cell that no message
showed is -1.
"""

from __future__ import annotations

import array
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap_ros import poses
from tidemap_ros.poses import Pose

Points = npt.NDArray[np.float32]
Cells = npt.NDArray[np.int8]

FLOAT32, FLOAT64 = 7, 8
"""The numbers of the types in ``sensor_msgs/PointField``."""
OCCUPIED_PERCENT = 50
TABLE_CELLS_MAX = 1 << 25
CELLS_MAX = 1 << 26
"""Most cells of one grid, 8,192 by 8,192."""


class BadMessage(ValueError):
    """A message that contradicts itself, or lacks something."""


def ranges(scan: Any) -> Points:
    """The ranges of a LaserScan. As REP 117 has it, -inf (too near) is no reading."""
    found = np.array(scan.ranges, dtype=np.float32)
    found[found == -np.inf] = np.nan
    if not math.isfinite(scan.angle_min) or not math.isfinite(scan.angle_increment):
        raise BadMessage(f"a scan with the angles {scan.angle_min} and {scan.angle_increment}")
    return found


def points(cloud: Any) -> Points:
    """The finite points of a PointCloud2, rows x, y, z."""
    fields = {field.name: field for field in cloud.fields}
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise BadMessage(f"a cloud without the field {missing[0]}; it has {', '.join(fields) or 'none'}")
    order = ">" if cloud.is_bigendian else "<"
    types = {FLOAT32: f"{order}f4", FLOAT64: f"{order}f8"}
    for name in "xyz":
        if fields[name].datatype not in types:
            kind = fields[name].datatype
            raise BadMessage(f"the field {name} of a cloud has the type {kind}, not FLOAT32 or FLOAT64")
    height, width, step, row = int(cloud.height), int(cloud.width), int(cloud.point_step), int(cloud.row_step)
    if height * width == 0:
        return np.empty((0, 3), dtype=np.float32)
    raw = np.frombuffer(cloud.data, dtype=np.uint8)
    ends = max(fields[name].offset + (4 if fields[name].datatype == FLOAT32 else 8) for name in "xyz")
    if step < ends or row < width * step or raw.size < (height - 1) * row + width * step:
        raise BadMessage(f"a cloud of {height} x {width} points of {step} bytes in rows of {row} has {raw.size} bytes")
    offsets = [int(fields[name].offset) for name in "xyz"]
    kinds = [types[fields[name].datatype] for name in "xyz"]
    layout = np.dtype({"names": ["x", "y", "z"], "formats": kinds, "offsets": offsets, "itemsize": step})
    grid = np.ndarray((height, width), dtype=layout, buffer=raw.data, strides=(row, step))
    found = np.empty((height * width, 3), dtype=np.float32)
    for axis, name in enumerate("xyz"):
        found[:, axis] = grid[name].ravel()
    # A sum is finite only if all three numbers are, except for numbers that no sensor has.
    finite = np.isfinite(found.sum(axis=1))
    return found if finite.all() else found[finite]


def between_heights(xyz_m: Points, map_from_sensor: Pose, low_m: float, high_m: float) -> Points:
    """The points whose height in the map is between the two."""
    if low_m == -math.inf and high_m == math.inf:
        return xyz_m
    turn = poses.rotation(map_from_sensor)[2].astype(np.float32)
    heights = xyz_m @ turn + np.float32(map_from_sensor[2])
    kept: Points = xyz_m[(heights >= low_m) & (heights <= high_m)]
    return kept


def one_in_each_cell(
    xyz_m: Points, map_from_sensor: Pose, edge_m: float, origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Points:
    """The first point in each cell of this edge, in the map, whose cells begin at ``origin_m``.

    With the cells of the map the same cells are occupied as with all points, and fewer rays show that the way is free.
    """
    if len(xyz_m) == 0:
        return xyz_m
    # By axes: several times as fast as by rows.
    x, y, z = (xyz_m[:, axis].astype(np.float64) for axis in range(3))
    flat, whole = np.zeros(len(xyz_m), dtype=np.int64), 1
    for row, shift, origin in zip(poses.rotation(map_from_sensor), map_from_sensor[:3], origin_m):
        cells = np.floor((row[0] * x + row[1] * y + row[2] * z + (shift - origin)) / edge_m)
        low, size = cells.min(), int(cells.max() - cells.min()) + 1
        whole *= size
        if whole >= 2**63:
            return xyz_m
        flat *= size
        flat += (cells - low).astype(np.int64)
    if whole > TABLE_CELLS_MAX:
        _, first = np.unique(flat, return_index=True)
        return xyz_m[np.sort(first)]
    numbers = np.arange(len(flat), dtype=np.int32)
    # Only cells that are written here are read: if a cell has several points, the first one stays.
    table = np.empty(whole, dtype=np.int32)
    table[flat[::-1]] = numbers[::-1]
    kept: Points = xyz_m[table[flat] == numbers]
    return kept


def seen_cells(grid: Any) -> Cells:
    """The cells of an OccupancyGrid: -1 not seen, 0 free, 1 occupied (from 50 percent on)."""
    width, height = int(grid.info.width), int(grid.info.height)
    percent = np.frombuffer(grid.data, dtype=np.int8) if isinstance(grid.data, array.array) else np.array(
        grid.data, dtype=np.int8
    )
    if percent.size != width * height:
        raise BadMessage(f"a grid of {width} x {height} cells has {percent.size} values")
    if percent.size > CELLS_MAX:
        raise BadMessage(f"a grid of {width} x {height} cells; at most {CELLS_MAX} are taken")
    if not grid.info.resolution > 0:
        raise BadMessage(f"a grid with cells of {grid.info.resolution} m")
    cells = np.where(percent < 0, -1, percent >= OCCUPIED_PERCENT).astype(np.int8)
    return cells.reshape(height, width)


def percents(values: npt.NDArray[np.floating[Any]]) -> Cells:
    """Probabilities as 0 to 100, and -1 where nothing is known."""
    known = np.isfinite(values)
    found = np.full(values.shape, -1, dtype=np.int8)
    found[known] = np.rint(np.clip(values[known], 0, 1) * 100).astype(np.int8)
    return found


def three_values(values: npt.NDArray[np.floating[Any]], occupied_from: float, free_up_to: float) -> Cells:
    """Probabilities as a planner takes them: 100 occupied, 0 free, -1 between or not known."""
    found = np.full(values.shape, -1, dtype=np.int8)
    with np.errstate(invalid="ignore"):
        found[values <= free_up_to] = 0
        found[values >= occupied_from] = 100
    return found


def data_of(cells: Cells) -> array.array[int]:
    """The field ``data`` of an OccupancyGrid, row by row."""
    return array.array("b", np.ascontiguousarray(cells).tobytes())
