"""Why a stone cannot be measured again."""

from enum import StrEnum

from drivers.interfaces import FrameLossReason
from pipeline.views.dropped import DropCause, DroppedView
from service.base.errors import ServiceError
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


class RemeasureError(ServiceError):
    """A stone is not measured again; its result stays as it is."""

    def __init__(self, why: Hindrance, detail: str) -> None:
        super().__init__(detail)
        self.why = why


def require_sound(before: Record, after: Record) -> None:
    """Raise `RemeasureError` if a page of the archive was damaged since: a result must not become worse for that."""
    damaged = [
        camera
        for camera, why in after["dropped_views"].items()
        if why == DAMAGED and camera in before["views"]
    ]
    if damaged:
        raise RemeasureError(Hindrance.FAILED, f"{before['id']}: frames of {', '.join(damaged)} are damaged")
