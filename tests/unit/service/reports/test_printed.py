"""The reports that a person signs: HTML and PDF, in both languages, whatever texts the plant sends."""

import pickle
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import pytest
from pypdf import PdfReader
from support.extents import first_quick
from support.lot_figures import (
    NOT_MEASURED,
    curve,
    decision,
    lot_document,
    measured,
    preview_png,
    report_data,
    step,
)

from pipeline.gradation.specification import Verdict
from pipeline.gradation.stones import Unmeasured
from service.base.language import Language
from service.lots.lots import LotState
from service.lots.plant import PlantSettings
from service.reports.content import document_of
from service.reports.document import NamesAndValues
from service.reports.lot_reports import RENDERERS
from service.reports.printed import DEJAVU, render_html, render_pdf
from service.reports.report import (
    GalleryReason,
    GalleryStone,
    ReportData,
    ReportFormat,
    VerificationOutcome,
)

HOSTILE = {
    "script": "<script>alert(1)</script><img src=x onerror=alert(1)>",
    "formula": "=cmd|' /C calc'!A0",
    "long word": "W" * 10_000,
    "long text": "stone " * 2_000,
    "emoji": "🪨 basalt 👩‍🔬",
    "right to left": "בזלת \u202egnp.exe 玄武岩 بازلت",
    "controls": "a\x00b\x1b[31mc\ud800d\ufffe\r\n\te",
    "template": "{{ 7*7 }} {% raw %} {name} {0.__class__} %(a)s {page} {pages}",
    "typst": '#read("/etc/passwd") *a* _b_ $x^2$ `c` \\ <d> @e = f // g ~ -- "h" #sys.inputs [i]',
}
PLANT = PlantSettings(
    plant="Basaltwerk Hohenstein",
    line="line 2",
    instrument_serial="SF-16-0042",
    laboratory="Prüflabor Süd",
    time_zone="Europe/Berlin",
    base_url="http://stonefall.plant:8080",
)
SIGNER = "-".join(["3f1c"] * 8)
NO_FONTS = Path("/nonexistent")
VOID_ELEMENTS = {"meta", "img", "br"}


