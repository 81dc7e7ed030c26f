"""Texts of strangers, made harmless for every kind of document."""

import unicodedata

LONGEST_PRINTED = 400
"""Characters of a text that are printed on paper; tables for machines have all of it."""
LONGEST_HEADING = 80
BIDI_CONTROLS = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


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
