"""The guide defines every figure that is measured."""

from dataclasses import fields
from pathlib import Path

import pytest

from pipeline.measuring import ShapeMeasurement

GUIDE = Path(__file__).parents[4] / "pipeline" / "README.md"


@pytest.mark.parametrize("name", [field.name for field in fields(ShapeMeasurement)])
def test_every_measured_figure_has_its_row_in_the_guide(name: str) -> None:
    assert f"\n| `{name}` | " in GUIDE.read_text()
