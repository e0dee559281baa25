"""Labels: sent as words, predicted together, and recognised by time and place."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import tidemap

ROOT = Path(__file__).parents[3]
RECORDING = ROOT.parent / "shared" / "data" / "activity"


@pytest.fixture
def flat(client):
    """A map that has learned eight days of sleep, meals and work."""
    pandas = pytest.importorskip("pandas")
    times = pandas.date_range("2026-01-05", periods=8 * 144, freq="10min", tz="UTC")
    meals, nights = np.isin(times.hour, (8, 12, 19)), (times.hour < 7) | (times.hour == 23)
    client.add_state(client.name, "activity", kind="categorical", labels=["sleep", "eat", "work"])
    client.labels = np.where(nights, "sleep", np.where(meals, "eat", "work"))
    client.times = times
    frame = pandas.DataFrame({"time": times, "state": "activity", "value": client.labels})
    sent = client.observe(client.name, frame, kind="categorical")
    assert (sent.accepted, sent.refused) == (len(times), 0)
    client.update(client.name)
    return client


def test_labels_are_rows_that_sum_to_one(flat):
    prediction = flat.predict(flat.name, "activity", flat.times[-144:] + (flat.times[144] - flat.times[0]), interval=0.9)
    assert prediction.states == ["activity/sleep", "activity/eat", "activity/work"]
    assert np.allclose(prediction.values.sum(axis=0), 1.0)
    assert np.allclose(prediction.entropy[0], prediction.entropy[2])
    likeliest = np.array(["sleep", "eat", "work"])[prediction.values.argmax(axis=0)]
    assert (likeliest == flat.labels[-144:]).mean() > 0.95
    assert flat.predict(flat.name, times=flat.times[:1]).states == prediction.states
    states = flat.states(flat.name)
    assert (states.kind[0], states.labels[0]) == ("categorical", ["sleep", "eat", "work"])


def test_labels_are_sent_once_from_a_frame_a_series_or_arrays(flat):
    pandas = pytest.importorskip("pandas")
    series = pandas.Series(flat.labels, index=flat.times, name="activity")
    assert flat.observe(flat.name, series, kind="categorical").duplicate == len(flat.times)
    arrays = {"times": flat.times[:3], "values": ["eat", None, "work"], "kind": "categorical", "label": "more"}
    sent = flat.observe(flat.name, states="activity", **arrays)
    assert (sent.read, sent.accepted, sent.without_value) == (3, 2, {"none": 1})
    with pytest.warns(tidemap.ObservationWarning, match="has no label 'fly'|has no label \"fly\""):
        wrong = flat.observe(
            flat.name, states="activity", times=flat.times[:1], values=["fly"], kind="categorical", label="wrong"
        )
    assert wrong.refused == 1


def test_a_classification_is_learned_once(flat):
    noon = "2026-01-13T12:30:00Z"
    found = flat.classify(flat.name, "activity", {"eat": 0.5, "work": 0.5}, time=noon)
    assert found.label[found.probability.idxmax()] == "eat"
    assert np.isclose(found.probability.sum(), 1.0) and found.probability[0] == 0.0
    for _ in range(2):
        learned = flat.classify(
            flat.name, "activity", {"eat": 0.5, "work": 0.5}, time=noon, place="kitchen", learn="label", sequence=1
        )
        assert learned.attrs["durable_sequence"] == 2
    counts = flat.states(flat.name).set_index("state").observations
    assert (counts["activity"], counts["activity@kitchen"]) == (len(flat.times) + 1, 1)
    with pytest.raises(tidemap.InvalidArgument, match="has no label"):
        flat.classify(flat.name, "activity", {"fly": 1.0})


@pytest.mark.skipif(not RECORDING.is_dir(), reason="the recording is not there")
def test_time_and_place_help_a_classifier(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas")
    (tmp_path / "activity").symlink_to(RECORDING)
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "src" / "categories.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "categories.md", "exec"), names)  # noqa: S102
    right = names["right"]
    assert right["the classifier"] < 120 < right["with the time"] < right["with the place, too"], capsys.readouterr()
