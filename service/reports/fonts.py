"""The font of a PDF: DejaVu Sans of Debian where it is installed, else Helvetica, which knows Latin-1 alone."""

from collections.abc import Callable
from pathlib import Path

from fpdf import FPDF
from fpdf.fonts import TTFFont

DEJAVU = Path("/usr/share/fonts/truetype/dejavu")
"""Folder of Debian's package fonts-dejavu-core."""
REPLACED = str.maketrans(
    {"–": "-", "−": "-", "…": "...", "•": "\u00b7", "’": "'", "„": '"', "“": '"', "\u202f": "\u00a0"}
)
"""What a report itself prints and Latin-1 lacks."""


def use_font(pdf: FPDF, folder: Path) -> tuple[str, Callable[[str], str]]:
    """Return the family to write in, regular and bold, and what makes a text drawable in it.

    A character that the font lacks becomes a box (a question mark in Helvetica), never an error or a hole.
    """
    regular, bold = folder / "DejaVuSans.ttf", folder / "DejaVuSans-Bold.ttf"
    if not (regular.is_file() and bold.is_file()):
        return "Helvetica", _in_latin_1
    pdf.add_font("DejaVu", "", regular)
    pdf.add_font("DejaVu", "B", bold)
    known = set.intersection(*(set(font.cmap) for font in pdf.fonts.values() if isinstance(font, TTFFont)))
    return "DejaVu", lambda text: "".join(character if ord(character) in known else "□" for character in text)


def _in_latin_1(text: str) -> str:
    return text.translate(REPLACED).encode("latin-1", "replace").decode("latin-1")
