"""The words of a report, which are data: one file a language in `words/`, the same keys in all."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from math import isfinite
from pathlib import Path

from pipeline.gradation.estimates import Estimate
from service.base.figure_names import figure_names
from service.base.language import Language
from service.reports.texts import LONGEST_HEADING, abridged

FOLDER = Path(__file__).with_name("words")


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """All texts of one language by key (`section.name`), and how it writes numbers."""

    language: Language
    texts: Mapping[str, str]

    def __call__(self, key: str, /, **values: object) -> str:
        """Return a text, with values in its places."""
        return self.texts[key].format(**values) if values else self.texts[key]

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

    def estimate(self, figure: Estimate, decimals: int) -> str:
        """Return the value of a figure, or that it was not measured."""
        return self.number(figure.value, decimals)

    def interval(self, figure: Estimate, decimals: int) -> str:
        """Return the 95 % interval of a figure; a dash without one."""
        if figure.low is None or figure.high is None:
            return "–"
        return f"{self.number(figure.low, decimals)} – {self.number(figure.high, decimals)}"

    def time(self, utc: str) -> str:
        """Return a time as the language writes it, in UTC; a text that is no time as it is."""
        try:
            moment = datetime.fromisoformat(utc)
        except ValueError:
            return utc
        if moment.tzinfo is not None:
            moment = moment.astimezone(UTC)
        return moment.strftime(self("number.time_format"))


@cache
def words(language: Language) -> Words:
    """Return the words of a language."""
    document = tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))
    texts = {
        f"{section}.{name}": text for section, entries in document.items() for name, text in entries.items()
    }
    return Words(language=language, texts={**texts, **figure_names(language)})
