"""The units at the ends of names."""

UNITS = {
    "percent": "%", "mm": "mm", "mm2": "mm²", "mm3": "mm³", "kg": "kg", "g": "g", "px": "px", "ms": "ms", "phi": "φ",
}  # fmt: skip


def unit_of(name: str) -> str | None:
    """Return the unit at the end of a figure's name, None for a plain number."""
    return UNITS.get(name.rpartition("_")[2])
