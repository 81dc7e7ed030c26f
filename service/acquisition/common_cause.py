"""Sixteen alarms with one cause are one alarm."""

from collections.abc import Sequence

SILENT = ("does not answer", "no camera", "there is no")
"""What the errors of cameras say that nobody hears from."""


def cause_of_all(errors: Sequence[str | None]) -> str:
    """Say why all cameras are lost: what they have in common if none answers, else what the first one says."""
    known = [error or "" for error in errors]
    if all(any(silence in error for silence in SILENT) for error in known):
        return f"all {len(known)} cameras are gone: look at the switch, its power and its uplink first"
    return f"all {len(known)} cameras are lost, the first one: {next(filter(None, known), 'no reason given')}"
