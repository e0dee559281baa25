"""Input frames: long and wide ones, a file's own words and columns, and markers that are no measurement."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import tidemap
from tidemap import frames

pandas = pytest.importorskip("pandas")

HOURS = pandas.date_range("2026-01-05", periods=14 * 24, freq="h", tz="UTC")
OPEN = (HOURS.hour >= 8) & (HOURS.hour < 18)


def history(client) -> list[tuple[str, str, float]]:
    table = client.history(client.name)
    return [(str(time), state, value) for time, state, value in table.itertuples(index=False)]


def test_a_wide_frame_has_a_column_for_each_state(client):
    wide = pandas.DataFrame({"door": OPEN, "lamp": np.where(HOURS.hour < 20, np.nan, 1.0)}, index=HOURS)
    sent = client.observe(client.name, wide)
    lamp = int((HOURS.hour >= 20).sum())
    assert (sent.read, sent.accepted) == (2 * len(HOURS), len(HOURS) + lamp)
    assert sent.without_value == {"NaN": len(HOURS) - lamp}
    assert client.states(client.name)["observations"].tolist() == [len(HOURS), lamp]
    # More rows behind them are added; the time may be a column, too.
    longer = pandas.concat([wide, wide[-2:].set_axis(HOURS[-2:] + pandas.Timedelta("1D"))])
    again = client.observe(client.name, longer.rename_axis("time").reset_index())
    assert (again.accepted, again.duplicate) == (4, sent.accepted)
    only = client.observe(client.name, wide, states=["lamp"], label="lamp alone")
    assert only.accepted == lamp


def test_a_series_is_one_state(client):
    assert client.observe(client.name, pandas.Series(OPEN, index=HOURS, name="door")).accepted == len(HOURS)
    nameless = pandas.Series(OPEN, index=HOURS)
    assert client.observe(client.name, nameless, states="hatch", label="b").accepted == len(HOURS)
    with pytest.raises(tidemap.InvalidArgument, match="no name"):
        client.observe(client.name, nameless, label="c")


def test_columns_and_words_of_a_smart_home(daemon):
    client = daemon.connect()
    client.create_map("smart-home", time_zone="Europe/Prague")
    client.name = "smart-home"
    frame = pandas.DataFrame({
        "entity_id": ["binary_sensor.door", "binary_sensor.door", "binary_sensor.door", "cover.blind", "cover.blind"],
        "state": ["On", "off", "unavailable", "Open", "ajar"],
        "last_changed": ["2026-07-01 08:00:00.250", "2026-07-01 08:05:00", "2026-07-01 09:00", "2026-07-01T10:00",
                         "2026-07-01T11:00"],
    })
    columns = {"time": "last_changed", "state": "entity_id", "value": "state"}
    with pytest.raises(tidemap.InvalidArgument, match="columns=.*no time|no time.*columns"):
        client.observe("smart-home", frame)
    with pytest.raises(tidemap.InvalidArgument, match="'ajar' \\(1 row\\).*values="):
        client.observe("smart-home", frame, columns=columns, times="local")
    with pytest.raises(tidemap.InvalidArgument, match="Europe/Prague"):
        client.observe("smart-home", frame, columns=columns, values={"ajar": 1})
    sent = client.observe("smart-home", frame, columns=columns, values={"ajar": 0.5}, times="local")
    assert (sent.read, sent.accepted, sent.without_value) == (5, 4, {"unavailable": 1})
    assert history(client) == [
        ("2026-07-01 08:00:00.250000+02:00", "binary_sensor.door", 1),
        ("2026-07-01 08:05:00+02:00", "binary_sensor.door", 0),
        ("2026-07-01 10:00:00+02:00", "cover.blind", 1),
        ("2026-07-01 11:00:00+02:00", "cover.blind", 0.5),
    ]
    # The rows that were read go back unchanged.
    assert client.observe("smart-home", client.history("smart-home"), label="again").accepted == 4
    client.delete_map("smart-home")


def test_words_and_numbers():
    found = frames.numbers(["on", "OFF", True, "21.5", 3, None, "unknown", " closed ", float("nan")])
    assert np.array_equal(found.values, [1, 0, 1, 21.5, 3, np.nan, np.nan, 0, np.nan], equal_nan=True)
    assert found.missing == {"none": 1, "unknown": 1, "NaN": 1} and found.mapped == 3
    # Only a word means that no value is known; None and NaN are empty cells of a wide frame.
    assert np.flatnonzero(found.said).tolist() == [6]
    found = frames.numbers(["home", "away", "lost"], {"home": 1, "away": 0, "lost": None})
    assert np.array_equal(found.values, [1, 0, np.nan], equal_nan=True) and found.missing == {"lost": 1}
    # A word of one's own comes before the usual ones.
    assert frames.numbers(["closed"], {"closed": 1}).values.tolist() == [1]
    assert frames.numbers(np.array([True, 1], dtype=object), {"true": 0}).values.tolist() == [0, 1]
    with pytest.raises(tidemap.InvalidArgument, match="number or a word"):
        frames.numbers(np.array([[1], {}], dtype=object))
    # Any word is an event, except for words that mean that nothing is known.
    assert frames.numbers(["ring", "off", "unavailable"], reports="events").values[:2].tolist() == [1, 1]


def test_refused_rows_name_the_row_of_the_frame(client):
    frame = pandas.DataFrame({"time": HOURS[:4], "state": "door", "value": ["unknown", 0.5, 7, 1]})
    with pytest.warns(tidemap.ObservationWarning, match="1 of 4 rows were refused: row 2: value 7"):
        sent = client.observe(client.name, frame)
    assert sent.refusals[0][0] == 2 and sent.accepted == 2


def test_a_time_that_does_not_exist_names_the_row_of_the_frame(daemon):
    client = daemon.connect()
    client.create_map("spring", time_zone="Europe/Prague")
    clock = ["2026-03-29T01:00", "2026-03-29T01:30", "2026-03-29T02:30"]
    frame = {"time": clock, "state": "door", "value": ["unknown", 0, 1]}
    with pytest.raises(tidemap.InvalidArgument, match="row 2: 2026-03-29T02:30:00 does not exist"):
        client.observe("spring", pandas.DataFrame(frame), times="local")
    client.delete_map("spring")


def test_times_that_were_rounded_are_told(client):
    frame = pandas.DataFrame({"time": [1.736e9] * 40, "state": "door", "value": 1})
    with pytest.warns(tidemap.ObservationWarning, match="all 40 rows of 'door' have one time"):
        client.observe(client.name, frame)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        client.observe(client.name, frame.head(3), label="few")


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        ({"time": HOURS[:2], "state": "door"}, "no value"),
        ({"time": HOURS[:2], "value": [0, 1]}, "no state"),
        ({"when": HOURS[:2], "state": ["a", "b"], "value": [0, 1]}, "columns={\"time\": 'when'}"),
        ({"time": HOURS[:2], "state": ["a", None], "value": [0, 1]}, "row 1 has no state"),
        ({"time": HOURS[:2]}, "no column but the time"),
    ],
)
def test_what_a_frame_lacks_is_named(frame, words):
    with pytest.raises(tidemap.InvalidArgument, match=words.replace("{", "\\{")):
        frames.of_frame(pandas.DataFrame(frame))


def test_wrong_columns_are_named(client):
    wide = pandas.DataFrame({"door": OPEN}, index=HOURS)
    with pytest.raises(tidemap.InvalidArgument, match="'dor'.*door"):
        client.observe(client.name, wide, states=["dor"])
    with pytest.raises(tidemap.InvalidArgument, match="'when'"):
        client.observe(client.name, wide, columns={"value": "when"})
    with pytest.raises(tidemap.InvalidArgument, match="worth"):
        client.observe(client.name, wide, columns={"worth": "door"})
    with pytest.raises(tidemap.InvalidArgument, match="two columns 'a'"):
        client.observe(client.name, pandas.DataFrame([[0, 1]], columns=["a", "a"], index=HOURS[:1]))
    with pytest.raises(tidemap.InvalidArgument, match="the zone of its times"):
        client.observe(client.name, wide, times=HOURS)


def test_frames_of_polars_and_dictionaries(client):
    polars = pytest.importorskip("polars")
    frame = pandas.DataFrame({"time": HOURS, "state": "door", "value": np.where(OPEN, "on", "off")})
    columns = {"time": list(HOURS), "state": "door", "value": frame["value"].to_list()}
    assert client.observe(client.name, polars.DataFrame(columns)).accepted == len(HOURS)
    again = client.observe(client.name, {name: frame[name] for name in frame})
    assert again.duplicate == len(HOURS)
    wide = polars.DataFrame({"time": list(HOURS), "lamp": [1.0, None] * (len(HOURS) // 2)})
    assert client.observe(client.name, wide, label="lamp").accepted == len(HOURS) // 2


def test_positions(client):
    rng = np.random.default_rng(7)
    x = np.where(OPEN, 8, 1) + rng.normal(0, 0.1, len(HOURS))
    frame = pandas.DataFrame({"time": HOURS, "state": "anna", "x": x, "y": 2 + rng.normal(0, 0.1, len(HOURS))})
    sent = client.observe(client.name, frame)
    assert sent.accepted == len(HOURS)
    assert client.observe(client.name, frame).duplicate == len(HOURS)
    assert client.states(client.name)["kind"].tolist() == ["vector"]
    client.update(client.name)
    at = ["2026-01-20T03:00:00Z", "2026-01-20T13:00:00Z"]
    table = client.position(client.name, "anna", at, resolution_m=0.5)
    assert len(table) == 2 and (abs(table["x"] - [1, 8]) < 0.8).all() and (abs(table["y"] - 2) < 0.8).all()
    assert (table["probability"] > 0.1).all() and {"expected_x", "expected_y", "outside"} <= set(table)
    cells = client.position(client.name, "anna", at[:1], top=0)
    assert cells["probability"].sum() + cells["outside"][0] == pytest.approx(1)
    # Without names all states are predicted: of a vector, its axes.
    assert client.predict(client.name, times=at).states == ["anna/x", "anna/y"]
