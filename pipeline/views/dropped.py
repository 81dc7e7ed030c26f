"""Reason why a view is left out of a measurement: a cause to decide by, and the text for people made of it."""

from dataclasses import dataclass
from enum import StrEnum


class DropCause(StrEnum):
    """What is wrong with a view."""

    NO_FRAME = "no_frame"
    """The bundle has no frame of the camera."""
    UNUSABLE = "unusable"
    """It shows no body, a cut one, or several."""
    CONTRADICTION = "contradiction"
    """It contradicts the other views."""


@dataclass(frozen=True, slots=True)
class DroppedView:
    """One view that was left out; its text is that of the record."""

    cause: DropCause
    detail: str

    def __str__(self) -> str:
        if self.cause is DropCause.CONTRADICTION:
            return f"contradicts the other views: {self.detail}"
        return self.detail
