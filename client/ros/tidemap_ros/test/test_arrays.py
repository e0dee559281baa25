"""Messages as arrays, with stand-ins for the messages."""

from __future__ import annotations

import array
import math
from types import SimpleNamespace as Message

import numpy as np
import pytest

from tidemap_ros import arrays, masks, poses
from tidemap_ros.charts import Region, spread, take_flow


def cloud(points: np.ndarray, *, step: int = 16, height: int = 1, padding: int = 0, big: bool = False, kind: int = 7):
    """A PointCloud2 of these points."""
    width = len(points) // height
    row = width * step + padding
    raw = np.zeros((height, row), dtype=np.uint8)
    dtype = np.dtype(f"{'>' if big else '<'}f{4 if kind == 7 else 8}")
    for at, point in enumerate(points):
        place = at % width * step
        bytes_of = np.frombuffer(np.asarray(point, dtype=dtype).tobytes(), dtype=np.uint8)
        raw[at // width, place : place + len(bytes_of)] = bytes_of
    fields = [Message(name=name, offset=axis * dtype.itemsize, datatype=kind) for axis, name in enumerate("xyz")]
    return Message(
        fields=fields, is_bigendian=big, height=height, width=width, point_step=step, row_step=row,
        data=array.array("B", raw.tobytes()),
    )


POINTS = np.arange(18, dtype=np.float32).reshape(6, 3)


@pytest.mark.parametrize("layout", [
    {}, {"height": 2, "padding": 12}, {"big": True}, {"kind": 8, "step": 32}, {"step": 12},
])
def test_points_come_out_of_any_layout(layout):
    assert np.array_equal(arrays.points(cloud(POINTS, **layout)), POINTS)


def test_points_that_are_not_finite_are_left_out():
    points = POINTS.copy()
    points[1, 2], points[4, 0] = np.nan, np.inf
    assert np.array_equal(arrays.points(cloud(points)), POINTS[[0, 2, 3, 5]])
    assert arrays.points(cloud(POINTS[:0])).shape == (0, 3)


def test_clouds_that_contradict_themselves_are_refused():
    short = cloud(POINTS)
    short.data = short.data[:-1]
    flat = cloud(POINTS)
    flat.fields = flat.fields[:2]
    ints = cloud(POINTS)
    ints.fields[0].datatype = 5
    narrow = cloud(POINTS)
    narrow.point_step = 8
    for message, words in ((short, "bytes"), (flat, "field z"), (ints, "FLOAT32"), (narrow, "bytes")):
        with pytest.raises(arrays.BadMessage, match=words):
            arrays.points(message)


def test_heights_are_those_of_the_map():
    # A quarter turn around x: the sensor's y is the map's z.
    lying = poses.pose(0, 0, 1, math.sqrt(0.5), 0, 0, math.sqrt(0.5))
    points = np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0]], dtype=np.float32)
    assert arrays.between_heights(points, lying, 1.5, 2.5).tolist() == [[0, 1, 0]]
    assert len(arrays.between_heights(points, lying, -math.inf, math.inf)) == 3


def test_one_point_is_kept_in_each_cell_of_the_map():
    points = np.array([[0.01, 0, 0], [0.04, 0.01, 0], [-0.01, 0, 0], [0.06, 0, 0]], dtype=np.float32)
    here = poses.IDENTITY
    assert arrays.one_in_each_cell(points, here, 0.05).tolist() == points[[0, 2, 3]].tolist()
    # Cells begin elsewhere: the first three lie in one.
    assert arrays.one_in_each_cell(points, here, 0.06, (0.05, 0, 0)).tolist() == points[[0, 3]].tolist()
    assert len(arrays.one_in_each_cell(points[:0], here, 0.05)) == 0


@pytest.mark.parametrize("table", [1, 1 << 25])
def test_the_same_cells_are_occupied_as_with_all_points(monkeypatch, table):
    monkeypatch.setattr(arrays, "TABLE_CELLS_MAX", table)
    chance = np.random.default_rng(7)
    points = chance.normal(scale=2, size=(5000, 3)).astype(np.float32)
    pose = poses.pose(*chance.normal(size=7))
    kept = arrays.one_in_each_cell(points, pose, 0.3, (0.1, -0.2, 0.05))

    def cells(xyz_m) -> set[tuple[int, ...]]:
        found = np.floor((poses.applied(pose, xyz_m) - np.array([0.1, -0.2, 0.05])) / 0.3).astype(int)
        return set(map(tuple, found.tolist()))

    assert cells(kept) == cells(points) and len(kept) == len(cells(points)) < 5000


def test_ranges_that_are_too_near_are_no_readings():
    scan = Message(ranges=array.array("f", [1, math.inf, -math.inf, math.nan]), angle_min=0.0, angle_increment=0.1)
    found = arrays.ranges(scan)
    assert found[0] == 1 and found[1] == np.inf and np.isnan(found[2:]).all()
    scan.angle_increment = math.nan
    with pytest.raises(arrays.BadMessage):
        arrays.ranges(scan)


def occupancy(cells, resolution: float = 0.5):
    cells = np.asarray(cells, dtype=np.int8)
    info = Message(width=cells.shape[1], height=cells.shape[0], resolution=resolution)
    return Message(info=info, data=array.array("b", cells.tobytes()))


def test_percent_become_seen_cells():
    assert arrays.seen_cells(occupancy([[-1, 0, 49], [50, 100, 3]])).tolist() == [[-1, 0, 0], [1, 1, 0]]
    wrong = occupancy([[0, 0]])
    wrong.info.width = 3
    with pytest.raises(arrays.BadMessage):
        arrays.seen_cells(wrong)
    with pytest.raises(arrays.BadMessage):
        arrays.seen_cells(occupancy([[0]], resolution=0.0))


def test_a_map_has_three_values_or_percents():
    values = np.array([[np.nan, 0.0, 0.25, 0.5, 0.65, 1.0]])
    assert arrays.three_values(values, 0.65, 0.25).tolist() == [[-1, 0, 0, -1, 100, 100]]
    assert arrays.percents(values).tolist() == [[-1, 0, 25, 50, 65, 100]]
    assert arrays.data_of(arrays.percents(values)).tolist() == [-1, 0, 25, 50, 65, 100]


def test_masks_leave_alone_what_is_not_known():
    values = np.array([[np.nan, 0.0, 0.3, 0.5, 2.0]])
    assert masks.keepout(values, 0.5).tolist() == [[0, 0, 0, 100, 100]]
    assert masks.speed(values, 1.0, 20.0).tolist() == [[0, 0, 24, 40, 80]]
    # A limit of 0 percent would be no limit for Nav2.
    assert masks.speed(values, 1.0, 0.0).max() == 99


def test_counts_of_people_are_spread_over_the_cells_of_the_region():
    region = Region(0, 0, 4, 2, 0.5, (10.0, 0.0))
    counts: dict[int, float] = {}
    take_flow({"indices": [1, 2], "expected_counts": [3.0, 5.0]}, counts)
    header = {"low_m": [10.0, 0.0], "resolution_m": 1.0, "counts": [2, 2]}
    # Cell 1 of the raster is right of cell 0; cell 2 is above it, outside the region.
    assert spread(header, counts, region).tolist() == [[0, 0, 3, 3], [0, 0, 3, 3]]
    assert spread({}, {}, region).shape == (2, 4)
