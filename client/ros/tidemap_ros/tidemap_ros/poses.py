"""Rigid transforms in three dimensions.

Invariant: a pose is seven floats, x, y, z in metres and a quaternion x, y, z, w of length 1. ``a_from_b`` takes
coordinates of the frame b to coordinates of the frame a.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

Pose = tuple[float, float, float, float, float, float, float]
Floats = npt.NDArray[np.float64]

IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_LENGTH_MIN = 1e-6
# Beyond this cosine two turns are so near that a straight line between them is exact enough, and no sine is divided by.
_NEARLY_EQUAL = 0.9995


class BadPose(ValueError):
    """Numbers that are no pose."""


def pose(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> Pose:
    """The pose of these numbers, with a quaternion of length 1."""
    numbers = [float(number) for number in (x, y, z, qx, qy, qz, qw)]
    if not all(math.isfinite(number) for number in numbers):
        raise BadPose(f"a pose with a number that is not finite: {numbers}")
    length = math.sqrt(sum(number * number for number in numbers[3:]))
    if length < _LENGTH_MIN:
        raise BadPose("the quaternion of a pose is 0, 0, 0, 0; no turn is 0, 0, 0, 1")
    turn = [number / length for number in numbers[3:]]
    return (numbers[0], numbers[1], numbers[2], turn[0], turn[1], turn[2], turn[3])


def from_yaw(x: float, y: float, yaw_rad: float) -> Pose:
    """The pose on the floor with this heading."""
    return pose(x, y, 0.0, 0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))


def from_message(position: Any, orientation: Any) -> Pose:
    """The pose of a position (or translation) and an orientation (or rotation) of ``geometry_msgs``."""
    return pose(position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w)


def rotation(a_from_b: Pose) -> Floats:
    """The matrix of its turn, 3 by 3."""
    x, y, z, w = a_from_b[3:]
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def applied(a_from_b: Pose, points: npt.ArrayLike) -> Floats:
    """Points, rows x, y, z of the frame b, in the frame a."""
    turned: Floats = np.asarray(points, dtype=np.float64) @ rotation(a_from_b).T + np.array(a_from_b[:3])
    return turned


def product(a_from_b: Pose, b_from_c: Pose) -> Pose:
    """a_from_c."""
    x1, y1, z1, w1 = a_from_b[3:]
    x2, y2, z2, w2 = b_from_c[3:]
    at = applied(a_from_b, [b_from_c[:3]])[0]
    return pose(
        at[0], at[1], at[2],
        w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
        w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
        w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
    )


def inverse(a_from_b: Pose) -> Pose:
    """b_from_a."""
    back = -(rotation(a_from_b).T @ np.array(a_from_b[:3]))
    x, y, z, w = a_from_b[3:]
    return pose(back[0], back[1], back[2], -x, -y, -z, w)


def between(first: Pose, second: Pose, part: float) -> Pose:
    """The pose at this part of the way, 0 to 1: a straight line, and the shortest turn at constant speed."""
    at = [a + (b - a) * part for a, b in zip(first[:3], second[:3])]
    start, end = np.array(first[3:]), np.array(second[3:])
    cosine = float(start @ end)
    if cosine < 0:
        end, cosine = -end, -cosine
    if cosine > _NEARLY_EQUAL:
        turn = start + (end - start) * part
    else:
        angle = math.acos(cosine)
        turn = (start * math.sin((1 - part) * angle) + end * math.sin(part * angle)) / math.sin(angle)
    return pose(at[0], at[1], at[2], turn[0], turn[1], turn[2], turn[3])


def yaw_rad(a_from_b: Pose) -> float:
    """The heading of its x axis on the floor, radians."""
    matrix = rotation(a_from_b)
    return math.atan2(matrix[1, 0], matrix[0, 0])
