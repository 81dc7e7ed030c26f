"""Files of tables: text or workbook, columns found by their heads."""

from pathlib import Path

import pytest
from unit.service.base.tables.test_workbook import workbook

from service.base.tables.files import NamedColumn, read_rows, table_text, tables_of
from service.base.tables.lines import TableError
from service.base.tables.numbers import cell_of, numbers_of
from service.base.tables.workbook import WorkbookError

WANTED = {
    "stone": NamedColumn(("stone", "stein_nr")),
    "mass_g": NamedColumn(("mass", "masse"), usual_unit="g"),
}


def masses_g(path: Path) -> dict[str, float]:
    columns, rows = read_rows(path, WANTED, tuple(WANTED))
    cells = {row.at(columns["stone"].number): cell_of(row, columns["mass_g"]) for row in rows}
    numbers, _ = numbers_of([cell for cell in cells.values() if cell])
    return {
        stone: numbers[cell.line.number][cell.column.number].value for stone, cell in cells.items() if cell
    }


@pytest.mark.parametrize(
    "text",
    [
        "stone;mass_g\n7;1234,5\n8;2",
        "Mass (kg),note,Stone\n1.2345,wet,7\n0.002,,8",
        "Stein-Nr.\tMasse in g\n7\t1.234,5\n8\t2",
        "stone;mass\n7;1,2345E+03\n8;2E0",  # binjr #137
        "stone;mass kg\n7;1.2345e+00\n8;2.000e-03",
        "stone\tmass\n7\t1.2345E+3 g\n8\t0,2e-2 kg",
        ";Stone;Mass\n;;[g]\n;7;1 234,5\n;;\n;8;0,002 kg",
    ],
)
def test_columns_are_found_by_their_heads_with_their_units(tmp_path: Path, text: str) -> None:
    file = tmp_path / "scale.csv"
    file.write_text(text)
    assert masses_g(file) == {"7": 1234.5, "8": 2.0}


def test_a_workbook_is_read_as_its_only_sheet_that_has_cells(tmp_path: Path) -> None:
    file = tmp_path / "scale.xlsx"
    rows = [[None, "Stone", "Mass kg"], [], [None, 7, 1.2345], [None, "8", 0.002]]
    file.write_bytes(workbook(Waage=rows, leer=[]))
    assert masses_g(file) == {"7": 1234.5, "8": 2.0}
    file.write_bytes(workbook(Waage=rows, alt=rows))
    with pytest.raises(TableError, match=r"scale\.xlsx: has the sheets Waage, alt: keep one"):
        table_text(file)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "line 1: must name the columns stone and mass_g, not nothing"),
        ("\n\nstone;weight\n7;1", "line 3: must name the columns stone and mass_g, not 'stone', 'weight'"),
        ("stone;mass g;Masse\n7;1;1", "line 1: column 3: 'Masse' is there twice"),
        (
            "stone;mass g\n7;1,234\n8;5,678",
            "line 2: column 2: '1,234' may be 1234 or 1.234: write all digits",
        ),
        ("stone;mass g\n7;1.5\u00b9\n8;2", "line 2: column 2: '1.5\u00b9' is not a number"),
        ("stone;mass g\n7;1.5\n8;viel", "line 3: column 2: 'viel' is not a number"),
        ("stone;mass mm\n7;1.5 g", "line 2: column 2: '1.5 g' is in g, but the column in mm"),
    ],
)
def test_an_error_names_file_line_column_and_what_was_read(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "scale.csv"
    file.write_text(text)
    with pytest.raises(TableError, match=r"scale\.csv: ") as caught:
        masses_g(file)
    assert named in str(caught.value)


def test_what_is_no_table_is_refused(tmp_path: Path) -> None:
    for wrong in (b"\xd0\xcf\x11\xe0old", b"a;b\n1;\0\n", b"PK no archive"):
        with pytest.raises(WorkbookError):
            tables_of(wrong)
    file = tmp_path / "old.xls"
    file.write_bytes(b"\xd0\xcf\x11\xe0old")
    with pytest.raises(TableError, match=r"old\.xls: .*is neither \.xlsx nor text"):
        table_text(file)
    assert tables_of(b" \n") == {}
    with pytest.raises(TableError, match=f"{tmp_path}: cannot be read: Is a directory"):
        table_text(tmp_path)
