"""The records that messages become: with their transform, after waiting, or left out and counted."""

from __future__ import annotations

import array
import json
import math
from types import SimpleNamespace as Message

import numpy as np
import pytest

import tidemap
from tidemap_ros import records
from tidemap_ros.intake import Intake
from tidemap_ros.parameters import Settings
from tidemap_ros.transforms import Transforms

SECOND = 1_000_000_000
NOW = 1_767_614_400 * SECOND


class Bench:
    """An intake with a clock that a test sets, and room for a number of records."""

    def __init__(self, room: int = 1000, **parameters) -> None:
        self.taken: list[records.Record] = []
        self.room = room
        self.seconds, self.now = 0.0, NOW
        self.log: list[str] = []
        self.intake = Intake(
            Settings(parameters), self.put, Transforms(), lambda: self.now, lambda: self.seconds, self.log.append
        )

    def put(self, record: records.Record) -> None:
        if len(self.taken) >= self.room:
            raise tidemap.ResourceExhausted("the queue is full", "RESOURCE_EXHAUSTED")
        self.taken.append(record)

    def tf(self, parent: str, child: str, x: float, at: int, is_static: bool = False) -> None:
        self.intake.transform(Message(
            header=header(parent, at), child_frame_id=child,
            transform=Message(translation=Message(x=x, y=0.0, z=0.0), rotation=Message(x=0.0, y=0.0, z=0.0, w=1.0)),
        ), is_static)


@pytest.fixture
def bench():
    return Bench()


