"""Text of tables: whatever a spreadsheet saves gives the same cells."""

import csv
from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.base.tables.lines import TableError, lines_of, tabbed, text_of

CELL = st.text(st.sampled_from("abÜß 1,.;'\"\n-="), max_size=6).map(str.strip)
HEAD = ["Größe", "mass_g", "x"]


@pytest.mark.parametrize(
    ("text", "cells"),
    [
        ("a;b\n1,5;2", [["a", "b"], ["1,5", "2"]]),
        ("a\tb\nx;y\t2,5", [["a", "b"], ["x;y", "2,5"]]),
        ("a,b\n1,x;y", [["a", "b"], ["1", "x;y"]]),  # a note has the mark of others
        ('"a; x","b"\n1,2', [["a; x", "b"], ["1", "2"]]),
        ('a, "b, c"\n1,2', [["a", "b, c"], ["1", "2"]]),
        ('"Mass\nretained\n(g)";b\n\n1;2', [["Mass retained (g)", "b"], ["1", "2"]]),
        ("sep=;\na;b", [["a", "b"]]),
        ("sep=|\na,1|b", [["a,1", "b"]]),
        ('"sep=;"\na;b;\n1;2;\n', [["a", "b"], ["1", "2"]]),
        ("SEP=\t\na;1\tb", [["a;1", "b"]]),
        ("\n ; ;\na;b\n;;\n;7;\n", [["a", "b"], ["", "7"]]),
        ("Liste\na;b", [["Liste"], ["a", "b"]]),
        ("a;1\u202f234,5", [["a", "1 234,5"]]),
        ("12,5\u00b9;12,5\u2460;1\uff12,5", [["12,5\u00b9", "12,5\u2460", "12,5"]]),  # marks of notes
        ("", []),
    ],
)
def test_cells_are_parted_by_the_mark_that_the_table_shows(text: str, cells: list[list[str]]) -> None:
    assert [line.cells for line in lines_of(text)] == cells


def test_a_line_has_the_number_that_an_editor_shows() -> None:
    lines = lines_of('sep=;\n\n"a\nb";c\n\n1;2\n', "scale.csv")
    assert [line.place for line in lines] == ["scale.csv: line 3", "scale.csv: line 6"]
    assert (lines[0].at(2), lines[0].at(3)) == ("c", "")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('a;b\n1;"2', "t.csv: line 2: a quotation mark is not closed"),
        ('a;b\n1;2\n"x"y;3', "t.csv: line 3: "),
        ("a,b\n1,5,2", "t.csv: line 2: 3 cells where the first line has 2: part columns by semicolons"),
        ("a,b\n1", "t.csv: line 2: 1 cells"),
        (";".join("a" * 21), "t.csv: line 1: more than 20 columns"),
        ("a\n" * 10_001, "t.csv: more than 10000 lines"),
    ],
)
def test_what_cannot_be_parted_is_named(text: str, named: str) -> None:
    with pytest.raises(TableError, match=named):
        lines_of(text, "t.csv")


@given(st.lists(st.lists(CELL, min_size=3, max_size=3), min_size=1, max_size=5), st.sampled_from("\t;,|"))
def test_what_a_spreadsheet_writes_is_read_back(rows: list[list[str]], mark: str) -> None:
    out = StringIO(newline="")
    csv.writer(out, delimiter=mark).writerows([HEAD, *rows])
    named = f"sep={mark}\r\n" if mark == "|" else ""
    read = [[line.at(n) for n in (1, 2, 3)] for line in lines_of(named + out.getvalue())]
    assert read == [HEAD, *([" ".join(cell.split("\n")) for cell in row] for row in rows if any(row))]
    again = [[line.at(n) for n in (1, 2, 3)] for line in lines_of(tabbed(read))]
    assert again == read


@given(
    st.text(st.characters(codec="cp1252", min_codepoint=32), min_size=1).map(lambda text: f"Sieb µm;{text}")
)
@pytest.mark.full
def test_the_encoding_does_not_matter(text: str) -> None:
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"):
        assert text_of(text.encode(encoding)) == text
    assert text_of("Größe µm".encode("cp1252")) == "Größe µm"


@given(st.binary(max_size=60))
def test_any_bytes_are_lines_or_refused(content: bytes) -> None:
    try:
        lines_of(text_of(content))
    except TableError as err:
        assert str(err).startswith("table: ")
