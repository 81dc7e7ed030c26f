"""The report as PDF on A4."""

from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from io import BytesIO
from itertools import zip_longest
from pathlib import Path

from fpdf import FPDF, FontFace, XPos, YPos
from fpdf.enums import TableBordersLayout

from pipeline.gradation.specification import Verdict
from service.reports.content import document_of
from service.reports.document import (
    Block,
    Card,
    Cards,
    Document,
    Facts,
    Note,
    Picture,
    Section,
    Signatures,
    Table,
)
from service.reports.fonts import DEJAVU, use_font
from service.reports.pdf_drawing import draw
from service.reports.pictures import readable_png
from service.reports.report import ReportData

Colour = tuple[int, int, int]

INK: Colour = (29, 36, 48)
MUTED: Colour = (91, 101, 115)
EDGE: Colour = (205, 211, 219)
SOFT: Colour = (243, 245, 248)
ACCENT: Colour = (28, 95, 168)
GOOD: Colour = (30, 122, 60)
BAD: Colour = (179, 35, 26)
OPEN: Colour = (143, 85, 0)
VERDICT_COLOURS = {
    Verdict.CONFORMS: GOOD,
    Verdict.DOES_NOT_CONFORM: BAD,
    Verdict.UNDECIDED: OPEN,
    Verdict.INSUFFICIENT: MUTED,
    Verdict.NOT_MEASURED: MUTED,
}
MARGIN_MM = 16.0
BOTTOM_MM = 20.0
BODY_PT, SMALL_PT = 9.0, 8.0
CARDS_A_ROW = 4
ALL_PAGES = "{n#}"  # replaced by the number of pages


def render_pdf(data: ReportData, font_folder: Path = DEJAVU) -> bytes:
    """Return the report as PDF, in the font of the folder, see `service.reports.fonts`."""
    document = document_of(data)
    paper = _Paper(document, font_folder)
    paper.add_page()
    _title(paper, document)
    for section, following in zip(document.sections, (*document.sections[1:], None), strict=True):
        _section(paper, section, following)
    return bytes(paper.output())


class _Paper(FPDF):
    """Pages with the document's name and their number at the foot, and its banners at the head of all but the first."""

    def __init__(self, document: Document, font_folder: Path) -> None:
        super().__init__(format="A4")
        self.document = document
        self.family, self.drawable = use_font(self, font_folder)
        self.set_margins(MARGIN_MM, MARGIN_MM)
        self.c_margin = 0  # texts begin where the lines do
        self.set_auto_page_break(True, BOTTOM_MM)
        self.alias_nb_pages(ALL_PAGES)
        self.set_title(self.drawable(document.title))
        self.set_lang(document.language)
        with suppress(ValueError):
            self.set_creation_date(datetime.fromisoformat(document.created_at).astimezone(UTC))

    def write_in(self, size_pt: float, colour: Colour = INK, *, is_bold: bool = False) -> None:
        """Set font and colour of what is written next."""
        self.set_font(self.family, "B" if is_bold else "", size_pt)
        self.set_text_color(*colour)

    def paragraph(self, text: str, line_mm: float, *, width_mm: float = 0, align: str = "L") -> None:
        """Write a text in lines, and go below it."""
        self.multi_cell(
            width_mm, line_mm, self.drawable(text), align=align, new_x=XPos.LMARGIN, new_y=YPos.NEXT
        )

    def header(self) -> None:
        if self.page_no() > 1 and self.document.banners:
            self.write_in(SMALL_PT, BAD, is_bold=True)
            self.paragraph(self.document.banners[0][:90], 4, align="C")
            self.ln(2)

    def footer(self) -> None:
        self.set_y(-13)
        self.set_draw_color(*EDGE)
        self.set_line_width(0.2)
        self.line(self.l_margin, self.y - 1.5, self.w - self.r_margin, self.y - 1.5)
        self.write_in(7.5, MUTED)
        page = self.document.page.format(page=self.page_no(), pages=ALL_PAGES)
        self.cell(self.epw - 40, 4, self._fitting(self.document.footer, self.epw - 44))
        too_wide = self.get_string_width(ALL_PAGES) - self.get_string_width("0")
        self.cell(40 + too_wide, 4, self.drawable(page), align="R")

    def _fitting(self, text: str, width_mm: float) -> str:
        """Return a drawable text, cut to the width."""
        while len(text) > 1 and self.get_string_width(self.drawable(text)) > width_mm:
            text = text[:-2].rstrip() + "…"
        return self.drawable(text)

    def need(self, height_mm: float) -> None:
        """Go to the next page unless there is so much room on this one."""
        if self.will_page_break(height_mm):
            self.add_page()


