"""Masks for the costmap filters of Nav2.

Invariant: a cell about which nothing is known neither keeps a robot out nor slows it down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tidemap_ros.arrays import Cells

KEEPOUT_FILTER, SPEED_PERCENT_FILTER = 0, 1
"""The types of ``nav2_msgs/CostmapFilterInfo``."""
SPEED_BASE, SPEED_MULTIPLIER = 100.0, -1.0
"""A cell of the speed mask with the value v allows 100 - v percent of the speed."""


def keepout(values: npt.NDArray[np.floating[Any]], out_from: float) -> Cells:
    """100 where the value is at least ``out_from``, else 0."""
    with np.errstate(invalid="ignore"):
        return np.where(values >= out_from, 100, 0).astype(np.int8)


def speed(values: npt.NDArray[np.floating[Any]], full_at: float, slowest_percent: float) -> Cells:
    """The percentage by which the speed is reduced: 0 where the value is 0, all but ``slowest_percent`` from
    ``full_at`` on, and in proportion between.

    0 is "no limit" for Nav2, and a limit of 0 percent would be no limit, too: the robot keeps at least 1 percent.
    """
    most_taken = min(100.0 - slowest_percent, 99.0)
    share = np.clip(np.nan_to_num(values, nan=0.0) / full_at, 0, 1)
    taken: Cells = np.rint(share * most_taken).astype(np.int8)
    return taken


@dataclass(frozen=True)
class MaskKind:
    """The purpose of a mask."""

    name: str
    filter_type: int
    base: float
    multiplier: float


KEEPOUT = MaskKind("keepout", KEEPOUT_FILTER, 0.0, 1.0)
SPEED = MaskKind("speed", SPEED_PERCENT_FILTER, SPEED_BASE, SPEED_MULTIPLIER)
