"""Tasks from Python: added, planned, kept and reported; and the script of the guide."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import tidemap

PAGE = Path(__file__).parents[3] / "docs" / "src" / "tasks.md"


def _building(client):
    pandas = pytest.importorskip("pandas")
    edges = [{"from": "Dock", "to": "Hall", "nominal_secs": 20, "both_ways": True}]
    client.load_topology(client.name, pandas.DataFrame(edges))


def test_a_plan_is_made_and_kept(client):
    _building(client)
    added = client.add_task(client.name, "clean", "Hall", 600, begin="09:00", end="10:00", value=2.0)
    assert (added["from_secs"], added["until_secs"], added["weekdays"]) == (32_400, 36_000, 127)
    client.add_task(client.name, "clean", "Attic", 600)
    assert list(client.tasks(client.name)["node"]) == ["Attic", "Hall"]
    planned = client.plan_tasks(client.name, "2016-01-05", start_node="Dock", keep=True)
    assert list(planned["kind"]) == ["clean"] and str(planned["start"][0]) == "2016-01-05 09:00:00+00:00"
    assert planned.attrs["proven"] and planned.attrs["unserved"][0]["reason"] == "UNSERVED_REASON_UNKNOWN_NODE"
    assert len(planned.attrs["slots"]) == 96
    kept = client.kept_plan(client.name, at="2016-01-05T09:05:00Z")
    assert (kept.attrs["date"], kept.attrs["current"], kept["node"][0]) == ("2016-01-05", 0, "Hall")
    assert client.kept_plan(client.name, "2016-01-05", at="2016-01-05T12:00:00Z").attrs["current"] is None
    client.remove_task(client.name, "clean", "Attic")
    with pytest.raises(tidemap.errors.NotFound):
        client.remove_task(client.name, "clean", "Attic")
    with pytest.raises(tidemap.errors.NotFound):
        client.kept_plan(client.name, "2016-01-06")
    with pytest.raises(tidemap.errors.InvalidArgument, match="time of day"):
        client.add_task(client.name, "clean", "Hall", 600, begin="nine")


def test_reports_count_once(client):
    pytest.importorskip("pandas")
    for _ in range(2):
        number = client.report_task(
            client.name, "clean", "Hall", "2016-01-05T09:00:00Z", "2016-01-05T10:00:00Z", True, sequence=1
        )
        assert number == 1
    weeks = client.task_weeks(client.name, "08:00", "18:00")
    assert (weeks["runs"][0], weeks["active_secs"][0], weeks["autonomy_percent"][0]) == (1, 3600.0, 10.0)
    with pytest.raises(tidemap.errors.InvalidArgument):
        client.report_task(client.name, "cl/ean", "Hall", "2016-01-05T09:00:00Z", "2016-01-05T10:00:00Z", True)


def test_the_script_of_the_guide_runs():
    pandas = pytest.importorskip("pandas")
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, str(PAGE), "exec"), names)  # noqa: S102
    planned = names["planned"]
    assert list(planned["kind"]) == ["greet", "inspect"]
    assert planned["start"][1] >= pandas.Timestamp("2016-02-02 13:00", tz="UTC")
    # Half an hour of ten.
    assert abs(names["weeks"]["autonomy_percent"][0] - 5.0) < 1e-9
