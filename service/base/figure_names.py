"""Names of the indices of a lot, the same on pages and in reports."""

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from service.base.language import Language

FOLDER = Path(__file__).with_name("words")


@cache
def figure_names(language: Language) -> Mapping[str, str]:
    """Return the words of pages and reports, `index.` and the field of `ShapeIndices`, in their order on paper."""
    names = tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))
    return {f"index.{field}": name for field, name in names.items()}
