"""Names of curves and trends in a drawing."""

from service.base.language import Language
from service.reports.words import words


def lot_name(lot: str, algorithm_version: str | None, language: Language) -> str:
    """Return the name of a lot, or of one as an algorithm's version measured it."""
    if algorithm_version is None:
        return lot
    return words(language)("curve.by_version", name=lot, version=algorithm_version)


def minutes_name(minutes: float, language: Language) -> str:
    """Return the name of what fell within the last minutes."""
    return words(language)("curve.last_minutes", minutes=f"{minutes:g}")
