"""Tables of many sievings: a line a lot or a line a sieve, each taken or refused by itself."""

import pytest

from service.base.tables.lines import TableError
from service.lots.tables.history import RefusedRow, read_history
from service.lots.tables.sievings import ReadTable


def test_a_line_is_a_sieving_and_each_is_read_by_itself() -> None:
    rows = read_history(
        "Los;Datum;Probe;Durchgang % 16 mm;Durchgang % 8 mm;Durchgang % 4 mm\n"
        "L-1;02.03.2026;S 1;91,5;12,4;1,8\n"
        "L-2;2026-03-03;;90;95;1\n"
        ";04.03.2026;;90;10;1\n"
        "L-4;gestern;;90;10;1\n"
        "L-5;;;90;;1\n"
        "L-6;;;90;zehn;1\n"
    )
    first, *_, fifth, _ = rows
    assert isinstance(first, ReadTable) and isinstance(fifth, ReadTable)
    assert (first.lot, first.line, first.sieving.sieved_on, first.sieving.sample_id) == (
        "L-1",
        2,
        "2026-03-02",
        "S 1",
    )
    assert first.sieving.passing_percent == {4.0: 1.8, 8.0: 12.4, 16.0: 91.5}
    assert fifth.sieving.passing_percent == {4.0: 1.0, 16.0: 90.0}  # the other sieve was not used
    refused = [each for each in rows if isinstance(each, RefusedRow)]
    assert [(each.lot, each.line) for each in refused] == [("L-2", 3), (None, 4), ("L-4", 5), ("L-6", 7)]
    for each, why in zip(refused, ("95 after 90", "names no lot", "gestern", "not a number"), strict=True):
        assert why in each.reason


def test_masses_have_a_pan_and_commas_of_csv_are_no_decimal_marks() -> None:
    (row,) = read_history(
        '"Lot","Date","Retained g 8 mm","Retained g 4 mm","Pan g"\n"L-1","2026-03-02",100.5,200,99.5\n'
    )
    assert isinstance(row, ReadTable)
    assert (row.sieving.retained_g, row.sieving.pan_g) == ({8.0: 100.5, 4.0: 200.0}, 99.5)


def test_a_line_may_be_a_sieve_as_before_and_an_error_names_its_own_line() -> None:
    good, bad = read_history(
        "Lot\tDate\tSieve mm\tRetained g\nA\t2026-03-02\t8\t10\nB\t\t8\t10\nA\t2026-03-02\t4\t5\nB\t\t8\t10\n"
    )
    assert isinstance(good, ReadTable) and isinstance(bad, RefusedRow)
    assert (good.lot, good.sieving.retained_g) == ("A", {8.0: 10.0, 4.0: 5.0})
    assert (bad.lot, bad.line) == ("B", 3)
    assert "line 5: sieve 8 mm is there twice" in bad.reason


@pytest.mark.parametrize(
    ("head", "why"),
    [
        ("Date;Passing % 8 mm", "one column 'Lot'"),
        ("Lot;16;8", "must say the same"),
        ("Lot;Passing % 16 mm;Retained g 8 mm", "must say the same"),
        ("Lot;Passing % 16 mm;Colour", "'Colour'"),
        ("", "needs sieves"),
    ],
)
def test_a_head_that_says_too_little_is_refused_as_a_whole(head: str, why: str) -> None:
    with pytest.raises(TableError, match=why):
        read_history(f"{head}\nL-1;50;10\n" if head else "")
