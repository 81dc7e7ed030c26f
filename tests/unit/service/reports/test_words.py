"""The words of the reports: every key in every language, every key used, numbers as the language writes them."""

import ast
import re
from collections import UserDict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from string import Formatter
from typing import get_args

import pytest
from support.lot_figures import NOT_MEASURED, lot_document, measured, report_data

from pipeline.body_measurement import BodyKind
from pipeline.errors import RejectReason
from pipeline.gradation.d4791 import DIMENSIONS
from pipeline.gradation.estimates import State
from pipeline.gradation.indices import INDICES
from pipeline.gradation.specification import Verdict
from pipeline.views.quality import Quality
from service.base.language import Language
from service.configuration.live_rig import DelayMaker
from service.health.alarms.rules import Priority
from service.lots.lots import LotState
from service.lots.plant import PlantSettings
from service.lots.trends.changes import ChangedFigure
from service.lots.trends.diary import DiaryKind
from service.reports.budget import COLUMNS
from service.reports.content import lot_section
from service.reports.report import GalleryReason, VerificationOutcome
from service.reports.shift_sheet import COLUMNS as SHIFT_LISTS
from service.reports.trend import TrendFigure
from service.reports.words import words
from service.results.fields import LossReason, NotRefined, Outcome

SHIFT_HEADS = {head for columns in SHIFT_LISTS.values() for head, *_ in columns}
SHIFT_COUNTED = ["d50_mm", "flakiness_percent", "shape_percent"]
SOURCES = Path(__file__).parents[4] / "service" / "reports"
ENGLISH, GERMAN = words(Language.ENGLISH), words(Language.GERMAN)
FAMILIES = {
    "verdict": list(Verdict),
    "state": list(State),
    "lot_state": list(LotState),
    "outcome": list(Outcome),
    "reason": [*RejectReason, *LossReason],
    "quality": list(Quality),
    "body": list(get_args(BodyKind)),
    "not_refined": list(NotRefined),
    "verification": list(VerificationOutcome),
    "gallery_reason": list(GalleryReason),
    "counted": ["mass", "number"],
    "index": INDICES,
    "decimals": INDICES,
    "budget": COLUMNS,
    "budget_of": ["d50_mm", "flakiness_percent", "shape_percent"],
    "measure": ENGLISH.family("measure"),  # which pages list
    "d4791": list(DIMENSIONS),
    "diary_kind": list(DiaryKind),
    "diary_value": list(DiaryKind),
    "since": list(DiaryKind),
    "changed": list(ChangedFigure),
    "amount": list(ChangedFigure),
    "trend": list(TrendFigure),
    "plant": list(PlantSettings().texts),
    "priority": list(Priority),
    "wiring_delay": list(DelayMaker),
    "shift": [*SHIFT_LISTS, *(f"no_{each}" for each in SHIFT_LISTS), *SHIFT_HEADS, *SHIFT_COUNTED],
    "accounting": [
        "unmeasured_expected_percent",
        "unmeasured_at_most_percent",
        "mass_kg",
        "least_portion_kg",
    ],
}


class Noted(UserDict[str, str]):
    """Texts that know which of them were read."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        super().__init__(texts)
        self.keys_read: set[str] = set()

    def __getitem__(self, key: str) -> str:
        self.keys_read.add(key)
        return super().__getitem__(key)


def used_keys() -> Iterator[str]:
    """Yield the keys that the sources name, also as the names of facts, and those of the words of the REST contract."""
    sections = "|".join({key.partition(".")[0] for key in ENGLISH.texts})
    for path in SOURCES.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        yield from re.findall(rf"""["']((?:{sections})\.\w+)["']""", text)
        yield from (f"{key}_1" for key in re.findall(r"""\.counted\(["']([\w.]+)["']""", text))
        for node in ast.walk(ast.parse(text)):
            match node:
                case ast.Call(func=ast.Name("facts"), args=[_, ast.Constant(section)], keywords=named):
                    yield from (f"{section}.{each.arg}" for each in named if each.arg)
    lot_section(
        report_data({"lot": lot_document(revision=2)}),
        replace(ENGLISH, texts=(noted := Noted(ENGLISH.texts))),
    )
    yield from noted.keys_read
    for family, members in FAMILIES.items():
        yield from (f"{family}.{word}" for word in members)


@pytest.mark.parametrize("language", Language)
def test_every_language_has_the_same_keys_and_each_is_used(language: Language) -> None:
    assert set(words(language).texts) == set(used_keys())


@pytest.mark.parametrize("language", Language)
def test_every_text_has_the_same_places_in_every_language(language: Language) -> None:
    def places(text: str) -> set[str | None]:
        return {name for _, name, _, _ in Formatter().parse(text) if name is not None}

    texts = words(language).texts
    assert {key: places(text) for key, text in texts.items()} == {
        key: places(text) for key, text in ENGLISH.texts.items()
    }
    assert all(text.strip() for text in texts.values())


def test_numbers_are_written_as_the_language_does() -> None:
    assert ENGLISH.number(12345.678, 1) == "12\u00a0345.7"
    assert GERMAN.number(12345.678, 1) == "12\u00a0345,7"
    assert GERMAN.number(-0.5, 2) == "\u22120,50"
    assert ENGLISH.number(-0.0001, 1) == "0.0"
    assert (ENGLISH.size(31.5), GERMAN.size(31.5), ENGLISH.size(8.0), ENGLISH.size(0.063)) == (
        "31.5",
        "31,5",
        "8",
        "0.063",
    )
    assert GERMAN.interval(measured(10.0, 1.0), 1) == "8,0 – 12,0"


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_no_number_was_not_measured(value: float | None) -> None:
    assert ENGLISH.number(value, 1) == "not measured"
    assert ENGLISH.interval(NOT_MEASURED, 1) == "–"


def test_times_are_utc_and_what_is_no_time_stays() -> None:
    assert ENGLISH.time("2026-11-20T06:02:11.120Z") == "2026-11-20 06:02:11 UTC"
    assert GERMAN.time("2026-11-20T08:02:11+02:00") == "20.11.2026 06:02:11 UTC"
    assert ENGLISH.time("yesterday") == "yesterday"
