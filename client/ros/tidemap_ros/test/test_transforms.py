"""Poses and the buffer of transforms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tidemap_ros import poses
from tidemap_ros.transforms import NotYet, NoTransform, Transforms

SECOND = 1_000_000_000


def close(left, right) -> bool:
    """Whether two poses are the same; q and -q are the same turn."""
    turn = abs(np.dot(left[3:], right[3:]))
    return bool(np.allclose(left[:3], right[:3], atol=1e-9) and abs(turn - 1) < 1e-9)


def some_pose(seed: int) -> poses.Pose:
    return poses.pose(*np.random.default_rng(seed).normal(size=7))


@pytest.mark.parametrize("seed", range(20))
def test_products_and_inverses_agree_with_matrices(seed):
    a, b = some_pose(seed), some_pose(seed + 100)
    point = np.random.default_rng(seed).normal(size=(5, 3))
    assert np.allclose(poses.applied(poses.product(a, b), point), poses.applied(a, poses.applied(b, point)))
    assert close(poses.product(a, poses.inverse(a)), poses.IDENTITY)
    assert math.isclose(np.linalg.det(poses.rotation(a)), 1)


def test_half_of_a_turn_is_half_of_it():
    start, end = poses.from_yaw(0, 0, 0.2), poses.from_yaw(2, 4, 2.2)
    middle = poses.between(start, end, 0.5)
    assert middle[:2] == (1, 2) and math.isclose(poses.yaw_rad(middle), 1.2)
    # The other sign of a quaternion is the same turn: the way between is the short one.
    flipped = poses.pose(*end[:3], *(-number for number in end[3:]))
    assert close(poses.between(start, flipped, 0.25), poses.between(start, end, 0.25))
    almost = poses.from_yaw(0, 0, 0.2 + 1e-9)
    assert math.isclose(poses.yaw_rad(poses.between(start, almost, 0.5)), 0.2, abs_tol=1e-8)


@pytest.mark.parametrize("numbers", [(0, 0, 0, 0, 0, 0, 0), (math.nan, 0, 0, 0, 0, 0, 1), (0, 0, 0, math.inf, 0, 0, 1)])
def test_numbers_that_are_no_pose_are_refused(numbers):
    with pytest.raises(poses.BadPose):
        poses.pose(*numbers)


def tree() -> Transforms:
    """map <- odom (moving) <- base (moving) <- laser (static)."""
    known = Transforms(kept_secs=10)
    for second in range(5):
        known.add("map", "odom", second * SECOND, poses.from_yaw(0, 0, math.pi / 2), is_static=False)
        known.add("odom", "base", second * SECOND, poses.from_yaw(second, 0, 0), is_static=False)
    known.add("base", "laser", 0, poses.pose(0.1, 0, 0.3, 0, 0, 0, 1), is_static=True)
    return known


def test_a_chain_is_followed_and_interpolated_at_the_time():
    known = tree()
    at = known.lookup("map", "laser", int(2.5 * SECOND))
    assert close(at, poses.pose(0, 2.6, 0.3, *poses.from_yaw(0, 0, math.pi / 2)[3:]))
    back = known.lookup("laser", "map", int(2.5 * SECOND))
    assert close(poses.product(at, back), poses.IDENTITY)
    assert known.lookup("map", "/map", 0) == poses.IDENTITY
    assert close(known.lookup("/map", "/laser", SECOND), known.lookup("map", "laser", SECOND))


def test_siblings_meet_below_their_parent():
    known = tree()
    known.add("base", "camera", 0, poses.pose(-0.2, 0, 1, 0, 0, 0, 1), is_static=True)
    # No moving transform lies between them: any time will do.
    assert close(known.lookup("laser", "camera", 99 * SECOND), poses.pose(-0.3, 0, 0.7, 0, 0, 0, 1))


def test_nothing_is_extrapolated():
    known = tree()
    with pytest.raises(NotYet, match="0.100 s older"):
        known.lookup("map", "laser", int(4.1 * SECOND))
    with pytest.raises(NoTransform, match="newer") as refused:
        known.lookup("map", "laser", -1)
    assert not isinstance(refused.value, NotYet)
    with pytest.raises(NotYet, match="not connected"):
        known.lookup("map", "arm", 0)
    known.add("odom", "base", 20 * SECOND, poses.IDENTITY, is_static=False)
    with pytest.raises(NoTransform, match="newer"):
        known.lookup("odom", "base", 5 * SECOND)


def test_a_tolerance_takes_the_newest():
    known = Transforms(tolerance_secs=0.2)
    known.add("map", "base", SECOND, poses.from_yaw(3, 0, 0), is_static=False)
    assert known.lookup("map", "base", SECOND + SECOND // 10)[0] == 3
    with pytest.raises(NotYet):
        known.lookup("map", "base", SECOND + SECOND // 2)


def test_late_transforms_are_put_in_their_place():
    known = Transforms()
    for second in (0, 2, 1, 2):
        known.add("map", "base", second * SECOND, poses.from_yaw(second * second, 0, 0), is_static=False)
    assert [known.lookup("map", "base", int(at * SECOND))[0] for at in (0.5, 1, 1.5)] == [0.5, 1, 2.5]


def test_a_frame_changes_its_parent_and_circles_are_refused():
    known = tree()
    known.add("map", "base", 0, poses.from_yaw(7, 0, 0), is_static=True)
    assert known.lookup("map", "base", 0)[0] == 7
    known.add("base", "map", 0, poses.IDENTITY, is_static=True)
    with pytest.raises(NoTransform, match="circle"):
        known.lookup("odom", "laser", 0)
    with pytest.raises(NoTransform, match="no two frames"):
        known.add("base", "base", 0, poses.IDENTITY, is_static=True)
