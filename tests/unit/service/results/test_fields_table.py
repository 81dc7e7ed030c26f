"""The list of result fields in the guide is the program's."""

from dataclasses import fields
from pathlib import Path

from pipeline.measuring import ShapeMeasurement
from service.results.fields import MEASURED_FIELDS, Result
from service.results.table import BEGIN, END, fields_table

GUIDE = Path(__file__).parents[4] / "service" / "web" / "README.md"


def test_the_table_in_the_guide_is_the_programs() -> None:
    _, begin, rest = GUIDE.read_text(encoding="utf-8").partition(BEGIN)
    table, end, _ = rest.partition(END)
    assert f"{begin}{table}{end}\n" == fields_table(), (
        f"run python -m service.results.table, and put what it prints into {GUIDE}"
    )


def test_every_field_has_a_row_and_says_when_it_is_null() -> None:
    rows = [line.split(" | ") for line in fields_table().splitlines() if line.startswith("| `")]
    null_of = {row[0].strip("| `"): row[2] for row in rows}
    assert [name for name in null_of if "." not in name] == list(Result.model_fields)
    assert all(row[3].strip("| ") for row in rows), "each is described, here or in ShapeMeasurement"
    assert (null_of["seq"], null_of["reason"], null_of["volume_mm3"]) == ("no", "yes", "unless measured")
    assert (null_of["hull.volume_mm3"], null_of["optics.<camera>.contrast"]) == ("no", "yes")


def test_every_measure_of_the_shape_is_a_field() -> None:
    assert {field.name for field in fields(ShapeMeasurement)} <= set(MEASURED_FIELDS)
