"""Tables of laboratories, as they come: read as they are meant, or refused."""

from collections.abc import Mapping

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.base.tables.lines import TableError
from service.lots.tables.sievings import read_table, read_tables

GRAMS = {16.0: 250.0, 8.0: 740.0}


@pytest.mark.parametrize(
    "text",
    [
        "16;250\n8;740\npan;10",
        "Sieve mm;retained g\n16;250\n8;740\nBoden;10\n",
        "mm;kg\r\n16,0;0,250\r\n8;0,74\r\n0;0,01",
        "16 mm\t250 g\n8 mm\t740g\nPan\t10",
        "16;0,25 kg;\n8;740;\n pan ; 10 g ;",
        "\ufeff16;250\n8;740\nBoden;10",
        "sep=;\n16;250\n8;740\nBoden;10",
        "16,250\n8,740\npan,10",
        '"Sieve, mm","Retained, g"\n16,"250.0"\n8,740\npan,10',
        "Sieb µm;Rückstand in kg\n16000;0,25\n8000;0,74\nBoden;0,01",
        "Aperture (um);Mass [g]\n16000;250\n8000;740\nPan;10",
        "Sieve;Mass retained\nmm;g\n16;250\n8;740\nPan;10",
        "Rückstand g;Maschenweite mm\n250;16\n740;8\n10;Boden",
        "Maschenweite (mm)\tRückstand (g)\n8\t740\n16\t250\n0\t10\n\t\n",
        "Sieve mm;retained g;retained %;cumulative %;% finer\n16;250;25;25;75\n8;740;74;99;1\nPan;10;1;100;0",
        "Sieb mm;Rückstand g;Rückstand %;Summe Rückstand %;Durchgang M.-%\n16;250;25,0;25,0;75,0\n8;740;74,0;99,0;1,0\n"
        "Boden;10;1,0;100,0;0,0\nSumme;1000;100,0",
        "Sieve mm;Cumulative retained g\n16;250\n8;990\nPan;1000",
        "Siebweite;Masse\n16;0,25 kg\n8;0,740 kg\nBoden;10,0",
        "Size (mm),Mass Retained (g),% Passing\n16,250,75\n8,740,1\nPan,10,0\nTotal,1000,\n,,",
        "63 µm;10\n16;250\n8;730\npan;10",
    ],
)
def test_tables_are_read_as_laboratories_write_them(text: str) -> None:
    sieving = read_table(text).sieving
    grams = GRAMS if "63" not in text else {16.0: 250.0, 8.0: 730.0, 0.063: 10.0}
    assert sieving.retained_g == pytest.approx(grams)
    assert sieving.pan_g == pytest.approx(10.0)


@pytest.mark.parametrize(
    "text",
    [
        "Sieve mm;Passing %\n16;100\n8;45\n4;12\n2;3",
        "Siebweite;Durchgang %\n16;100\n8;45\n4;12\n2;3\nBoden;0",
        "Sieb µm;Durchgang in M.-%\n2000;3,0\n4000;12,0\n8000;45,0\n16000;100,0",
        "Sieve,Finer\n16,100\n8,45 %\n4,12\n2,3",
        "Sieve mm;Retained %\n16;0\n8;55\n4;33\n2;9\nPan;3",
        "Sieb mm;Rückstand kumuliert %\n16;0\n8;55\n4;88\n2;97",
        "Sieve mm;% retained;Cumulative %;% passing\n16;0;0;100\n8;55;55;45\n4;33;88;12\n2;9;97;3\nPan;3;100;0",
        "Sieb;Prozent Durchgang\n16;100\n8;45.000\n4;12\n2;3",  # 45000 % cannot be
    ],
)
def test_percents_stay_percents(text: str) -> None:
    sieving = read_table(text).sieving
    assert sieving.passing_percent == pytest.approx({2.0: 3.0, 4.0: 12.0, 8.0: 45.0, 16.0: 100.0})
    assert (sieving.retained_g, sieving.pan_g, sieving.mass_g) == ({}, None, None)


