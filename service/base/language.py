"""The languages of reports, pages and alarms, and what the indices of a lot are called in each."""

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
    """Return the words of pages and reports, `index.` and the field of `ShapeIndices`, in their order on paper."""
    names = tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))
    return {f"index.{field}": name for field, name in names.items()}