def header(frame: str, nanos: int):
    return Message(frame_id=frame, stamp=Message(sec=nanos // SECOND, nanosec=nanos % SECOND))


def scan(at: int, frame: str = "laser", **changes):
    fields = {
        "angle_min": -0.5, "angle_increment": 0.5, "range_min": 0.1, "range_max": 30.0,
        "ranges": array.array("f", [1.0, math.inf, 3.0]), **changes,
    }
    return Message(header=header(frame, at), **fields)


def test_a_scan_gets_the_pose_of_its_time(bench):
    bench.tf("map", "laser", 0.0, NOW)
    bench.tf("map", "laser", 2.0, NOW + SECOND)
    bench.intake.scan("scan", scan(NOW + SECOND // 2))
    (taken,) = bench.taken
    assert isinstance(taken, records.Ranges)
    assert (taken.pose[0], taken.time_nanos, taken.max_range_m) == (1.0, NOW + SECOND // 2, 30.0)
    assert taken.ranges_m.tolist() == [1.0, math.inf, 3.0]


def test_a_scan_waits_for_its_transform(bench):
    bench.tf("map", "laser", 0.0, NOW)
    bench.intake.scan("scan", scan(NOW + SECOND))
    assert bench.intake.waiting == 1 and bench.taken == []
    bench.seconds = 0.9
    bench.intake.retry()
    bench.tf("map", "laser", 4.0, NOW + 2 * SECOND)
    bench.intake.retry()
    assert bench.taken[0].pose[0] == 2.0 and bench.intake.waiting == 0 and bench.intake.counts.left_out == 0


def test_a_scan_without_a_transform_is_left_out_and_counted(bench):
    bench.tf("map", "laser", 0.0, NOW)
    bench.intake.scan("scan", scan(NOW + SECOND))
    bench.intake.scan("scan", scan(NOW - SECOND))
    bench.seconds = 1.1
    bench.intake.retry()
    counts = bench.intake.counts
    assert bench.taken == [] and counts.reasons == {"no transform": 2} and counts.left_out == 2
    assert len(bench.log) == 1, "one line for a reason, not one for a scan"


def test_limits_of_ranges_are_the_tighter_ones():
    bench = Bench(min_range=0.3, max_range=10.0)
    bench.intake.scan("scan", scan(NOW, frame="map"))
    bench.intake.scan("scan", scan(NOW, frame="map", range_min=0.5, range_max=5.0))
    bench.intake.scan("scan", scan(NOW, frame="map", range_max=math.inf))
    assert [(one.min_range_m, one.max_range_m) for one in bench.taken] == [(0.3, 30.0), (0.5, 5.0), (0.3, 10.0)]
    assert {(one.free_range_m, one.trusted_range_m) for one in bench.taken} == {(0.0, 10.0)}
    without = Bench()
    without.intake.scan("scan", scan(NOW, frame="map", range_max=0.0))
    assert without.intake.counts.reasons == {"malformed": 1} and "max_range" in without.log[0]


def test_a_period_thins_out_each_topic_for_itself():
    bench = Bench(scan_period=1.0)
    for tenth in range(30):
        bench.intake.scan("front", scan(NOW + tenth * SECOND // 10, frame="map"))
    bench.intake.scan("back", scan(NOW, frame="map"))
    # A bag that is played again: its times are earlier.
    bench.intake.scan("front", scan(NOW - 100 * SECOND, frame="map"))
    assert len(bench.taken) == 5 and bench.intake.counts.thinned == 27


def cloud(points, at: int = NOW):
    points = np.asarray(points, dtype=np.float32)
    fields = [Message(name=name, offset=4 * axis, datatype=7) for axis, name in enumerate("xyz")]
    return Message(
        header=header("map", at), fields=fields, is_bigendian=False, height=1, width=len(points), point_step=12,
        row_step=12 * len(points), data=array.array("B", points.tobytes()),
    )


def test_clouds_keep_the_points_between_the_heights():
    bench = Bench(cloud_min_height=0.1, cloud_max_height=1.8, cloud_cell=0.5)
    bench.intake.cloud("points", cloud([[1, 0, 0], [1, 0, 1], [1.1, 0, 1], [1, 0, 2]]))
    bench.intake.cloud("points", cloud([[1, 0, 0]]))
    bench.intake.cloud("points", cloud([]))
    assert bench.taken[0].xyz_m.tolist() == [[1, 0, 1]]
    assert bench.intake.counts.reasons == {"empty": 2}


def test_values_come_as_json(bench):
    said = [
        {"state": "door", "value": True}, {"state": "door", "value": "closed", "stamp": "2026-01-05T12:00:00.5Z"},
        {"state": "heat", "value": 21.5, "stamp": 1767614400.25}, {"state": "n", "value": 3, "stamp": {"sec": 5}},
    ]
    for one in said:
        bench.intake.observe(json.dumps(one))
    assert bench.taken == [
        records.Value("door", NOW, 1.0), records.Value("door", NOW + SECOND // 2, 0.0),
        records.Value("heat", NOW + SECOND // 4, 21.5), records.Value("n", 5 * SECOND, 3.0),
    ]


@pytest.mark.parametrize("text", [
    "", "[]", "{", '{"state": "door"}', '{"state": 5, "value": 1}', '{"state": "a/b", "value": 1}',
    '{"state": "", "value": 1}', '{"state": "door", "value": "ajarish"}', '{"state": "door", "value": null}',
    '{"state": "door", "value": NaN}', '{"state": "door", "value": [1]}',
    '{"state": "door", "value": 1, "stamp": true}',
    '{"state": "door", "value": 1, "stamp": "2026-01-05T12:00:00"}', '{"state": "door", "value": 1, "color": 1}',
    '{"state": "door", "value": 1, "stamp": -5}', '{"state": "door", "value": 1, "stamp": 1e300}', "[" * 60_000,
    '{"state": "door", "value": ' + "9" * 400 + "}",
])
def test_wrong_json_is_left_out_and_counted(bench, text):
    bench.intake.observe(text)
    assert bench.taken == [] and bench.intake.counts.reasons == {"malformed": 1}


def test_traversals_come_as_json(bench):
    bench.intake.traverse(json.dumps({
        "from": "hall", "to": "lab", "start": "2026-01-05T12:00:00Z", "end": 1767614409, "success": False,
        "reason": "a person",
    }))
    assert bench.taken == [records.Traversal("hall", "lab", NOW, NOW + 9 * SECOND, False, "", "a person")]
    for wrong in ({"from": "hall"}, {"from": "a", "to": "b", "start": 5, "end": 4, "success": True},
                  {"from": "", "to": "b", "start": 4, "end": 5, "success": True},
                  {"from": "a", "to": "b", "start": 4, "end": 5, "success": "yes"}):
        bench.intake.traverse(json.dumps(wrong))
    assert len(bench.taken) == 1 and bench.intake.counts.left_out == 4


def test_doors_are_readings_when_they_change_and_now_and_then(bench):
    def door(seconds: int, mode: int) -> None:
        bench.intake.door(Message(
            door_time=Message(sec=NOW // SECOND + seconds, nanosec=0), door_name="lab/1",
            current_mode=Message(value=mode),
        ))

    for seconds, mode in ((0, 0), (1, 0), (30, 1), (31, 2), (32, 2), (90, 2), (95, 2), (100, 4)):
        door(seconds, mode)
    assert [(one.time_nanos // SECOND - NOW // SECOND, one.value) for one in bench.taken] == [(0, 0), (31, 1), (95, 1)]
    assert bench.taken[0].state == "lab_1" and bench.intake.counts.thinned == 3


def test_what_the_queue_refuses_is_counted_as_lost():
    bench = Bench(room=3)
    for _ in range(5):
        bench.intake.observe('{"state": "door", "value": 1}')
    counts = bench.intake.counts
    assert (counts.taken, counts.spool_refused) == (3, 2) and "full" in counts.last_problem
    assert len(bench.log) == 1


def test_grids_keep_the_pose_of_their_corner(bench):
    origin = Message(position=Message(x=1.0, y=2.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    info = Message(width=2, height=1, resolution=0.5, origin=origin)
    bench.tf("map", "slam", 10.0, NOW, is_static=True)
    bench.intake.grid("map", Message(header=header("slam", NOW), info=info, data=array.array("b", [-1, 100])))
    (taken,) = bench.taken
    assert taken.pose[:3] == (11.0, 2.0, 0.0) and taken.cells.tolist() == [[-1, 1]] and taken.resolution_m == 0.5


def test_before_the_first_time_on_clock_nothing_is_observed_in_1970():
    bench = Bench()
    bench.now = 0
    bench.intake.observe(json.dumps({"state": "door", "value": 1}))
    assert bench.taken == [] and bench.intake.counts.reasons == {"no time": 1} and "/clock" in bench.log[0]
    bench.intake.observe(json.dumps({"state": "door", "value": 1, "stamp": NOW // SECOND}))
    bench.now = NOW + SECOND
    bench.intake.observe(json.dumps({"state": "door", "value": 0}))
    assert [record.time_nanos for record in bench.taken] == [NOW, NOW + SECOND]