def _title(paper: _Paper, document: Document) -> None:
    for banner in document.banners:
        _boxed(paper, banner, 13, BAD)
        paper.ln(2)
    paper.write_in(17, is_bold=True)
    paper.paragraph(document.title, 7.5)
    paper.write_in(10, MUTED)
    paper.paragraph(document.subtitle, 5.5)
    paper.ln(2)
    colour = MUTED if document.verdict is None else VERDICT_COLOURS[document.verdict]
    _verdict(paper, document, colour)


def _boxed(paper: _Paper, text: str, size_pt: float, colour: Colour) -> None:
    """Write a text into a frame of its colour."""
    paper.write_in(size_pt, colour, is_bold=True)
    top, line_mm = paper.y, size_pt * 0.5
    paper.set_y(top + 2)
    paper.paragraph(text, line_mm, align="C")
    paper.set_draw_color(*colour)
    paper.set_line_width(0.9)
    paper.rect(paper.l_margin, top, paper.epw, paper.y + 2 - top)
    paper.set_y(paper.y + 2)


def _verdict(paper: _Paper, document: Document, colour: Colour) -> None:
    """Write the verdict with a bar of its colour beside it; it may be longer than a page."""
    paper.set_left_margin(MARGIN_MM + 6)
    paper.set_x(MARGIN_MM + 6)
    top, page = paper.y, paper.page
    paper.write_in(14, colour, is_bold=True)
    paper.paragraph(document.verdict_title, 7)
    paper.write_in(BODY_PT)
    paper.set_left_margin(MARGIN_MM + 9)
    for line in document.verdict_lines:
        paper.set_x(MARGIN_MM + 6)
        paper.cell(3, 4.6, paper.drawable("•"))
        paper.paragraph(line, 4.6)
    paper.set_left_margin(MARGIN_MM)
    if paper.page == page:
        paper.set_fill_color(*colour)
        paper.rect(MARGIN_MM, top, 2, paper.y - top, style="F")
    paper.set_x(MARGIN_MM)


def _section(paper: _Paper, section: Section, following: Section | None) -> None:
    paper.ln(5)
    height_mm = 10 + _height_mm(section.blocks[0])
    if following is not None and isinstance(following.blocks[0], Signatures):
        height_mm += 15 + _height_mm(following.blocks[0])  # no page of signatures alone
    paper.need(height_mm)
    paper.write_in(12, is_bold=True)
    paper.paragraph(section.title, 6)
    paper.set_draw_color(*ACCENT)
    paper.set_line_width(0.5)
    paper.line(paper.l_margin, paper.y, paper.w - paper.r_margin, paper.y)
    paper.ln(2)
    for block, next_block in zip(section.blocks, (*section.blocks[1:], None), strict=True):
        if isinstance(block, Note) and isinstance(next_block, Table):
            paper.need(10 + _height_mm(next_block))
        match block:
            case Facts():
                _facts(paper, block)
            case Table():
                _table(paper, block)
            case Note():
                _note(paper, block)
            case Picture():
                draw(paper, block.drawing, paper.family, paper.drawable)
            case Cards():
                _cards(paper, block)
            case Signatures():
                _signatures(paper, block)


def _height_mm(block: Block) -> float:
    """Return the approximate height of a block; one that may break over pages needs no more than half a page."""
    match block:
        case Facts():
            short, long = block.by_length()
            return min(6.0 * (len(short) / 2 + len(long)), 130.0)
        case Table():
            return min(6.2 * (len(block.rows) + 1.5), 130.0)
        case Picture():
            return 100.0
        case Cards():
            return 50.0
        case Signatures():
            return 30.0
        case Note():
            return 20.0


def _facts(paper: _Paper, facts: Facts) -> None:
    short, long = facts.by_length()
    half = (len(short) + 1) // 2
    rows = [(*left, *right) for left, right in zip_longest(short[:half], short[half:], fillvalue=("", ""))]
    if rows:
        _rows(paper, rows, (2.5, 3.6, 2.3, 3.6), ("L", "L", "L", "L"), muted=(0, 2))
    if long:
        _rows(paper, long, (2.5, 9.5), ("L", "L"), muted=(0,))
    paper.ln(1.5)


