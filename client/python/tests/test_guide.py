"""The examples of the guide's page and of the README run as a reader would type them."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "src" / "python.md"


def test_the_examples_of_the_guide_run():
    for package in ("pandas", "xarray", "sklearn"):
        pytest.importorskip(package)
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 6
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)  # noqa: S102
    prediction = names["prediction"]
    assert prediction.to_pandas().shape == (144, 3)
    assert prediction.values.max() > 0.8 > 0.2 > prediction.values.min()


def test_the_example_of_landmarks_runs():
    pytest.importorskip("pandas")
    text = (ROOT / "docs" / "src" / "landmarks.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "landmarks.md", "exec"), names)  # noqa: S102
    by_day = {name for name, day in zip(names["names"], names["by_day"]) if day}
    assert set(names["expected"]["landmark"]) <= by_day
    assert names["found"]["node"][0] == "gate" and names["found"]["votes"][0] == 10
    assert abs(names["found"]["heading_px"][0] - 12) < 1e-9


def test_the_example_of_flows_runs():
    pytest.importorskip("pandas")
    text = (ROOT / "docs" / "src" / "flows.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "flows.md", "exec"), names)  # noqa: S102
    flow = names["flow"]
    by_time = [cells for _, cells in flow.groupby("time")]
    assert [len(cells) for cells in by_time] == [10, 10]
    assert abs(by_time[0]["direction_rad"]).max() < 1e-9 and (by_time[1]["direction_rad"] < -3.1).all()
    assert flow["expected_count"].between(1, 3).all()


def test_the_example_of_ones_own_data_runs(tmp_path, monkeypatch):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("matplotlib").use("Agg")
    # The file has the form of the sample of a home, with fewer sensors.
    rows = [
        (day + pandas.Timedelta(hour, "h"), sensor, word)
        for day in pandas.date_range("2025-02-01", "2025-04-24")
        for sensor, on, off in (("light.hall", 18, 22), ("binary_sensor.office_door", 9, 17))
        for hour, word in ((on, "on"), (off, "off"))
    ]
    rows.append((pandas.Timestamp("2025-04-22 03:00"), "light.hall", "on"))
    export = pandas.DataFrame(sorted(rows), columns=["last_changed", "entity_id", "state"])
    (tmp_path / "sample-home").mkdir()
    export.to_csv(tmp_path / "sample-home" / "export.csv", index=False)
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "src" / "own-data.md").read_text()
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "own-data.md", "exec"), names)  # noqa: S102
    assert names["sent"].accepted == len(export)
    noon = names["forecast"].to_pandas().loc["2025-04-25 12:00"]
    assert noon["binary_sensor.office_door"] > 0.9 > 0.1 > noon["light.hall"]
    unusual = names["unusual"]
    assert unusual["state"][0] == "light.hall" and str(unusual["from"][0]).startswith("2025-04-22 03:")


def test_the_first_example_of_the_readme_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    text = (ROOT / "README.md").read_text()
    scripts = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    made = next(script for script in scripts if "door.csv" in script)
    monkeypatch.chdir(tmp_path)
    subprocess.run(["sh", "-c", made], check=True)
    (block,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)  # noqa: S102
    door = names["forecast"]["door"]["value"]
    assert door.idxmax().hour == 12 and door.max() > 0.9 > 0.1 > door.iloc[0]
