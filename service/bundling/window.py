"""One open trigger: the frames that have come for it, and why others have not."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from pipeline.frames import CameraId, Frame, FrameBundle, MissingReason, Trigger


@dataclass(slots=True, kw_only=True)
class OpenTrigger:
    """An open trigger whose frames are expected about `expected_ns` of the host's monotonic clock."""

    trigger: Trigger
    ordinal: int  # among triggers that expose
    expected_ns: int
    stalled_ns: int = 0  # how long the host stood still meanwhile, which delays the deadline
    in_dead_time: bool = False  # no camera exposes
    is_spoiled: bool = False  # a background with a stone in it
    frames: dict[CameraId, Frame] = field(default_factory=dict)
    lost: dict[CameraId, str] = field(default_factory=dict)  # cameras that are not waited for, and why
    refused: set[CameraId] = field(default_factory=set)  # cameras that sent only another exposure
    unreadable: str | None = None  # what is wrong with the file that should have been replayed

    def is_complete(self, n_cameras: int) -> bool:
        """True when every camera has delivered or is known not to deliver."""
        return len(self.frames.keys() | self.lost.keys()) == n_cameras

    def bundle(self, cameras: Iterable[CameraId], reason: MissingReason) -> FrameBundle:
        """Return the bundle of what has come, in the order of `cameras`.

        `reason` is given for frames that are missing without a known cause.
        """
        frames: dict[CameraId, Frame] = {}
        missing: dict[CameraId, str] = {}
        for camera in cameras:
            if self.is_spoiled:
                missing[camera] = MissingReason.STONE_PASSED
            elif camera in self.frames:
                frames[camera] = self.frames[camera]
            else:
                unexplained = MissingReason.OTHER_EXPOSURE if camera in self.refused else reason
                missing[camera] = self.lost.get(camera, unexplained)
        return FrameBundle(trigger=self.trigger, frames=frames, missing=missing, unreadable=self.unreadable)
