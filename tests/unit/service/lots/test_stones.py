"""From records of results to the stones of a lot."""

from typing import Any

import numpy as np
import pytest

from pipeline.gradation.stones import REQUIRED, Fate, Lot
from service.lots.stones import MEASURED_COLUMNS, lot_of_columns, stones_in
from service.results.fields import EMPTY

RECORD: dict[str, Any] = EMPTY | {
    "kind": "particle",
    "outcome": "measured",
    "quality": "reduced",
    "volume_mm3": 900.0,
    "volume_sd_percent": 3.0,
    "surface_sd_mm": 0.1,
    "sieve_size_mm": 11.0,
    "max_feret_mm": 16.0,
    "min_feret_mm": 9.0,
    "length_mm": 16.0,
    "width_mm": 12.0,
    "thickness_mm": 9.0,
}


def lot_of_records(records: list[dict[str, Any]]) -> Lot:
    return stones_in(records).lot


def test_measures_and_their_errors() -> None:
    lot = lot_of_records([RECORD])
    assert lot.counts == {(Fate.MEASURED, "reduced"): 1}
    assert lot.column("volume_sd") == pytest.approx([0.03])
    assert lot.column("sieve_size_sd_mm") == lot.column("feret_sd_mm") == pytest.approx([0.1414], abs=1e-4)


def test_results_of_versions_without_uncertainty_have_no_errors() -> None:
    lot = lot_of_records([RECORD | {"volume_sd_percent": None, "surface_sd_mm": None}])
    assert lot.column("volume_sd") == lot.column("sieve_size_sd_mm") == [0.0]


@pytest.mark.parametrize("name", MEASURED_COLUMNS)
def test_results_of_versions_that_measured_less_are_left_out_for_a_required_measure_only(name: str) -> None:
    record = RECORD | {name: None}
    lot = lot_of_records([record])
    assert lot.n_measured == (name not in REQUIRED)
    columns = lot_of_columns([[record[column] for column in MEASURED_COLUMNS]])
    np.testing.assert_array_equal(columns.measures, lot.measures)


def test_what_was_not_measured_counts_and_balls_do_not() -> None:
    lost = EMPTY | {"kind": None, "outcome": "lost", "reason": "crash"}
    rejected = EMPTY | {"kind": "particle", "outcome": "rejected", "reason": "clipped"}
    assert lot_of_records([RECORD | {"kind": "ball"}]).n_measured == 0
    lot = lot_of_records([lost, rejected, RECORD | {"kind": "ball"}])
    assert lot.n_measured == 0
    assert lot.counts == {(Fate.LOST, "crash"): 1, (Fate.REJECTED, "clipped"): 1}
