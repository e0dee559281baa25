"""The examples of the guide's page run as a reader would type them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "src" / "python.md"


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