class Page(HTMLParser):
    """Collects texts, elements and attributes; fails at an element that is not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.styles: list[str] = []
        self.elements: Counter[str] = Counter()
        self.attributes: list[tuple[str, str, str]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID_ELEMENTS:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements[tag] += 1
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        (self.styles if self.open[-1:] == ["style"] else self.texts).append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


def page(data: ReportData) -> Page:
    return Page(render_html(data).decode("utf-8"))


def pdf_pages(data: ReportData, font_folder: Path = DEJAVU) -> list[str]:
    """Return the text of each page of the PDF."""
    pages = PdfReader(BytesIO(render_pdf(data, font_folder))).pages
    return [" ".join(page.extract_text().split()) for page in pages]


def pdf_text(data: ReportData) -> str:
    return " ".join(pdf_pages(data))


def page_text(data: ReportData) -> str:
    return page(data).text


def hostile(text: str) -> ReportData:
    """Return a report in which everything that a stranger may write is this text."""
    lot = lot_document(lot=text, sublot=text, sample_id=text, sampler=text, remark=text, equipment=text)
    figures = {
        "lot": lot,
        "specification": text,
        "sieve_set": text,
        "calibration_ids": [text],
        "unmeasured": Unmeasured(
            n_stones=1, by_reason={f"rejected: {text}": 1, text: 2}, expected_percent=1.0, at_most_percent=2.0
        ),
        "by_quality": {text: 3},
        "by_body": {text: 3},
    }
    stone = GalleryStone(
        id=text, reasons=(GalleryReason.LARGEST,), sieve_size_mm=9, volume_mm3=400, quality=text
    )
    return report_data(figures, gallery=(stone,), uncertainty_remark=text, software_version=text)


def test_a_report_says_all_that_is_signed_for() -> None:
    text = page(report_data()).text
    for said in (
        "Gradation of lot 2026-04711",
        "Undecided (as far as measured)",
        "Sieve 4 mm: undecided; 3.9 (2.5 – 5.3) %, limits 0 – 5 %",
        "Sieve 2 mm: not measured; limits 0 – 2 %",
        "94.2 92.2 – 96.2 100.0 90 – 99 conforms",
        "2 not measured – not measured 0 – 2 not measured",
        "Flakiness index FI, % (EN 933-3) 12.4 9.8 – 15.0 0 – 20 conforms",
        "D50 11.38 11.18 – 11.58 11.40",
        "Stones that fell 1 012",
        "Measured body refined by the pixels 901 (91.3 %), estimated from the outlines 84 (8.5 %), visual hull 2",
        "Not refined other stones were waiting 71, the pixels showed nothing 13",
        "reached: 3.12 kg of at least 2.60 kg",
        "rejected: more than one stone 12",
        "These 25 stones are 2.5 % of the measured mass",
        "at most 18.4 %",
        "passed, 2026-11-20 05:50:12 UTC: sphere 15.00 mm, error +0.021 mm (v-0031)",
        "All intervals are 95 % intervals.",
        "heaviest influence, largest",
        "no picture",
        "Software 0.3.0, algorithm 10, interface 1.8.0",
        "Sieving 221, 2026-11-20 11:30:00 UTC, by Labor Süd, sample S-0815/2.",
        "Remark of the laboratory: dried at 110 °C",
        "Tested by, date",
    ):
        assert said.replace(" ", " ") in text.replace("\u00a0", " "), said


def test_the_pdf_says_the_same_on_numbered_pages() -> None:
    text = pdf_text(report_data())
    for said in (
        "Gradation of lot 2026-04711",
        "EN 13043 GC90/15",
        "not measured",
        "92.2 – 96.2",
        "Sieving 221",
    ):
        assert said in text
    assert "Page 1 of 3" in text
    assert "Page 3 of 3" in text


@pytest.mark.parametrize("language", Language)
@pytest.mark.parametrize(
    "figures",
    [
        {},
        {
            "is_simulated": True,
            "is_replay": True,
            "specification_is_general": True,
            "lot": lot_document(remark=None, external_id=None),
            "curve": [*curve(), *(step(size_mm, NOT_MEASURED) for size_mm in (40.0, 63.0, 80.0))],
        },
    ],
)
def test_a_plain_lot_is_two_pages_with_the_curve_on_the_first(
    language: Language, figures: dict[str, object]
) -> None:
    pages = pdf_pages(report_data(figures, sievings=(), language=language, plant=PLANT, signer=SIGNER))
    assert len(pages) == 2
    axis, last_sieve, indices = {
        Language.ENGLISH: ("Sieve size, mm", "94.2 92.2 – 96.2", "Flakiness index FI"),
        Language.GERMAN: ("Siebweite, mm", "94,2 92,2 – 96,2", "Plattigkeitskennzahl FI"),
    }[language]
    assert axis in pages[0]
    assert last_sieve in pages[0]
    assert indices in pages[1]
    assert SIGNER in pages[1]


@pytest.mark.parametrize("render", [page_text, pdf_text])
def test_plant_instrument_and_local_time_are_on_the_report(render: Callable[[ReportData], str]) -> None:
    text = render(report_data(plant=PLANT, signer=SIGNER))
    for said in (
        "Basaltwerk Hohenstein",
        "Line: line 2",
        "Instrument: SF-16-0042",
        "Laboratory: Prüflabor Süd",
        "2026-11-20 07:02:11 CET (06:02 UTC)",
        "Signed by Instrument: SF-16-0042, 2026-11-20 08:00:03 CET (07:00 UTC)",
        f"Key (Ed25519) {SIGNER}",
    ):
        assert said in text, said
    bare = render(report_data())
    assert "Made on request and not signed" in bare
    assert "Instrument:" not in bare


def test_general_limits_have_their_source_and_a_remark_of_its_own() -> None:
    remark = "The limits of the specification are general knowledge of EN 13043:2002, table 2"
    assert remark in page(report_data({"specification_is_general": True})).text
    assert remark not in page(report_data()).text


def test_a_qr_code_leads_to_the_lot_where_there_is_an_address() -> None:
    def images(plant: PlantSettings) -> list[tuple[str, str, str]]:
        return [each for each in page(report_data(plant=plant)).attributes if each[:2] == ("img", "alt")]

    address = "http://stonefall.plant:8080/api/v1/lots/2026-04711/report?language=en"
    assert ("img", "alt", address) in images(replace(PLANT, base_url="http://stonefall.plant:8080/"))
    assert address not in str(images(replace(PLANT, base_url=None)))


def test_the_head_of_a_long_table_is_on_each_of_its_pages() -> None:
    steps = [step(0.1 * 1.1**i, measured(i), decision(Verdict.CONFORMS, 0, 100)) for i in range(80)]
    pages = pdf_pages(report_data({"curve": steps}))
    heads = [
        text.count("Sieve, mm Passing, % 95 % interval By number, % Limits, % Verdict") for text in pages
    ]
    assert sum(heads) >= 2
    assert max(heads) == 1


def test_the_pdf_has_a_title_a_language_a_date_an_outline_and_texts_for_its_pictures() -> None:
    data = report_data(language=Language.GERMAN, created_at="2026-11-20T07:00:03.999Z")
    file = render_pdf(data)
    pdf = PdfReader(BytesIO(file))
    assert pdf.metadata is not None
    assert pdf.metadata.title == "Korngrößenverteilung des Loses 2026-04711"
    assert pdf.metadata.creation_date == datetime(2026, 11, 20, 7, 0, 3, tzinfo=UTC)
    assert pdf.root_object["/Lang"] == "de"
    assert [entry["/Title"] for entry in pdf.outline][:2] == ["Los", "Korngrößenverteilung"]
    assert file.count(b"/Alt") == 1


def test_german_has_commas_umlauts_and_no_english_word() -> None:
    data = report_data(language=Language.GERMAN)
    text = page(data).text
    assert "Korngrößenverteilung des Loses 2026-04711" in text
    assert "94,2 92,2 – 96,2" in text
    assert "Nicht verfeinert andere Steine warteten 71, die Pixel zeigten nichts 13" in text
    assert not re.search(r"\b(measured|stones|sieve|conforms|undecided|passing)\b", text, re.IGNORECASE)
    assert "Korngrößenverteilung" in pdf_text(data)


def test_what_was_not_measured_is_never_a_zero() -> None:
    figures = {"curve": [step(2.0, NOT_MEASURED, decision(Verdict.NOT_MEASURED, 0, 2))]}
    rows = re.findall(r"<tr>(.*?)</tr>", render_html(report_data(figures)).decode(), re.DOTALL)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]
    assert ["2", "not measured", "–", "not measured", "0 – 2", "not measured"] in cells


def test_only_an_open_lot_says_how_many_stones_would_decide() -> None:
    remaining = "about 220 more stones, 55 s"
    assert remaining in page(report_data({"lot": lot_document(state=LotState.OPEN)})).text.replace(
        "\u00a0", " "
    )
    assert remaining not in page(report_data()).text.replace("\u00a0", " ")


@pytest.mark.parametrize(
    ("figures", "banner"),
    [
        ({"is_simulated": True}, "SIMULATED – not production"),
        ({"is_replay": True}, "REPLAY of a recording – not production"),
        ({"lot": lot_document(state=LotState.VOID, void_reason="wrong product")}, "VOID – wrong product"),
        ({"lot": lot_document(state=LotState.OPEN)}, "PRELIMINARY – the lot is still open"),
        (
            {"lot": lot_document(state=LotState.CLOSING)},
            "PRELIMINARY – stones of the lot are still being measured",
        ),
    ],
)
def test_what_is_no_production_or_does_not_count_says_so_first(
    figures: dict[str, object], banner: str
) -> None:
    html = render_html(report_data(figures)).decode()
    assert f'<p class="banner">{banner}</p>' in html
    assert html.index(banner) < html.index("<h1>")
    printed = pdf_pages(report_data(figures))
    assert len(printed) == 3
    assert [text.count(banner) for text in printed] == [1] * len(printed)


def test_a_void_lot_has_no_verdict() -> None:
    document = document_of(report_data({"lot": lot_document(state=LotState.VOID, void_reason="x")}))
    assert document.verdict is None
    assert document.verdict_title == "Void: no verdict"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"is_verification_overdue": True}, "overdue"),
        ({"outcome": VerificationOutcome.FAILED}, "The last verification failed"),
    ],
)
def test_a_verification_that_is_missing_or_failed_is_a_warning(changes: dict[str, object], said: str) -> None:
    data = report_data()
    assert data.verification is not None
    if "outcome" in changes:
        changes = {"verification": replace(data.verification, outcome=VerificationOutcome.FAILED)}
    assert 'class="warning"' not in render_html(data).decode()
    warned = re.findall(r'<p class="warning">(.*?)</p>', render_html(replace(data, **changes)).decode())
    assert len(warned) == 1
    assert said in warned[0]


def test_a_portion_that_falls_short_is_not_rounded_up() -> None:
    text = page(report_data({"mass_kg": 2.5999})).text
    assert "NOT reached: 2.60 kg of at least 2.60 kg (99 %)" in text


@pytest.mark.parametrize("language", Language)
def test_the_page_fetches_nothing_and_runs_nothing(language: Language) -> None:
    found = page(report_data(language=language))
    assert not found.elements["script"] + found.elements["link"] + found.elements["iframe"]
    assert not [name for _, name, _ in found.attributes if name.startswith("on")]
    for tag, name, value in found.attributes:
        if name in ("src", "href", "xlink:href", "action"):
            assert value.startswith("data:image/png;base64,"), (tag, name)
    styles = "".join(found.styles)
    assert "url(" not in styles
    assert "@import" not in styles


@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize("language", first_quick(Language))
def test_no_text_of_a_stranger_does_harm_on_paper(name: str, language: Language) -> None:
    data = replace(hostile(HOSTILE[name]), language=language)
    found = page(data)
    assert found.elements["script"] == 0
    assert found.elements["img"] == 0
    assert not {character for character in "".join(found.texts) if character in "\u202e\x00\x1b"}
    for folder in (DEJAVU, NO_FONTS):
        assert len(pdf_pages(data, folder)) <= 12


def test_hostile_texts_are_still_readable() -> None:
    assert "<script>alert(1)</script>" in page(hostile(HOSTILE["script"])).text
    assert "🪨 basalt" in page(hostile(HOSTILE["emoji"])).text
    assert HOSTILE["typst"] in pdf_text(hostile(HOSTILE["typst"]))
    assert "W" * 30 in pdf_text(hostile(HOSTILE["long word"]))
    assert "{{ 7*7 }} {% raw %} {name}" in page(hostile(HOSTILE["template"])).text
    facts = document_of(hostile(HOSTILE["long text"])).sections[0].blocks[0]
    assert isinstance(facts, NamesAndValues)
    assert max(len(value) for _, value in facts.pairs) == 400


@pytest.mark.parametrize("png", [b"", b"not a picture", preview_png()[:200], preview_png()[:-20] + b"x" * 20])
def test_a_damaged_preview_is_no_picture(png: bytes) -> None:
    stone = GalleryStone(
        id="1",
        reasons=(GalleryReason.LARGEST,),
        sieve_size_mm=9,
        volume_mm3=400,
        quality="good",
        preview_png=png,
    )
    data = report_data(gallery=(stone,))
    assert page(data).elements["img"] == 0
    assert "no picture" in page(data).text


def test_a_picture_that_lacks_its_end_costs_no_report() -> None:
    stone = replace(report_data().gallery[0], preview_png=preview_png()[:-12])
    assert "no picture" not in page(report_data(gallery=(stone,))).text


def test_a_window_without_lot_product_and_specification_has_a_report() -> None:
    bare = {
        "lot": None,
        "product": None,
        "since": None,
        "until": None,
        "specification": None,
        "specification_source": None,
        "verdict": None,
        "countdown": None,
        "curve": [step(size_mm, measured(50)) for size_mm in (4, 8)],
        "flakiness_decision": None,
        "shape_decision": None,
        "mass_kg": None,
        "least_portion_kg": None,
        "by_body": {},
        "not_refined": {},
        "calibration_ids": [],
        "algorithm_versions": [],
        "unmeasured": Unmeasured(n_stones=0, by_reason={}, expected_percent=None, at_most_percent=None),
    }
    data = report_data(bare, verification=None, gallery=(), sievings=())
    text = page(data).text
    assert "No specification, no verdict" in text
    assert "Every stone that fell was measured" in text
    assert "Measured body" not in text
    assert "Not refined" not in text
    for report_format in ReportFormat:
        assert RENDERERS[report_format](data)


@pytest.mark.parametrize("report_format", ReportFormat)
def test_it_can_be_made_in_another_process_and_is_the_same_there(report_format: ReportFormat) -> None:
    data = report_data()
    render = RENDERERS[report_format]
    function, sent = pickle.loads(pickle.dumps((render, data)))  # noqa: S301 - our own
    assert function(sent) == render(data)


def test_all_that_conforms_says_so() -> None:
    conforming = [found for found in curve() if found.decision is None or found.sieve_mm > 4]
    figures = {"curve": conforming, "shape_decision": None, "verdict": Verdict.CONFORMS, "is_partial": False}
    document = document_of(report_data(figures))
    assert document.verdict_title == "Conforms"
    assert document.verdict_lines == ("All 5 figures with limits conform: their 95 % intervals lie inside.",)


@pytest.mark.parametrize(
    ("language", "said"),
    [
        (
            Language.ENGLISH,
            "coverage factor k = 2 for a level of confidence of about 95 %: D50 = 12.00 mm ± 0.28 mm",
        ),
        (Language.GERMAN, "für eine Überdeckungswahrscheinlichkeit von etwa 95 %: D50 = 12,00 mm ± 0,28 mm"),
    ],
)
def test_the_uncertainty_is_stated_with_its_budget(language: Language, said: str) -> None:
    html = render_html(report_data(language=language)).decode()
    assert said in html
    assert "JCGM 100:2008" in html
    without = render_html(report_data({"uncertainty": []}, language=language)).decode()
    assert "JCGM" not in without
