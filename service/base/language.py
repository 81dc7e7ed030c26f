"""The languages of reports, pages and alarms, and what the figures of lots and stones are called in each."""

import tomllib
from collections.abc import Mapping
from enum import StrEnum
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).with_name("words")


class Language(StrEnum):
    """Language of what people read, as browsers name it."""

    ENGLISH = "en"
    GERMAN = "de"


@cache
def figure_names(language: Language) -> Mapping[str, str]:
    """Return the words of pages and reports, `index.` or `measure.` and the field, in their order there.

    `decimals.` and an index has the digits after its point.
    """
    kinds = tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))
    names = {f"{kind}.{field}": name for kind, fields in kinds.items() for field, name in fields.items()}
    return names | {
        f"decimals.{field}": "1" if field.endswith("_percent") else "2" for field in kinds["index"]
    }
