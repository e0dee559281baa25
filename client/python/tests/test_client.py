"""The client against a real daemon: exactly once, also through kill -9; arrays; errors in words."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

import tidemap

MONDAY = np.datetime64("2026-01-05T00:00:00", "ns")
SECOND = np.timedelta64(1_000_000_000, "ns")


def door(days: int = 14) -> tuple[np.ndarray, np.ndarray]:
    seconds = np.arange(days * 144) * 600
    hour = seconds // 3600 % 24
    return MONDAY + seconds * SECOND, ((hour >= 8) & (hour < 18)).astype(float)


def test_the_same_rows_again_add_nothing(client):
    when, value = door()
    first = client.observe(client.name, states="door", times=when, values=value)
    again = client.observe(client.name, states="door", times=when, values=value)
    assert (first.accepted, again.accepted, again.duplicate) == (len(when), 0, len(when))
    more = np.concatenate([when, when[-1:] + 600 * SECOND])
    longer = client.observe(client.name, states="door", times=more, values=np.append(value, 0))
    assert (longer.accepted, longer.duplicate) == (1, len(when))
    with pytest.raises(tidemap.FailedPrecondition, match="label"):
        client.observe(client.name, states="door", times=when, values=1 - value)
    apart = client.observe(client.name, states="door", times=when + 86_400 * 30 * SECOND, values=value, label="later")
    assert apart.accepted == len(when)
    assert client.map(client.name)["observations"] == 2 * len(when) + 1


def test_what_was_sent_can_be_replaced_or_erased(client):
    when, value = door(4)
    client.observe(client.name, states="door", times=when, values=value)
    client.update(client.name)
    with pytest.raises(tidemap.FailedPrecondition, match="replace=True"):
        client.observe(client.name, states="door", times=when[:-1], values=1 - value[:-1])
    with pytest.raises(tidemap.InvalidArgument, match="contiuous"):
        client.observe(client.name, states="door", times=when, values=value, replace=True, kind="contiuous")
    with pytest.raises(tidemap.FailedPrecondition, match="Nothing was sent"):
        client.observe(client.name, states="door", times=when, values=value, replace=True, reports="events")
    assert len(client.history(client.name, "door")["value"]) == len(when), "nothing is withdrawn for a mistake"
    again = client.observe(client.name, states="door", times=when[:-1], values=1 - value[:-1], replace=True)
    assert again.accepted == len(when) - 1
    # If nothing was sent, nothing is withdrawn.
    other = client.observe(client.name, states="hatch", times=when, values=value, label="b", replace=True)
    assert other.accepted == len(when)
    assert client.history(client.name, "door")["value"].tolist() == (1 - value[:-1]).tolist()
    job = client.erase(client.name, producer="python", label="b", to_time=when[100])
    assert job["observations"] == 100
    client.erase(client.name, "hatch")
    assert client.states(client.name)["state"].tolist() == ["door"]
    with pytest.raises(tidemap.NotFound, match="hatch"):
        client.erase(client.name, "hatch")


def test_a_producer_that_will_not_come_back_frees_its_places(client):
    when, value = door(1)
    for label in ("a", "b"):
        client.observe(client.name, states="door", times=when, values=value, producer="robot", label=label)
    assert client.forget_producer(client.name, "robot", label="a") == 1
    assert client.forget_producer(client.name, "robot") == 1, "the other label"
    with pytest.raises(tidemap.NotFound, match="robot"):
        client.forget_producer(client.name, "robot")
    # The observations of the producer stay, and keep their numbers.
    again = client.observe(client.name, states="door", times=when, values=value, producer="robot", label="a")
    assert (again.accepted, again.duplicate) == (0, len(when))


def test_kill_9_in_between_loses_and_doubles_nothing(tmp_path):
    rows = 400_000
    when = MONDAY + np.arange(rows) * SECOND
    value = (np.arange(rows) // 100 % 2).astype(float)
    daemon = tidemap.serve(tmp_path / "data")
    client = daemon.connect()
    client.create_map("home")
    outcome: list[object] = []

    def send() -> None:
        try:
            outcome.append(client.observe("home", states="door", times=when, values=value))
        except tidemap.TidemapError as error:
            outcome.append(error)

    sender = threading.Thread(target=send)
    sender.start()
    while client.map("home")["observations"] < 20_000 and sender.is_alive():
        time.sleep(0.005)
    daemon.kill()
    # On the same port, so that the sender finds it.
    with tidemap.serve(tmp_path / "data", listen=daemon.grpc.removeprefix("http://").strip("/")) as restarted:
        sender.join()
        client = restarted.connect()
        again = client.observe("home", states="door", times=when, values=value)
        assert again.accepted + again.duplicate == rows
        assert client.map("home")["observations"] == rows
        assert isinstance(outcome[0], (tidemap.Observed, tidemap.Unavailable))


def test_frames(client):
    pandas = pytest.importorskip("pandas")
    when, value = door(2)
    zoned = pandas.DatetimeIndex(when).tz_localize("UTC").tz_convert("Europe/Prague")
    frame = pandas.DataFrame({"time": zoned, "state": ["a", "b"] * (len(when) // 2), "value": value})
    assert client.observe(client.name, frame).accepted == len(when)
    states = client.states(client.name)
    assert states["state"].tolist() == ["a", "b"] and states["observations"].tolist() == [len(when) // 2] * 2
    assert str(states["last_time"][0]).startswith("2026-01-06 23:")
    with pytest.raises(tidemap.InvalidArgument, match="no value"):
        client.observe(client.name, frame.rename(columns={"value": "worth"}))


def test_predictions(client):
    when, value = door()
    client.observe(client.name, states="door", times=when, values=value)
    job = client.update(client.name)
    assert job["state"] == "JOB_STATE_DONE" and client.jobs(client.name)
    at = MONDAY + (np.array([14 * 24 + 3, 14 * 24 + 12]) * 3600) * SECOND
    found = client.predict(client.name, "door", at, interval=0.9)
    assert found.values.shape == (1, 2)
    assert found.values[0, 0] < 0.1 < 0.9 < found.values[0, 1]
    assert (found.lower <= found.values).all() and (found.values <= found.upper).all()
    assert client.predict(client.name, ["door"], at, model="mean").values[0, 0] == pytest.approx(value.mean())
    assert client.describe(client.name, "door")["order"] > 0
    with pytest.raises(tidemap.NotFound, match="door"):
        client.predict(client.name, "dor", at)
    with pytest.raises(tidemap.InvalidArgument, match="histgram"):
        client.predict(client.name, "door", at, model="histgram")


def test_observations_as_they_come(client):
    with client.producer(client.name) as producer:
        numbers = [producer.send("door", MONDAY + i * SECOND, i % 2) for i in range(5)]
        assert numbers == [1, 2, 3, 4, 5]
        assert producer.flush() == 5
    assert client.map(client.name)["observations"] == 5


def test_refused_rows_are_told(client):
    when = MONDAY + np.arange(3) * SECOND
    with pytest.warns(tidemap.ObservationWarning, match="1 of 3 rows were refused: row 1: value 7"):
        report = client.observe(client.name, states="door", times=when, values=[1, 7, 0])
    assert (report.accepted, report.refused) == (2, 1)
    row, why = report.refusals[0]
    assert row == 1 and "7" in why


def test_rows_that_were_refused_before_are_told(client):
    when = MONDAY + np.arange(3) * SECOND
    warm = {"states": "room", "times": when, "values": [20, 21, 22]}
    with pytest.warns(tidemap.ObservationWarning, match="kind=\"continuous\".*replace=True"):
        client.observe(client.name, **warm)
    with pytest.warns(tidemap.ObservationWarning, match="nothing of 'room'.*replace=True"):
        assert client.observe(client.name, **warm, kind="continuous").accepted == 0
    assert client.observe(client.name, **warm, kind="continuous", replace=True).accepted == 3
    assert client.observe(client.name, **warm, kind="continuous").duplicate == 3


def test_no_daemon_is_said_plainly():
    with pytest.raises(tidemap.Unavailable, match="no daemon responds at"):
        tidemap.connect("127.0.0.1:9")


def test_any_rpc_by_its_name(client):
    assert client.call("MapService/GetMap", {"name": client.name})["map"]["name"] == client.name
    with pytest.raises(tidemap.InvalidArgument, match="unknown"):
        client.call("MapService/GetMap", {"unknown": 1})
    with pytest.raises(tidemap.InvalidArgument, match="no method"):
        client.call("MapService/GetMaps")


def test_a_grid_is_an_array(daemon):
    client = daemon.connect()
    client.create_map("yard", grid_resolution_m=0.5)
    # Two weeks, every hour: a wall, a door that is shut at night, a row that is never seen.
    hours = np.arange(14 * 24)
    seen = np.zeros((len(hours), 16, 24), dtype=np.int8)
    seen[:, :, 4] = 1
    seen[:, 7, 4] = (hours % 24 < 8) | (hours % 24 >= 18)
    seen[:, 15] = -1
    when = MONDAY + hours * 3600 * SECOND
    sent = client.observe_grids("yard", when, seen, first_cell=(-8, 0, 0))
    again = client.observe_grids("yard", when, np.where(seen > 0, 100, seen), first_cell=(-8, 0, 0))
    assert (sent.accepted, again.accepted, again.duplicate) == (len(hours), 0, len(hours))
    with pytest.raises(tidemap.FailedPrecondition, match="label"):
        client.observe_grids("yard", when, np.where(seen == 0, -1, seen), first_cell=(-8, 0, 0))
    client.update("yard")
    night, noon = MONDAY + (14 * 24 + 3) * 3600 * SECOND, MONDAY + (14 * 24 + 12) * 3600 * SECOND
    grid = client.grid("yard", noon, region=(-8, 0, 0, 16, 16, 1))
    assert grid.values.shape == (1, 16, 24)
    assert grid.first_cell == (-8, 0, 0) and grid.x_m[0] == pytest.approx(-3.75)
    assert np.isnan(grid.values[0, 15]).all() and (grid.values[0, :15, 4].min() < 0.2)
    assert grid.values[0, 0, 4] > 0.9 and grid.values[0, 0, 5] < 0.1
    assert grid.changing[0, 7, 4] and not grid.changing[0, 0, 4]
    assert np.nanmax(client.grid("yard", night).values) > 0.9
    xarray = pytest.importorskip("xarray")
    film = client.grids("yard", [night, noon])
    assert isinstance(film, xarray.DataArray) and film.dims == ("time", "y", "x")
    door = film.sel(y=3.75, x=-1.75, method="nearest")
    assert door.values[0] > 0.8 and door.values[1] < 0.2
    client.delete_map("yard")
