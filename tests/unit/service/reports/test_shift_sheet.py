"""The sheet of a shift: one page whatever happened, the rest counted, in both languages."""

import re
from io import BytesIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pypdf import PdfReader
from support.shift_sheets import shift_sheet

from service.base.language import Language
from service.lots.plant import PlantSettings
from service.reports.shift_data import ShiftSheet
from service.reports.shift_sheet import SheetData, room_of, sheet_document, sheet_html, sheet_pdf

PLANT = PlantSettings(plant="Quarry North", line="line 2", time_zone="Europe/Berlin")


def data_of(sheet: ShiftSheet, language: Language = Language.ENGLISH) -> SheetData:
    return SheetData(sheet=sheet, created_at="2026-03-02T13:00:10.000Z", language=language, plant=PLANT)


@pytest.mark.parametrize("language", Language)
@pytest.mark.parametrize(
    "many",
    [
        {},
        {"n_lots": 30, "n_alarms": 40, "n_stops": 20},
        {"n_lots": 200, "n_alarms": 300, "n_stops": 100, "long_text": "W" * 500, "is_replay": True},
        {"products": [], "lots": [], "alarms": [], "diary": [], "verifications": [], "stops": []},
    ],
)
def test_a_sheet_is_one_page_and_counts_what_it_has_no_room_for(language: Language, many: dict) -> None:
    sheet = shift_sheet(**many)
    (page,) = PdfReader(BytesIO(sheet_pdf(data_of(sheet, language)))).pages
    text = page.extract_text().replace("\u00a0", " ")
    assert "Quarry North" in text
    assert {Language.ENGLISH: "06:00 – 14:00", Language.GERMAN: "06:00 – 14:00 Uhr"}[language] in text
    document = sheet_document(data_of(sheet, language))
    for title, n in (("lots", len(sheet.lots)), ("alarms", len(sheet.alarms))):
        section = document.sections[{"lots": 2, "alarms": 3}[title]]
        if n:
            table, *notes = section.blocks
            n_more = sum(int("".join(filter(str.isdecimal, note.text))) for note in notes)
            assert len(table.rows) + n_more == n


@pytest.mark.parametrize(
    ("language", "said"), [("en", ("1 lot", "t in 1 lot")), ("de", ("1 Los", "t in 1 Los"))]
)
def test_one_lot_is_no_lots(language: str, said: tuple[str, str]) -> None:
    text = sheet_html(data_of(shift_sheet(n_lots=1), Language(language))).decode().replace("\u00a0", " ")
    for each in said:
        assert re.search(rf"{each}\b", text)


def test_a_sheet_says_what_its_mass_is_based_on_and_what_its_lots_are() -> None:
    text = sheet_html(data_of(shift_sheet(n_lots=5))).decode().replace("\u00a0", " ")
    for said in (
        "1.234 t · 5 321 stones · 5 lots · 1 × does not conform · 4 × conforms",
        "8/16 basalt 2 850 kg/m³; in no lot without a density, so not in it. 121 stones",
        "200.0 t in 5 lots",
        "11.4 (11.2 – 11.6)",
        "10.9 – 12.1",
        "≤ 20",
        "(05:00 UTC)",
        "06:02 key wall",
        "nobody yet",
        "gap 25 mm",
        "−0.001",
    ):
        assert said in text


def test_an_alarm_is_of_a_check_with_its_name() -> None:
    assert "Kamera c01: " in sheet_html(data_of(shift_sheet(), Language.GERMAN)).decode()


@given(wanted=st.dictionaries(st.sampled_from("abcde"), st.integers(0, 50)), n_rows=st.integers(0, 60))
def test_room_is_shared_out_fairly(wanted: dict[str, int], n_rows: int) -> None:
    room = room_of(wanted, n_rows)
    assert sum(room.values()) == min(n_rows, sum(wanted.values()))
    short = [room[name] for name in wanted if room[name] < wanted[name]]
    assert all(room[name] <= wanted[name] for name in wanted)
    assert not short or max(room.values()) - min(short) <= 1  # none has more than one that lacks some
