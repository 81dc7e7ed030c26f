"""Why a stone cannot be measured again."""

from enum import StrEnum
from http import HTTPStatus

from drivers.interfaces import FrameLossReason
from pipeline.views.dropped import DropCause, DroppedView
from service.base.errors import ProblemError, ProblemKind
from service.results.fields import Result
from service.store import Record

DAMAGED = str(DroppedView(DropCause.NO_FRAME, FrameLossReason.DAMAGED))
"""Why a view is missing whose page cannot be read."""


class Hindrance(StrEnum):
    """Why a stone cannot be measured again; a word of the REST contract."""

    NO_FRAMES = "not-kept"
    NO_CALIBRATION = "calibration-gone"
    NO_BACKGROUND = "no-background"
    NO_ORDER = "not-ordered"
    FAILED = "not-measured"


class RemeasureError(ProblemError):
    """A stone is not measured again; its result stays as it is."""

    kinds = (
        ProblemKind(Hindrance.NO_FRAMES, HTTPStatus.NOT_FOUND, "This file was not kept"),
        ProblemKind(
            Hindrance.NO_CALIBRATION, HTTPStatus.CONFLICT, "The calibration of this result is not kept"
        ),
        ProblemKind(Hindrance.NO_BACKGROUND, HTTPStatus.CONFLICT, "The empty rig was not exposed yet"),
        ProblemKind(Hindrance.NO_ORDER, HTTPStatus.CONFLICT, "Conflict"),
        ProblemKind(Hindrance.FAILED, HTTPStatus.CONFLICT, "The stone could not be measured again"),
    )

    def __init__(self, why: Hindrance, detail: str) -> None:
        super().__init__(detail, why)


def require_sound(before: Record, after: Result) -> None:
    """Raise `RemeasureError` if a page of the archive was damaged since: a result must not become worse for that."""
    damaged = [
        camera for camera, why in after.dropped_views.items() if why == DAMAGED and camera in before["views"]
    ]
    if damaged:
        raise RemeasureError(Hindrance.FAILED, f"{before['id']}: frames of {', '.join(damaged)} are damaged")
