"""What laboratories write, as it comes."""

import pytest

from service.lots.laboratory import Sieving, SievingError, parse_table


def test_what_passes_a_sieve_lies_below_it() -> None:
    retained_g = {31.5: 0.0, 20: 50.0, 16: 150.0, 12.5: 250.0, 10: 250.0, 8: 150.0, 6.3: 100.0, 4: 40.0}
    passing = Sieving(retained_g=retained_g, pan_g=10.0).passing_percent
    assert list(passing) == sorted(retained_g)
    assert [round(passing[sieve_mm], 9) for sieve_mm in sorted(passing, reverse=True)] == [
        100, 95, 80, 55, 30, 15, 5, 1,
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "16;250\n8;740\npan;10",
        "Sieve mm;retained g\n16;250\n8;740\nBoden;10\n",
        "mm;kg\r\n16,0;0,250\r\n8;0,74\r\n0;0,01",
        "16 mm\t250 g\n8 mm\t740g\nPan\t10",
        "16;0,25 kg;\n8;740;\n pan ; 10 g ;",
    ],
)
def test_tables_are_read_as_spreadsheets_write_them(text: str) -> None:
    sieving = parse_table(text, by="lab")
    assert sieving.retained_g == pytest.approx({16.0: 250.0, 8.0: 740.0})
    assert (sieving.pan_g, sieving.by) == (pytest.approx(10.0), "lab")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("16;250\n16;3", "line 2.*twice"),
        ("16;250\n8;a lot", "line 2"),
        ("16;250\n1.2.3;5", "line 2.*1.2.3"),
        ("", "needs sieves"),
        ("16;0\n8;0", "nothing was weighed"),
        ("0;10", "needs sieves"),
        ("16;99999999", "16 mm"),
        ("nan;5", "above 0"),
        ("1e999;5", "above 0"),
        ("\n".join(f"{mm};1" for mm in range(1, 102)), "line 101.*more than 100"),
        ("8;1" + 20_000 * " " + "x", "line 1|needs sieves"),
        ("16;1\n8;1" + 20_000 * " " + "x", "line 2"),
        ("16;1\n" + 20_000 * "8", "line 2"),
        ("16;1\n" + 10_000 * "8;", "line 2"),
        (20_000 * "8" + ";" + 20_000 * "1", "above 0|grams"),
    ],
)
def test_a_table_that_cannot_be_read_is_named_by_its_line(text: str, named: str) -> None:
    with pytest.raises(SievingError, match=named):
        parse_table(text)
