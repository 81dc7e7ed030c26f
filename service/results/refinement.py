"""Why a body was not refined by the pixels inside its outlines, as records say it and as lots and health count it."""

from enum import StrEnum

RUSH = "other stones were waiting"
"""The record's `refinement_fallback` of a stone that was not refined for want of time."""


class NotRefined(StrEnum):
    """Why a stone stays as estimated although `[body] kind` is `photo`; a word of the REST contract."""

    RUSH = "rush"
    """Other stones were waiting; it can be measured again."""
    NO_EVIDENCE = "no_evidence"
    """The pixels were looked at and showed nothing that could be used."""


def why_not_refined(fallback: str) -> NotRefined:
    """Classify a record's `refinement_fallback`."""
    return NotRefined.RUSH if fallback == RUSH else NotRefined.NO_EVIDENCE
