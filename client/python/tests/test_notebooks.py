"""The notebooks of the guide run, and show the promised results."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "docs" / "src" / "notebooks"


def run(name: str) -> dict[str, object]:
    """Runs the cells of a notebook one after the other; as in a notebook, the last line of a cell may be a value."""
    for package in ("pandas", "xarray"):
        pytest.importorskip(package)
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    path = FOLDER / f"{name}.py"
    names: dict[str, object] = {"__name__": name}
    try:
        for cell in re.split(r"^# %%.*\n", path.read_text(), flags=re.MULTILINE):
            exec(compile(cell, str(path), "exec"), names)  # noqa: S102
    finally:
        if "daemon" in names:
            names["daemon"].stop()
        matplotlib.pyplot.close("all")
    return names


def test_every_notebook_is_in_the_guide_and_tested():
    page = (FOLDER.parent / "notebooks.md").read_text()
    found = sorted(path.stem for path in FOLDER.glob("*.py"))
    assert found == ["door", "film", "home", "route"]
    for name in found:
        assert f"#include notebooks/{name}.py" in page


@pytest.mark.filterwarnings("ignore:Animation was deleted")
def test_a_building_as_a_film():
    shut = run("film")["shut"]
    assert (shut.loc["2026-03-24 12:00"][["lab", "kitchen"]] < 0.3).all()
    assert (shut.loc["2026-03-24 02:00"] > 0.7).all()


def test_a_door():
    names = run("door")
    assert names["monday_noon"]["door", "value"] > 0.8 > 0.1 > names["sunday_noon"]["door", "value"]
    scores = names["scores"].set_index("model")["mse"]
    assert scores["auto"] < 0.5 * scores["mean"]
    assert names["episodes"]["state"].tolist() == ["door"]


def test_sensors_of_a_home():
    names = run("home")
    assert names["sent"].accepted == len(names["log"]) and names["sent"].without_value == {"unavailable": 1}
    assert names["noon"]["door.study"] > 0.8 > 0.2 > names["noon"]["light.living"]
    assert names["evening"]["light.living"] > 0.8 > 0.2 > names["evening"]["door.study"]


def test_a_route():
    names = run("route")
    assert names["noon"]["to"].tolist() == ["Office"] and len(names["night"]) == 3
    assert names["day"]["edges"].tolist()[12] == 1 and names["day"]["success"].min() > 0.5
