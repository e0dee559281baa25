"""Answers as tables and pictures, and the same calls with await."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

import tidemap

pandas = pytest.importorskip("pandas")

HOURS = pandas.date_range("2026-01-05", periods=21 * 24, freq="h", tz="Europe/Prague")
OPEN = (HOURS.hour >= 8) & (HOURS.hour < 18)
DOORS = [f"door{number:02}" for number in range(14)]


@pytest.fixture(scope="module")
def home(daemon):
    """Three weeks of fourteen doors and a lamp; in the last night the first door stands open."""
    client = daemon.connect()
    client.create_map("doors", time_zone="Europe/Prague")
    values = {name: OPEN.astype(float) for name in DOORS}
    client.observe("doors", pandas.DataFrame({**values, "lamp": ~OPEN}, index=HOURS))
    client.update("doors")
    night = pandas.date_range("2026-01-26", periods=6, freq="h", tz="Europe/Prague")
    client.observe("doors", pandas.DataFrame({"door00": 1.0, "door01": 0.0}, index=night), label="night")
    client.update("doors")
    yield client
    client.delete_map("doors")


DAY = pandas.date_range("2026-01-27", periods=24, freq="h", tz="Europe/Prague")


def test_all_states_are_predicted_or_those_like_a_pattern(home):
    everything = home.predict("doors", times=DAY)
    assert sorted(everything.states) == sorted([*DOORS, "lamp"])
    assert home.predict("doors", "door0*", DAY).states == DOORS[:10]
    assert home.predict("doors", ["lamp", "door00"], DAY).states == ["lamp", "door00"]
    with pytest.raises(tidemap.NotFound, match="window"):
        home.predict("doors", "window*", DAY)
    assert everything.observations[everything.states.index("lamp")] == len(HOURS)
    assert everything.pending == [0] * 15 and all(everything.models)
    assert everything.last_times[everything.states.index("lamp")] == HOURS[-1].tz_convert("UTC").tz_localize(None)


def test_predictions_are_frames_in_the_zone_of_the_map(home):
    predicted = home.predict("doors", ["door02", "lamp"], DAY.tz_convert("UTC"), interval=0.9)
    wide = predicted.to_pandas()
    assert str(wide.index.tz) == "Europe/Prague" and (wide.index == DAY).all()
    assert wide[("door02", "value")].idxmax().hour in range(8, 18)
    long = predicted.to_pandas(long=True)
    assert list(long) == ["time", "state", "probability", "lower", "upper", "entropy_bits"] and len(long) == 48
    assert (long[long["state"] == "lamp"]["probability"].to_numpy() == wide[("lamp", "value")].to_numpy()).all()


def test_pictures_are_in_the_zone_of_the_map(home):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    lines = home.predict("doors", ["door02", "lamp"], DAY, interval=0.9).plot()
    assert "Europe/Prague" in lines.get_xlabel() and len(lines.lines) == 2
    assert lines.lines[0].get_xdata(orig=True)[0] == np.datetime64("2026-01-27T00:00")
    heat = home.predict("doors", times=DAY).plot()
    assert not heat.lines and [label.get_text() for label in heat.get_yticklabels()] == [*DOORS, "lamp"]
    people = home.predict("doors", "lamp", DAY)
    people.values[:] += 3
    assert people.plot().get_ylabel() == "expected value" and lines.get_ylabel() == "probability"
    matplotlib.pyplot.close("all")


def test_predictions_say_what_they_are(home):
    shown = repr(home.predict("doors", times=DAY))
    assert shown == (
        "<tidemap.Predictions: 15 states × 24 times, 2026-01-27 00:00 to 2026-01-27 23:00 (Europe/Prague): "
        "door00, door01, door02, …>"
    )


def test_notebooks_show_tables(home):
    page = home.map("doors")._repr_html_()
    assert "doors" in page and "Europe/Prague" in page and "<b>doors</b>" in page
    shown = home.predict("doors", times=DAY)._repr_html_()
    assert "2026-01-27 00:00 to 2026-01-27 23:00 (Europe/Prague)" in shown and "<svg" in shown and "lamp" in shown


def test_names_are_no_markup(client):
    client.observe(client.name, {"time": DAY[:1], "state": "<script>", "value": [1]})
    shown = client.predict(client.name, times=DAY)._repr_html_()
    assert "<script>" not in shown and "&lt;script&gt;" in shown


def test_states_have_kinds_and_sensors(client):
    client.add_state(client.name, "badge", hit=0.9, false_alarm=0.05)
    client.add_state(client.name, "people", kind="count")
    assert client.add_state(client.name, "badge", hit=0.9, false_alarm=0.05)["name"] == "badge"
    table = client.states(client.name).set_index("state")
    assert table.loc["badge", ["hit", "false_alarm"]].tolist() == [0.9, 0.05]
    assert table.loc["people", "kind"] == "count" and np.isnan(table.loc["people", "hit"])
    assert table["last_time"].isna().all()
    with pytest.raises(tidemap.AlreadyExists):
        client.add_state(client.name, "badge", kind="count")
    with pytest.raises(tidemap.InvalidArgument, match="STATE_KIND_DOOR"):
        client.add_state(client.name, "x", kind="door")


def test_what_was_unusual(home):
    episodes = home.anomalies("doors", from_time="2026-01-26", zone="local")
    assert list(episodes)[:5] == ["from", "to", "state", "observations", "surprise_bits"]
    assert episodes["state"].tolist() == ["door00"] and episodes["observations"][0] == 6
    assert str(episodes["from"][0]) == "2026-01-26 00:00:00+01:00" and episodes["surprise_bits"][0] > 6
    assert home.anomalies("doors", ["lamp", "door01"]).empty
    readings = home.anomalies("doors", "door00", confidence=0.6, model="spectral")
    assert list(readings) == ["time", "value", "probability"]


def test_history_is_what_was_observed(home):
    lamp = home.history("doors", "lamp", "2026-01-06T00:00", "2026-01-07T00:00", zone="local")
    assert len(lamp) == 24 and lamp["value"].tolist() == (~OPEN[24:48]).astype(float).tolist()
    assert (lamp["time"] == HOURS[24:48]).all() and set(lamp["state"]) == {"lamp"}
    assert len(home.history("doors")) == 15 * len(HOURS) + 12


def test_evaluate_compares_models(home):
    frame = pandas.DataFrame({"lamp": (DAY.hour < 8) | (DAY.hour >= 18)}, index=DAY)
    table = home.evaluate("doors", frame, models=["mean", "histogram:24", "auto"])
    assert list(table) == ["state", "model", "order", "n", "mse", "error_rate"]
    assert table["model"].tolist() == ["mean", "histogram:24", "auto"] and (table["n"] == 24).all()
    assert table["mse"][0] > 0.2 > 0.01 > table["mse"][2]
    orders = home.evaluate("doors", frame, models="spectral", max_order=2)
    assert orders["order"].tolist() == [0, 1, 2]
    with pytest.warns(tidemap.ObservationWarning, match="poisson"):
        everything = home.evaluate("doors", frame, models="all", max_order=1)
    assert everything.attrs["unavailable"] and "mean" in set(everything["model"])


def test_routes_over_a_topology(client):
    edges = pandas.DataFrame({"from": ["Lab", "Lab", "Hall"], "to": ["Office", "Hall", "Office"],
                              "length_m": [10.0, 10.0, 10.0], "both_ways": True})
    nodes = pandas.DataFrame({"name": ["Lab", "Hall", "Office"], "x_m": [0.0, 5, 10], "y_m": [0.0, 5, np.nan]})
    size = client.load_topology(client.name, edges, nodes)
    assert (size["nodes"], size["edges"]) == (3, 6)
    topology = client.topology(client.name)
    assert topology.nodes["name"].tolist() == ["Lab", "Hall", "Office"] and len(topology.edges) == 6
    assert topology.edges["length_m"].tolist() == [10] * 6 and topology.edges["nominal_secs"].isna().all()
    # The direct way is closed at night.
    start = HOURS[:14 * 24]
    runs = pandas.DataFrame({"from": "Lab", "to": "Office", "start": start, "end": start + pandas.Timedelta("20s"),
                             "success": OPEN[: len(start)],
                             "reason": np.where(OPEN[: len(start)], None, "door closed")})
    sent = client.traverse(client.name, runs)
    assert sent.accepted == len(runs) and client.traverse(client.name, runs).duplicate == len(runs)
    client.update(client.name)
    noon = client.route(client.name, "Lab", "Office", "2026-01-20T11:00:00Z", alternatives=1)
    night = client.route(client.name, "Lab", "Office", "2026-01-20T01:00:00Z")
    best = noon[noon["route"] == 0]
    assert best[["from", "to"]].values.tolist() == [["Lab", "Office"]] and set(noon["route"]) == {0, 1}
    assert night["to"].tolist() == ["Hall", "Office"] and (night["step"] == [1, 2]).all()
    assert 0.8 < best["probability"][0] <= 1 and night.attrs["routes"][0]["success"] > 0
    assert str(night["time"][0]) == "2026-01-20 01:00:00+00:00"
    with pytest.raises(tidemap.InvalidArgument, match="no end"):
        client.traverse(client.name, runs.drop(columns="end"))
    with pytest.raises(tidemap.InvalidArgument, match="'lenght_m'"):
        client.load_topology(client.name, edges.rename(columns={"length_m": "lenght_m"}))


def test_where_to_look_and_what_to_do_are_tables(client):
    edges = pandas.DataFrame({"from": ["Lab", "Hall"], "to": ["Hall", "Office"], "nominal_secs": [20.0, 30.0],
                              "both_ways": True, "action": [None, "elevator"]})
    client.load_topology(client.name, edges.convert_dtypes())
    looks = pandas.DataFrame({"Hall": OPEN, "Office": ~OPEN, "Lab": 0}, index=HOURS)
    client.observe(client.name, looks)
    client.update(client.name)
    found = client.search(client.name, "Lab", "", HOURS[-1] + pandas.Timedelta("13h"))
    assert list(found) == ["step", "node", "arrival_secs", "probability"]
    assert found["probability"].idxmax() == found["node"].tolist().index("Hall")
    assert found.attrs["expected_secs"] > 0
    policy = client.policy(client.name, "Office", HOURS[-1])
    assert list(policy) == ["slot", "node", "next", "action", "expected_secs", "probability"]
    at_lab, at_hall = (policy[policy["node"] == node].iloc[0] for node in ("Lab", "Hall"))
    assert (at_lab["next"], at_lab["action"]) == ("Hall", "take") and at_hall["action"] == "take:elevator"
    assert policy[policy["node"] == "Office"]["action"].unique().tolist() == ["arrived"]
    assert policy["slot"][0] == HOURS[-1] and len(policy) == 3 * policy["slot"].nunique()
    bits = client.information(client.name, HOURS[-48:])
    assert list(bits) == ["time", "target", "information_bits", "entropy_bits"] and len(bits) == 3 * 48
    assert (bits["entropy_bits"] >= 0).all() and set(bits["target"]) == {"Hall", "Office", "Lab"}
    assert set(client.information(client.name, HOURS[:1], "Of*")["target"]) == {"Office"}
    day = client.day(client.name, "2026-01-27", explore=4)
    assert list(day) == ["slot", "start", "location", "information_bits"] and len(day) == 96
    assert (day["location"] != "").sum() == 4 and str(day["start"][0]) == "2026-01-27 00:00:00+00:00"


def test_a_tour_is_a_table(client):
    name = f"{client.name}-grid"
    client.create_map(name, grid_resolution_m=0.5)
    seen = np.zeros((7 * 24, 16, 16), dtype=np.int8)
    seen[:, 8, 8] = OPEN[: 7 * 24]
    client.observe_grids(name, HOURS[: 7 * 24], seen)
    client.update(name)
    tour = client.tour(name, HOURS[7 * 24], 2, start=(1.0, 1.0))
    assert list(tour) == ["step", "x", "y", "information_bits", "reachability", "arrival_secs"]
    assert len(tour) > 0 and tour["x"].between(0, 8).all() and tour.attrs["length_m"] > 0
    assert tour.attrs["path"][0] == (1.0, 1.0)
    with pytest.raises(tidemap.FailedPrecondition, match="no start was given"):
        client.tour(name, HOURS[7 * 24], 2)
    client.delete_map(name)


def test_a_cell_without_a_value_may_be_any_of_pandas(client):
    edges = pandas.DataFrame({"from": ["a"], "to": ["b"], "length_m": [5.0], "action": [pandas.NA]})
    assert client.load_topology(client.name, edges)["edges"] == 1
    runs = pandas.DataFrame({"from": "a", "to": "b", "start": HOURS[:3], "end": HOURS[:3] + pandas.Timedelta("9s"),
                             "success": [True, False, True], "reason": [None, "door", pandas.NA]})
    assert client.traverse(client.name, runs).accepted == 3
    assert client.traverse(client.name, runs.convert_dtypes()).duplicate == 3
    with pytest.raises(tidemap.InvalidArgument, match="row 1 has no state"):
        client.observe(client.name, {"time": HOURS[:2], "state": ["a", pandas.NA], "value": [0, 1]})


def test_every_call_is_there_with_await(daemon):
    waiting = tidemap.aio.AsyncClient(daemon.connect())
    calls = {name for name in dir(tidemap.Client) if not name.startswith("_")} - {"server"}
    assert calls - {name for name in dir(waiting) if not name.startswith("_")} == set()
    waiting.close()


def test_the_same_calls_with_await(daemon):
    async def use() -> None:
        async with await tidemap.aio.connect(daemon.grpc) as client:
            await client.create_map("waiting")
            frame = pandas.DataFrame({"door": OPEN}, index=HOURS)
            assert (await client.observe("waiting", frame)).accepted == len(HOURS)
            await client.update("waiting")
            many = await asyncio.gather(*[client.predict("waiting", "door", DAY) for _ in range(8)])
            assert all((one.values == many[0].values).all() for one in many)
            assert (await client.states("waiting"))["observations"].tolist() == [len(HOURS)]
            with pytest.raises(tidemap.NotFound):
                await client.predict("waiting", "window", DAY)
            watch = client.watch_anomalies("waiting", confidence=0.9)
            seen = asyncio.ensure_future(watch.__anext__())
            # Until the watch has begun, observations are not judged.
            nights = 0
            while not seen.done():
                nights += 1
                strange = {"time": [DAY[2]], "state": ["door"], "value": [1]}
                await client.observe("waiting", strange, label=f"night {nights}")
                await asyncio.sleep(0.05)
            assert (await seen)["states"] == ["door"]
            # An iterator that waits for nothing more ends with the client.
            waiting = asyncio.ensure_future(watch.__anext__())
            await asyncio.sleep(0.05)
            watch.close()
            with pytest.raises(StopAsyncIteration):
                # Nights that were on their way come first.
                for _ in range(nights + 1):
                    await waiting
                    waiting = asyncio.ensure_future(watch.__anext__())
            await client.delete_map("waiting")

    asyncio.run(use())