@pytest.mark.parametrize(
    ("text", "grams"),
    [
        ("Sieve;lb\n16;0\n8;3.2\nPan;0.3", {16: 0.0, 8: 3.2 * 453.59237}),
        ("Sieve µm;g\n16000;0\n8000;300\n4000;100\nPan;3", {16: 0.0, 8: 300.0, 4: 100.0}),
        ("16;0\n11,2;120,5\n8;300\nBoden;12,5", {16: 0.0, 11.2: 120.5, 8: 300.0}),
        ("Sieb;g\n16;0\n8;1.234,5\n4;2.500", {16: 0.0, 8: 1234.5, 4: 2500.0}),
        ("Sieb;g\n16;0,0\n8;1.234\n4;2.500", {16: 0.0, 8: 1234.0, 4: 2500.0}),
        ("mm;kg\n16;0.250\n8;1.234", {16: 250.0, 8: 1234.0}),
        ("8;1 234,5\n4;2 500", {8: 1234.5, 4: 2500.0}),
        ("8;1'234.5\n4;2500", {8: 1234.5, 4: 2500.0}),
        ("8,0;120.5\n4,0;80.5", {8: 120.5, 4: 80.5}),  # each number has one reading
        ("4.750;250\n2.360;10", {4.75: 250.0, 2.36: 10.0}),  # no sieve has 4750 mm
        ("8;1,234,567.0", {8: 1234567.0}),
    ],
)
def test_units_and_marks_are_those_that_the_table_shows(text: str, grams: Mapping[float, float]) -> None:
    assert read_table(text).sieving.retained_g == pytest.approx(grams)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "needs sieves"),
        ("Sieve mm;g", "needs sieves"),
        ("16;250\n16;3", "line 2.*twice"),
        ("16;250\npan;3\n0;3", "line 3.*twice"),
        ("16;250\n8;a lot", "line 2.*a lot"),
        ("16;250\n1.2.3;5", "line 2.*1.2.3"),
        ("16;0\n8;0", "nothing was weighed"),
        ("0;10", "needs sieves"),
        ("16;99999999", "16 mm"),
        ("16;-1", "line 1.*-1"),
        ("nan;5", "line 1"),
        ("1e999;5", "line 1"),
        ("16000;5", "line 1.*aperture"),
        ("\n".join(f"{mm};1" for mm in range(1, 102)), "line 101.*more than 100"),
        ("8;1" + 20_000 * " " + "x", "line 1"),
        ("16;1\n8;1" + 20_000 * " " + "x", "line 2"),
        ("16;1\n" + 20_000 * "8", "line 2"),
        ("16;1\n" + 10_000 * "8;", "line 2"),
        (20_000 * "8" + ";" + 20_000 * "1", "line 1"),
        ("16;1\n-;5", "line 2.*aperture"),
        ("16;1\n8;", "line 2"),
        ("16;0;0\n8;300\n4;20\nBoden;3", "line 1.*head"),
        ("11,2,120\n8,300", "line 2.*semicolons"),
        ("Sieve mm,g\n11,2,120", "line 2.*semicolons"),
        ("Sieb;g\n16;0\n8;1.234\n4;2.500\nBoden;12", "line 3.*1.234 or 1234"),
        ("16;0\n8;2,500", "line 2.*2500 or 2.5"),
        ("16;1.234\n8;2.500", "line 1.*1.2340"),
        ("12.5;20,5\n8;1.234", "line 2.*1.234 or 1234"),
        ("Number;Value\n16;3", "line 1.*column 1.*'Number'"),
        ("Sieve mm;Limit g\n16;3", "line 1.*column 2"),
        ("Sieve No;g\n16;3", "line 1.*column 1"),
        ("Sieve #;g\n16;3", "line 1.*column 1"),
        ("Mesh;g\n16;3", "line 1.*column 1"),
        ("Sieve in;g\n16;3", "line 1.*column 1"),
        ("Sieve mm;Mass of sieve g\n16;3", "line 1.*column 2"),
        ("Sieve mm;%\n16;3", "line 1.*column 2"),
        ("Sieve mm;Retained oz\n16;3", "line 1.*column 2"),
        ("Sieve mm;Retained\n16;30\n8;70", "column 2.*unit"),
        ("Sieve mm;Cumulative g\n16;30\n8;70", "no column tells"),
        ("Sieve mm;Passing g\n16;30\n8;70", "no column tells"),
        ("Sieve mm;Passing\n16;30\n8;10", "column 2.*unit"),
        ("Sieve mm;g\n16;30 %", "line 2.*in %"),
        ("Sieve mm;g\n16;30 mm", "line 2.*in mm"),
        ("Sieve mm;g;\n16;30;7", "line 2.*column 3.*no head"),
        ("Sieve mm;g;kg\n16;30;7", "column 2.*column 3"),
        ("Sieve mm;Passing %\n16;45\n8;100", "line 3.*sieve 8 mm.*falls"),
        ("Sieve mm;Passing %\n16;145\n8;100", "line 2.*100 %"),
        ("Sieve mm;Passing %\n16;90\n8;10\nPan;3.0", "line 4.*pan"),
        ("Sieve mm;Retained %\n16;40\n8;50", "add up to 90"),
        ("Sieve mm;Cumulative retained %\n16;40\n8;30", "line 3.*rises"),
        ("Sieve mm;g;%\n16;40;3", "line 1.*column 3"),
        ("Sieve mm;g;% finer\n16;250;75\n8;740;10\nPan;10;0", "line 3.*sieve 8 mm.*column 3"),
        ("Sieve mm;g;% retained\n16;250;74\n8;740;25\nPan;10;1", "line 2.*sieve 16 mm.*column 3"),
        ("Sieve mm;g\n16;250\n8;740\nSum;900", "line 4.*sum"),
        ("Sieve mm;g;Retained\n16;250;1\nx;1;1", "line 3|column 3"),
        ("lot;mm;g\nL1;16;250", "column of lots"),
        ("[];()\n16;250", "line 2.*no head|0 columns"),
        ("mm;g" + 30 * ";g" + "\n16;250", "line 1.*more than 20 columns"),
        ("mm;g\n16;" + 140_000 * "1", "line 2.*limit"),
    ],
)
def test_what_is_not_clear_is_refused_by_its_line(text: str, named: str) -> None:
    with pytest.raises(TableError, match=named):
        read_table(text)