def _rows(
    paper: _Paper,
    rows: Sequence[Sequence[str]],
    widths: tuple[float, ...],
    aligns: tuple[str, ...],
    *,
    head: Sequence[str] | None = None,
    verdicts: Sequence[Verdict | None] = (),
    muted: tuple[int, ...] = (),
) -> None:
    """Write rows of cells; `muted` are the columns of names."""
    paper.write_in(BODY_PT)
    paper.set_draw_color(*EDGE)
    paper.set_line_width(0.2)
    paper.set_fill_color(255)  # a cell that has a style is filled
    with paper.table(
        col_widths=widths,
        text_align=aligns,
        first_row_as_headings=head is not None,
        headings_style=FontFace(emphasis="BOLD", color=MUTED, size_pt=SMALL_PT),
        borders_layout=TableBordersLayout.HORIZONTAL_LINES,
        line_height=4.4,
        padding=(0.7, 1.6),
        width=paper.epw,
    ) as table:
        if head is not None:
            table.row([paper.drawable(text) for text in head])
        for i, texts in enumerate(rows):
            row = table.row()
            verdict = verdicts[i] if verdicts else None
            for j, text in enumerate(texts):
                style = FontFace(color=MUTED) if j in muted else None
                if verdict is not None and j == len(texts) - 1:
                    style = FontFace(emphasis="BOLD", color=VERDICT_COLOURS[verdict])
                row.cell(paper.drawable(text), style=style)
    paper.line(paper.l_margin, paper.y, paper.w - paper.r_margin, paper.y)


def _table(paper: _Paper, table: Table) -> None:
    paper.need(_height_mm(table))
    _rows(
        paper,
        table.rows,
        tuple(column.width for column in table.columns),
        tuple("R" if column.is_number else "L" for column in table.columns),
        head=[column.title for column in table.columns],
        verdicts=table.verdicts,
    )
    paper.ln(1.5)


def _note(paper: _Paper, note: Note) -> None:
    if note.is_warning:
        paper.ln(1)
        _boxed(paper, note.text, BODY_PT, BAD)
        paper.ln(1)
        return
    paper.write_in(SMALL_PT, MUTED)
    paper.paragraph(note.text, 4)
    paper.ln(1.5)


def _cards(paper: _Paper, block: Cards) -> None:
    gap_mm, picture_mm = 4.0, 28.0
    width_mm = (paper.epw - gap_mm * (CARDS_A_ROW - 1)) / CARDS_A_ROW
    for cards in batched_cards(block.cards):
        paper.need(picture_mm + 30)
        top, lowest = paper.y, paper.y
        for i, card in enumerate(cards):
            lowest = max(
                lowest,
                _card(paper, card, paper.l_margin + i * (width_mm + gap_mm), top, width_mm, picture_mm),
            )
        paper.set_xy(paper.l_margin, lowest + 3)


def batched_cards(cards: Sequence[Card]) -> list[Sequence[Card]]:
    """Return the cards row by row."""
    return [cards[i : i + CARDS_A_ROW] for i in range(0, len(cards), CARDS_A_ROW)]


def _card(paper: _Paper, card: Card, x: float, top: float, width_mm: float, picture_mm: float) -> float:
    """Draw a card; return the height of its lower edge."""
    paper.set_fill_color(*SOFT)
    paper.rect(x, top, width_mm, picture_mm, style="F")
    png = readable_png(card.png)
    if png is None:
        paper.write_in(SMALL_PT, MUTED)
        paper.set_xy(x, top + picture_mm / 2 - 2)
        paper.cell(width_mm, 4, paper.drawable(card.missing), align="C")
    else:
        paper.image(
            BytesIO(png),
            x,
            top,
            width_mm,
            picture_mm,
            keep_aspect_ratio=True,
            alt_text=paper.drawable(card.title),
        )
    paper.set_y(top + picture_mm + 1)
    for i, line in enumerate((card.title, *card.lines)):
        paper.write_in(SMALL_PT, INK if i == 0 else MUTED, is_bold=i == 0)
        paper.set_x(x)
        paper.multi_cell(width_mm, 3.8, paper.drawable(line), align="L", new_x=XPos.LEFT, new_y=YPos.NEXT)
    return paper.y


def _signatures(paper: _Paper, block: Signatures) -> None:
    paper.need(30)
    gap_mm = 14.0
    width_mm = (paper.epw - gap_mm * (len(block.names) - 1)) / len(block.names)
    y = paper.y + 20
    paper.set_draw_color(*INK)
    paper.set_line_width(0.3)
    paper.write_in(SMALL_PT, MUTED)
    for i, name in enumerate(block.names):
        x = paper.l_margin + i * (width_mm + gap_mm)
        paper.line(x, y, x + width_mm, y)
        paper.text(x, y + 4, paper.drawable(name))
    paper.set_y(y + 6)
