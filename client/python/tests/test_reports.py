"""States that report changes or events, as a smart home has them."""

from __future__ import annotations

import asyncio
import warnings

import numpy as np
import pytest

import tidemap
from tidemap import reports

pandas = pytest.importorskip("pandas")

DAYS = pandas.date_range("2026-01-05", periods=21, freq="D", tz="UTC")
HOUR = pandas.Timedelta("1h")


def log(days=DAYS) -> pandas.DataFrame:
    """A door that opens at nine and closes at five, and once is out of reach."""
    rows = [(day + hour * HOUR, "door", word) for day in days for hour, word in ((9, "open"), (17, "closed"))]
    rows.insert(1, (days[0] + 12 * HOUR, "door", "unavailable"))
    return pandas.DataFrame(rows, columns=["time", "state", "value"])


def test_changes_are_learned_as_the_values_that_hold(client):
    sent = client.observe(client.name, log(), reports="changes")
    assert (sent.accepted, sent.refused, sent.mapped) == (43, 0, 42) and sent.without_value == {"unavailable": 1}
    assert client.observe(client.name, log(), reports="changes").duplicate == 43
    client.update(client.name)
    day = client.predict(client.name, "door", DAYS[-1] + pandas.Timedelta("7D") + np.arange(24) * HOUR).values[0]
    assert day[[11, 14]].min() > 0.9 and day[[3, 21]].max() < 0.1
    # Rows come back as they were sent, and can be sent again.
    history = client.history(client.name, "door")
    assert np.isnan(history["value"][1]) and len(history) == 43
    assert client.observe(client.name, history.assign(state="copy"), label="b", reports="changes").accepted == 43


def test_an_empty_cell_of_a_wide_frame_is_no_row(client):
    wide = pandas.DataFrame(
        {"door": ["open", None, "unavailable", np.nan], "lamp": [None, "on", None, "off"]}, index=DAYS[:4]
    )
    sent = client.observe(client.name, wide, reports="changes")
    assert (sent.read, sent.accepted, sent.mapped) == (8, 4, 3)
    # The marker that an empty cell becomes depends on the version of pandas.
    assert sent.without_value["unavailable"] == 1 and sum(sent.without_value.values()) == 5
    assert client.history(client.name)["value"].fillna(-1).tolist() == [1, -1, 1, 0]


def test_events_are_counted(client):
    rings = pandas.DataFrame({"time": [day + 8 * HOUR + n * HOUR / 8 for day in DAYS for n in range(6)]})
    sent = client.observe(client.name, rings, states="bell", reports="events")
    assert sent.accepted == 126
    words = rings.assign(state="gate", value="ring")
    assert client.observe(client.name, words, label="gate", reports="events", hold_step="30m").mapped == 126
    client.observe(client.name, states="horn", times=rings["time"], values=None, label="horn", reports="events")
    table = client.states(client.name).set_index("state")
    assert table["kind"].tolist() == ["count"] * 3 and table["reports"].tolist() == ["events"] * 3
    assert table.loc["gate", "hold_step"] == pandas.Timedelta("30m")
    assert table.loc["bell", "hold_step"] == pandas.Timedelta("1h")
    client.update(client.name)
    day = client.predict(client.name, "bell", DAYS[-1] + pandas.Timedelta("7D") + np.arange(24) * HOUR).values[0]
    assert 4 < day[8] < 7 and day[[2, 15]].max() < 0.5


def test_states_say_how_they_are_reported(client):
    client.add_state(client.name, "door", reports="changes", hold_max="1d", hold_step=np.timedelta64(10, "m"))
    client.add_state(client.name, "bell", reports="events", hold_step=pandas.Timedelta("15min"))
    client.add_state(client.name, "plain")
    # Sending again with the reporting from the table gives the same result.
    table = client.states(client.name).set_index("state")
    door = table.loc["door"]
    client.add_state(client.name, "door", reports=door["reports"], hold_max=door["hold_max"])
    assert table["reports"].tolist() == ["changes", "events", "samples"]
    assert table["kind"].tolist() == ["probability", "count", "probability"]
    assert table["hold_max"].iloc[:2].tolist() == [pandas.Timedelta("1D"), pandas.Timedelta("7D")]
    assert table.loc["plain", ["hold_max", "hold_step"]].isna().all()
    with pytest.raises(tidemap.AlreadyExists, match="door.*changes"):
        client.add_state(client.name, "door", reports="changes", hold_max="2d")
    with pytest.raises(tidemap.InvalidArgument, match="count"):
        client.add_state(client.name, "x", kind="probability", reports="events")