def test_the_reading_is_told_in_words() -> None:
    read = read_table("Sieb µm;Durchgang %\n16000;100\n8000;45,5")
    assert read.understood == "column 1: aperture in µm; column 2: passing in %; decimal comma"


def test_a_column_of_lots_makes_a_sieving_each() -> None:
    tables = read_tables("Los;Sieb mm;g\nL1;16;250\nL2;16;20,5\nL1;8;740\nL1;Boden;10\nL2;8;3")
    assert {lot: (read.line, read.sieving.retained_g) for lot, read in tables.items()} == {
        "L1": (2, {16.0: 250.0, 8.0: 740.0}),
        "L2": (3, {16.0: 20.5, 8.0: 3.0}),
    }
    with pytest.raises(TableError, match=r"line 3.*no lot"):
        read_tables("Los;Sieb mm;g\nL1;16;250\n;8;3")


def written(number: float, decimals: int, mark: str, groups: str) -> str:
    text = f"{number:,.{decimals}f}"
    return "".join({".": mark, ",": groups}.get(each, each) for each in text)


@given(
    grams=st.lists(st.integers(0, 5_000_000), min_size=2, max_size=7).filter(any),
    apertures_mm=st.permutations([0.063, 0.25, 1.0, 2.0, 4.0, 5.6, 8.0, 11.2, 16.0, 31.5, 63.0]),
    separator=st.sampled_from([";", "\t", ","]),
    mark=st.sampled_from([".", ","]),
    is_grouped=st.booleans(),
    mass=st.sampled_from([("g", 1.0, 1), ("kg", 1000.0, 3), ("kg", 1000.0, 4), ("lb", 453.59237, 3)]),
    length=st.sampled_from([("mm", 1.0, 3), ("µm", 1e-3, 0)]),
    layout=st.sampled_from(["bare", "g", "passing", "retained", "sheet"]),
    has_unit_behind=st.booleans(),
)
def test_a_table_is_read_back_the_same_or_refused(
    grams: list[int],
    apertures_mm: list[float],
    separator: str,
    mark: str,
    is_grouped: bool,
    mass: tuple[str, float, int],
    length: tuple[str, float, int],
    layout: str,
    has_unit_behind: bool,
) -> None:
    *on_sieves, pan = [each / 10 for each in grams]
    sieves = sorted(zip(apertures_mm, on_sieves, strict=False), reverse=True)
    (mass_name, in_g, mass_decimals), (length_name, in_mm, length_decimals) = mass, length
    if layout == "bare":
        (mass_name, in_g, mass_decimals), (length_name, in_mm, length_decimals) = (
            ("g", 1.0, 1),
            ("mm", 1.0, 3),
        )
    groups = {".": ",", ",": "."}[mark] if is_grouped else ""
    total = sum(on_sieves) + pan

    def cell(value: float, decimals: int, unit: str) -> str:
        text = written(value, decimals, mark, groups)
        quoted = f"{text} {unit}" if has_unit_behind and layout != "bare" else text
        return f'"{quoted}"' if separator == "," and "," in quoted else quoted

    heads = {
        "bare": [],
        "g": [f"Sieve {length_name}", f"Retained {mass_name}"],
        "passing": [f"Sieb {length_name}", "Durchgang %"],
        "retained": [f"Aperture {length_name}", "% retained"],
        "sheet": [
            f"Size {length_name}",
            f"Mass retained {mass_name}",
            "% retained",
            "Cumulative %",
            "% finer",
        ],
    }
    lines, cumulated = [separator.join(heads[layout])] if heads[layout] else [], 0.0
    for aperture, retained in [*sieves, (0.0, pan)]:
        share = 100 * retained / total
        cumulated += share
        cells = {
            "mass": cell(retained / in_g, mass_decimals, mass_name),
            "share": cell(share, 2, "%"),
            "cumulated": cell(min(cumulated, 100.0), 2, "%"),
            "passing": cell(max(100 - cumulated, 0.0), 2, "%"),
        }
        chosen = {"passing": ["passing"], "retained": ["share"], "sheet": list(cells)}.get(layout, ["mass"])
        first = cell(aperture / in_mm, length_decimals, length_name) if aperture else "Pan"
        lines.append(separator.join([first, *(cells[each] for each in chosen)]))
    try:
        sieving = read_table("\n".join(lines)).sieving
    except TableError:
        return
    cumulated, expected = 0.0, {}
    for aperture, retained in sieves:
        cumulated += 100 * retained / total
        expected[aperture] = 100 - cumulated
    rounding = 100 * len(grams) * 0.5 * in_g * 10.0**-mass_decimals / total if layout != "passing" else 0.0
    assert sieving.passing_percent == pytest.approx(expected, abs=0.1 + 2 * rounding)
    if layout in ("bare", "g", "sheet"):
        assert sieving.retained_g == pytest.approx(dict(sieves), abs=0.51 * in_g * 10.0**-mass_decimals)
    else:
        assert sieving.mass_g is None


CELLS = (
    *(
        "",
        "16",
        "8 mm",
        "63 µm",
        "1.234",
        "2,5",
        "0.25 kg",
        "100",
        "0",
        "Pan",
        "Summe",
        "-",
        "[",
        '"',
        "lot",
        "L1",
    ),
    *("Sieve mm", "Sieb µm", "Rückstand", "Retained g", "Passing %", "Cumulative %", "Masse"),
)


@given(
    st.lists(
        st.lists(
            st.sampled_from(CELLS),
            max_size=4,
        ),
        max_size=6,
    ),
    st.sampled_from(";\t,"),
)
def test_any_table_is_read_or_refused(lines: list[list[str]], separator: str) -> None:
    try:
        tables = read_tables("\n".join(separator.join(cells) for cells in lines))
    except TableError:
        return
    for read in tables.values():
        passing = read.sieving.passing_percent
        assert list(passing.values()) == sorted(passing.values())
