"""Flows of people: learned from positions and velocities, predicted by cell.

Invariant: expected values follow from the observations that were sent.
"""

import numpy as np
import pandas
import pytest

import tidemap

START = 1_736_121_600.0
EAST, WEST = 0.0, -np.pi


def test_streams_turn_at_noon(client):
    people, motion = [], []
    for walk in range(14 * 144):
        minute = walk % 144 * 10
        if not 420 <= minute < 1140:
            continue
        east = minute < 720
        for step in range(5):
            time = START + walk * 600 + step
            people.append((time, "people", 0.5 + (step if east else 4 - step), 0.5))
            motion.append((time, "velocity", 1.0 if east else -1.0, 0.0))
    for rows, label in ((people, "people"), (motion, "motion")):
        client.observe(client.name, pandas.DataFrame(rows, columns=["time", "state", "x", "y"]), label=label)
    client.update(client.name)
    day = START + 14 * 86_400
    flow = client.flow(client.name, "people", "velocity", [day + 9 * 3_600, day + 15 * 3_600], resolution_m=1.0)
    assert flow["x"].tolist() == [0.5, 1.5, 2.5, 3.5, 4.5] * 2
    assert flow["direction_rad"].tolist() == [EAST] * 5 + [WEST] * 5
    assert flow["expected_count"].between(0.7, 1.3).all(), flow
    assert flow["share"].min() > 0.9
    assert flow.attrs["detections"] == len(people)
    with pytest.raises(tidemap.InvalidArgument):
        client.flow(client.name, "people", "people", day)
