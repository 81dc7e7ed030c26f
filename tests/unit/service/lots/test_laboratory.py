"""A sieving of the laboratory, and its place beside the instrument's curve."""

import sqlite3

import pytest

from pipeline.gradation.sieves import OF_THE_RIG
from service.base.tables.lines import TableError
from service.lots.laboratory import Sieving
from service.lots.plausibility import history_of
from service.lots.tables.history import read_history


def test_what_passes_a_sieve_lies_below_it() -> None:
    retained_g = {31.5: 0.0, 20: 50.0, 16: 150.0, 12.5: 250.0, 10: 250.0, 8: 150.0, 6.3: 100.0, 4: 40.0}
    passing = Sieving(retained_g=retained_g, pan_g=10.0).passing_percent
    assert list(passing) == sorted(retained_g)
    assert [round(passing[sieve_mm], 9) for sieve_mm in sorted(passing, reverse=True)] == [
        100, 95, 80, 55, 30, 15, 5, 1,
    ]  # fmt: skip


def test_a_history_has_a_bound() -> None:
    rows = "".join(f"\nL{number};8;3" for number in range(201))
    with pytest.raises(TableError, match="201 lots, more than 200"):
        history_of(sqlite3.connect(":memory:"), f"Lot;Sieve mm;g{rows}", None, None, OF_THE_RIG)
    with pytest.raises(TableError, match="201 sievings, more than 200"):
        read_history(f"Lot;Sieve mm;g{rows}")
    with pytest.raises(TableError, match="9000 sievings, more than 200"):  # before the first is read
        read_history("Lot;Passing % 8 mm" + "\na;5" * 9_000)
    with pytest.raises(TableError, match="more than 10000 lines"):
        read_history("\n" * 20_000 + "Lot;Passing % 8 mm\na;5")


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({}, "needs sieves"),
        ({"given_passing_percent": {8.0: 50.0, 4.0: 60.0}}, "fall"),
        ({"given_passing_percent": {8.0: 101.0}}, "0 to 100"),
        ({"given_passing_percent": {8.0: 50.0}, "retained_g": {8.0: 50.0}}, "without masses"),
        ({"given_passing_percent": {8.0: 50.0}, "dry_mass_g": 1.0}, "dry_mass_g"),
        ({"retained_g": {8.0: 0.0}}, "nothing was weighed"),
        ({"retained_g": {8.0: 1e7}}, "8 mm"),
    ],
)
def test_a_sieving_that_says_nothing_or_two_things_is_refused(given: dict[str, object], named: str) -> None:
    with pytest.raises(TableError, match=named):
        Sieving(**given)
