"""The tables in guides are the program's: of the fields of a result, and of what each version changed."""

from dataclasses import fields
from pathlib import Path

import pytest

from pipeline.measuring import ShapeMeasurement
from service.results.fields import MEASURED_FIELDS, Result
from service.results.table import TABLES, fields_table, renewed
from service.results.version import ALGORITHM_VERSION, CHANGES

ROOT = Path(__file__).parents[4]


@pytest.mark.parametrize("guide", TABLES)
def test_the_table_in_the_guide_is_the_programs(guide: str) -> None:
    text = (ROOT / guide).read_text(encoding="utf-8")
    assert text == renewed(text, TABLES[guide]()), "run python -m service.results.table"


def test_each_version_of_the_algorithm_says_what_it_changed() -> None:
    assert list(CHANGES) == [str(1 + i) for i in range(int(ALGORITHM_VERSION))]


def test_every_field_has_a_row_and_says_when_it_is_null() -> None:
    rows = [line.split(" | ") for line in fields_table() if line.startswith("| `")]
    null_of = {row[0].strip("| `"): row[2] for row in rows}
    assert [name for name in null_of if "." not in name] == list(Result.model_fields)
    assert all(row[3].strip("| ") for row in rows), "each is described, here or in ShapeMeasurement"
    assert (null_of["seq"], null_of["reason"], null_of["volume_mm3"]) == ("no", "yes", "unless measured")
    assert (null_of["hull.volume_mm3"], null_of["optics.<camera>.contrast"]) == ("no", "yes")


def test_every_measure_of_the_shape_is_a_field() -> None:
    assert {field.name for field in fields(ShapeMeasurement)} <= set(MEASURED_FIELDS)
