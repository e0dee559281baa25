"""Landmarks: added, seen, predicted, and used to find places.

Invariant: expected values follow from the observations that were sent.
"""

import numpy as np
import pytest

import tidemap

HOUR = 3600
START = 1_451_865_600.0


@pytest.fixture
def office(client):
    client.load_topology(client.name, {"from": ["hall"], "to": ["lab"], "length_m": [6.0], "both_ways": [True]})
    return client


def test_landmarks_are_predicted_by_the_hour_and_find_a_robot(office):
    described = np.array([[0, 255], [255, 0]], dtype=np.uint8)
    added = office.add_landmarks(office.name, "hall", ["window", "lamp"], [[100, 50], [300, 40]], described, kind="test")
    assert added["in_map"] == 2
    office.add_landmarks(office.name, "hall/lab", ["sign"], [[1, 2]], described[:1], along_m=[1.5])
    by_day = [8 <= hour % 24 < 18 for hour in range(14 * 24)]
    looks = [
        {"time": START + hour * HOUR, "place": "hall", "seen": ["window" if day else "lamp"]}
        for hour, day in enumerate(by_day)
    ]
    assert office.sight(office.name, looks).accepted == len(looks)
    assert office.sight(office.name, looks).duplicate == len(looks)
    office.update(office.name)
    noon, night = (START + (14 * 24 + hour) * HOUR for hour in (12, 23))
    assert office.predict_landmarks(office.name, "hall", noon, count=1)["landmark"].tolist() == ["window"]
    assert office.predict_landmarks(office.name, "hall", night)["landmark"].tolist() == ["lamp", "window"]
    found = office.localise(office.name, noon, [[107, 52], [400, 200]], np.array([[0, 254], [170, 85]], dtype=np.uint8))
    assert found["node"].tolist() == ["hall"]
    assert found["heading_px"].tolist() == [7.0]
    known = office.landmarks(office.name, "hall")
    assert known["sightings"].tolist() == [len(looks)] * 2
    assert known["seen_share"].iloc[0] == pytest.approx(np.mean(by_day))
    assert known["descriptor"].iloc[0] == bytes([0, 255])
    assert office.prune_landmarks(office.name, 0.5, dry_run=True) == {"hall": ["window"]}
    office.remove_landmarks(office.name, "hall", ["lamp"])
    assert office.landmarks(office.name).to_dict("list") == {"place": ["hall", "hall/lab"], "landmarks": [1, 1]}


def test_wrong_landmarks_and_sightings_say_why(office):
    described = np.zeros((1, 2), dtype=np.uint8)
    with pytest.raises(tidemap.InvalidArgument, match="uint8"):
        office.add_landmarks(office.name, "hall", ["a"], [[1, 2]], described.astype(float))
    with pytest.raises(tidemap.InvalidArgument, match="2 positions and 1 descriptors"):
        office.add_landmarks(office.name, "hall", ["a"], [[1, 2], [3, 4]], described)
    with pytest.raises(tidemap.NotFound, match="cellar"):
        office.add_landmarks(office.name, "cellar", ["a"], [[1, 2]], described, kind="test")
    with pytest.raises(tidemap.InvalidArgument, match="sighting 0 has no 'seen'"):
        office.sight(office.name, [{"time": START, "place": "hall"}])
    with pytest.warns(tidemap.ObservationWarning, match="no landmarks"):
        assert office.sight(office.name, [{"time": START, "place": "lab", "seen": []}]).refused == 1
