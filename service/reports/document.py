"""A report as blocks of text in one language: what HTML and PDF print alike, each in its own way."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from pipeline.gradation.specification import Verdict
from service.reports.drawing import Drawing
from service.reports.words import Words

DASH = "–"
"""Stands where there is nothing to say."""
MANY_FACTS = 6
LONGEST_IN_HALF_A_LINE = 36
"""Characters of a value."""


@dataclass(frozen=True, slots=True)
class NamesAndValues:
    """Names and values."""

    kind: ClassVar[str] = "facts"
    pairs: Sequence[tuple[str, str]]

    def by_length(self) -> tuple[Sequence[tuple[str, str]], Sequence[tuple[str, str]]]:
        """Return the pairs that may stand two in a line, if these are many, and those that need a line of their own."""
        if len(self.pairs) < MANY_FACTS:
            return (), self.pairs
        short = [pair for pair in self.pairs if len(pair[1]) <= LONGEST_IN_HALF_A_LINE]
        return short, [pair for pair in self.pairs if len(pair[1]) > LONGEST_IN_HALF_A_LINE]


def facts(say: Words, section: str, **values: str | None) -> NamesAndValues:
    """Return the values that are known and not empty, each named by the text `section.NAME`."""
    return NamesAndValues([(say(f"{section}.{name}"), value) for name, value in values.items() if value])


@dataclass(frozen=True, slots=True)
class Column:
    """The head of a column; numbers are set to the right."""

    title: str
    is_number: bool = True
    width: float = 1.0  # beside the other columns'


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts; `verdicts` colours the last cell of each row, if there is one."""

    kind: ClassVar[str] = "table"
    columns: Sequence[Column]
    rows: Sequence[Sequence[str]]
    verdicts: Sequence[Verdict | None] = ()


@dataclass(frozen=True, slots=True)
class Note:
    """A paragraph."""

    kind: ClassVar[str] = "note"
    text: str
    is_warning: bool = False


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing over the whole width."""

    kind: ClassVar[str] = "picture"
    drawing: Drawing


@dataclass(frozen=True, slots=True)
class Card:
    """A stone with what is said of it."""

    title: str
    lines: Sequence[str]
    png: bytes | None  # None: there is no picture
    missing: str  # what is printed instead of one


@dataclass(frozen=True, slots=True)
class Cards:
    """Stones side by side."""

    kind: ClassVar[str] = "cards"
    cards: Sequence[Card]


@dataclass(frozen=True, slots=True)
class Signatures:
    """Lines to sign on, with what is to be written on each."""

    kind: ClassVar[str] = "signatures"
    names: Sequence[str]


Block = NamesAndValues | Table | Note | Picture | Cards | Signatures


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what is below it."""

    title: str
    blocks: Sequence[Block]
    on_screen: Sequence[Block] = ()  # what HTML has beyond: paper is for the customer's desk


@dataclass(frozen=True, slots=True, kw_only=True)
class Letterhead:
    """Head of the first page: who answers for the report, and where it is to be seen."""

    lines: Sequence[str]
    logo_svg: str | None
    address: str | None  # what the QR code says
    qr_svg: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Document:
    """A whole report."""

    language: str
    letterhead: Letterhead
    title: str
    subtitle: str
    banners: Sequence[str]  # what makes it no report of production, or none that counts
    verdict: Verdict | None
    verdict_title: str
    verdict_lines: Sequence[str]
    sections: Sequence[Section]
    footer: str
    page: str  # with {page} and {pages}
    created_at: str  # RFC 3339 UTC
    is_sheet: bool = False  # it is one page: what is too long is set smaller
