"""The words of a report, which are data: one file a language in `words/`, the same keys in all.

Texts of strangers are made harmless for every kind of document.
"""

import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from functools import cache
from math import isfinite
from pathlib import Path

from pipeline.gradation.estimates import Estimate
from service.base.language import Language, figure_names

FOLDER = Path(__file__).with_name("words")
LONGEST_PRINTED = 400
"""Characters of a text that are printed on paper; tables for machines have all of it."""
LONGEST_HEADING = 80
BIDI_CONTROLS = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """All texts of one language by key (`section.name`), and how it writes numbers and times."""

    language: Language
    texts: Mapping[str, str]
    zone: tzinfo | None = UTC
    """Zone of times, beside which stands UTC; None: the host's."""

    def __call__(self, key: str, /, **values: object) -> str:
        """Return a text, with values in its places."""
        return self.texts[key].format(**values) if values else self.texts[key]

    def counted(self, key: str, n: int, **values: object) -> str:
        """Return a text with a number in it; of one it is that of the key with `_1`."""
        return self(f"{key}_1" if n == 1 else key, n=self.number(n, 0), **values)

    def known(self, family: str, word: str) -> str:
        """Return the text of a word of the REST contract; one that has none is printed as it is."""
        return self.texts.get(f"{family}.{word}") or abridged(word, LONGEST_HEADING)

    def family(self, section: str) -> list[str]:
        """Return the words of the REST contract that a section has texts for, in the order of the file."""
        return [key.removeprefix(f"{section}.") for key in self.texts if key.startswith(f"{section}.")]

    def number(self, value: float | None, decimals: int) -> str:
        """Return a number with the decimal mark of the language; `not measured` for None and for what is no number."""
        if value is None or not isfinite(value):
            return self("state.not_measured")
        text = f"{value:,.{decimals}f}"
        if float(text.replace(",", "")) == 0:
            text = text.lstrip("-")
        marks = str.maketrans({",": "\u00a0", ".": self("number.decimal_mark"), "-": "\u2212"})
        return text.translate(marks)

    def size(self, size_mm: float) -> str:
        """Return the size of a sieve as it is named: 8, 31.5, 0.063."""
        return f"{size_mm:.6g}".replace(".", self("number.decimal_mark"))

    def interval(self, figure: Estimate, decimals: int) -> str:
        """Return the 95 % interval of a figure; a dash without one."""
        if figure.low is None or figure.high is None:
            return "–"
        return f"{self.number(figure.low, decimals)} – {self.number(figure.high, decimals)}"

    def time(self, utc: str) -> str:
        """Return a time in its zone, with UTC beside it if that is another; a text that is no time as it is."""
        try:
            moment = datetime.fromisoformat(utc)
            moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
            local = moment.astimezone(self.zone)
        except (ValueError, OverflowError):
            return utc
        text = f"{local:{self('number.date_format')} %H:%M:%S %Z}"
        if not local.utcoffset():
            return text
        day = "" if local.date() == moment.date() else self("number.date_format") + " "
        return f"{text} ({moment:{day}%H:%M} UTC)"


@cache
def words(language: Language, zone: tzinfo | None = UTC) -> Words:
    """Return the words of a language, with times of a zone; None: the host's."""
    document = tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))
    texts = {
        f"{section}.{name}": text for section, entries in document.items() for name, text in entries.items()
    }
    return Words(language=language, texts={**texts, **figure_names(language)}, zone=zone)


def plain(text: str) -> str:
    """Return the text without characters that no document may have: controls, surrogates, turned directions.

    A line break becomes a space.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(_plain(character) for character in text)


def _plain(character: str) -> str:
    if character.isspace():
        return " "
    if character in BIDI_CONTROLS or unicodedata.category(character) in ("Cc", "Cs"):
        return ""
    return "" if ord(character) in (0xFFFE, 0xFFFF) else character


def abridged(text: str, longest: int = LONGEST_PRINTED) -> str:
    """Return a harmless text of at most so many characters; one that was cut ends with an ellipsis."""
    text = plain(text)
    return text if len(text) <= longest else text[: longest - 1].rstrip() + "…"