def test_rows_of_a_state_that_is_reported_otherwise_are_not_sent(client):
    client.add_state(client.name, "door")
    with pytest.raises(tidemap.FailedPrecondition, match="'door' exists and is reported by samples, not by changes"):
        client.observe(client.name, log(), reports="changes")
    assert client.observe(client.name, log().query("value != 'unavailable'"), reports="samples").accepted == 42
    client.observe(client.name, log().assign(state="hatch"), label="hatch", reports="changes", hold_max="2d")
    with pytest.raises(tidemap.FailedPrecondition, match="hold_max 172800 s.*not by changes .hold_max 86400 s"):
        client.observe(client.name, log().assign(state="hatch"), label="c", reports="changes", hold_max="1d")
    # Nothing was sent: the label is as new.
    more = log(DAYS + pandas.Timedelta("30D")).assign(state="hatch")
    assert client.observe(client.name, more, label="c", reports="changes").accepted == 43
    with pytest.raises(tidemap.InvalidArgument, match="some rows have no value.*reports='changes'"):
        client.observe(client.name, more, label="d")


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"reports": "chnages"}, "\"chnages\" is not known: use \"samples\", \"changes\" or \"events\""),
        ({"hold_max": "7d"}, "hold_max can be set.*add reports="),
        ({"reports": "samples", "hold_step": "5m"}, "samples neither hold"),
        ({"reports": "changes", "hold_step": "5"}, "hold_step: .*\"5\""),
        ({"reports": "changes", "hold_max": 300}, "hold_max=300 has no unit.*300s"),
        ({"reports": "changes", "hold_max": "100ms"}, "whole seconds"),
        ({"reports": "changes", "hold_max": "1m", "hold_step": "5m"}, "one step"),
        ({"reports": "events", "hold_step": "2d"}, "1 s to 1d"),
        ({"reports": "events", "kind": "probability"}, "\"count\""),
    ],
)
def test_what_cannot_be_said_is_refused_before_anything_is_sent(client, said, words):
    with pytest.raises(tidemap.InvalidArgument, match=words):
        client.observe(client.name, log(), **said)
    assert client.states(client.name).empty
    with pytest.raises(tidemap.InvalidArgument, match=words):
        client.add_state(client.name, "door", **said) if "kind" not in said else client.producer(client.name, **said)


def test_positions_report_samples_only(client):
    frame = pandas.DataFrame({"time": DAYS[:2], "state": "anna", "x": [0.0, 1], "y": [0.0, 1]})
    with pytest.raises(tidemap.InvalidArgument, match="positions are reported by samples"):
        client.observe(client.name, frame, reports="changes")


def test_durations_have_a_unit():
    for duration in ("90s", np.timedelta64(90, "s"), pandas.Timedelta("90s"), pandas.Timedelta("90s").to_pytimedelta()):
        assert reports.nanos_of(duration, "hold_max") == 90_000_000_000
    with pytest.raises(TypeError, match="hold_max"):
        reports.nanos_of([1], "hold_max")
    with pytest.raises(TypeError, match="hold_max"):
        reports.nanos_of(pandas.NaT, "hold_max")


def test_changes_sent_as_readings_are_told(client):
    frame = log().query("value != 'unavailable'")
    with pytest.warns(tidemap.ObservationWarning, match="nearly every row of 'door'.*reports=\"changes\"") as told:
        client.observe(client.name, frame)
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        client.observe(client.name, frame.assign(state="b"), label="b", reports="samples")
        client.observe(client.name, frame.assign(state="c"), label="c", reports="changes")
        # The known reporting of a state need not be stated again.
        client.observe(client.name, frame.assign(state="c"), label="d")
        slow = pandas.DataFrame({"time": DAYS, "state": "slow", "value": np.arange(21) // 7 % 2})
        client.observe(client.name, slow, label="e")


def test_changes_as_they_come(client):
    with client.producer(client.name, reports="changes", hold_max="1d") as hub:
        hub.send("door", DAYS[0], "open")
        hub.send("door", DAYS[1], None)
        hub.send("door", DAYS[2], "unavailable")
    assert client.history(client.name)["value"].isna().tolist() == [False, True, True]
    assert client.states(client.name)["reports"].tolist() == ["changes"]
    with client.producer(client.name, label="robot") as robot:
        with pytest.raises(tidemap.InvalidArgument, match="reports=\"changes\""):
            robot.send("window", DAYS[0], None)


def test_what_holds_is_compared_with_what_held(client):
    client.observe(client.name, log(), reports="changes")
    client.update(client.name)
    week = log(DAYS[:7] + pandas.Timedelta("28D"))
    table = client.evaluate(client.name, week, models=["auto", "mean"], reports="changes")
    # Readings every five minutes, from the first row on, without those while nothing was known.
    assert table["n"].min() > 6 * 12 * 20 and table["mse"][0] < 0.2 * table["mse"][1]
    with pytest.raises(tidemap.InvalidArgument, match="changs"):
        client.evaluate(client.name, week, reports="changs")


def test_the_same_with_await(client, daemon):
    async def use() -> None:
        async with await tidemap.aio.connect(daemon.grpc) as waiting:
            sent = await waiting.observe(client.name, log(), reports="changes", hold_max="2d")
            assert sent.accepted == 43
            await waiting.add_state(client.name, "bell", reports="events")
            async with waiting.producer(client.name, reports="changes") as hub:
                assert await hub.send("lamp", DAYS[0], "on") == 1
                assert await hub.flush() == 1
            table = (await waiting.states(client.name)).set_index("state")
            assert table["reports"].to_dict() == {"door": "changes", "bell": "events", "lamp": "changes"}

    asyncio.run(use())
