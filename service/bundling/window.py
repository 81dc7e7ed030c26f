"""One trigger on its way to its bundle: what has come for it, and why something has not."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from pipeline.frames import CameraId, Frame, FrameBundle, Trigger

NO_FRAME = "no_frame"
"""Nothing came from the camera until the deadline."""
CAMERA_LOST = "camera_lost"
"""The camera does not answer."""
AMBIGUOUS = "ambiguous"
"""Two different frames came for one trigger."""
OTHER_EXPOSURE = "other_exposure"
"""By its camera's clock the frame was exposed for another trigger."""
DEAD_TIME = "dead_time"
"""The trigger followed another within the gate's dead time; the frames belong to the first."""
DISARMED = "disarmed"
"""The session ended before the frame came."""
STONE_PASSED = "stone_passed"
"""The empty rig was exposed while a stone fell."""
UNSEEN = "unseen"
"""The gate counted the trigger and did not announce it, and no camera exposed."""


@dataclass(slots=True, kw_only=True)
class Window:
    """Frames are expected about `expected_ns` of the host's monotonic clock."""

    trigger: Trigger
    ordinal: int  # among triggers that expose
    expected_ns: int
    stalled_ns: int = 0  # the host stood still meanwhile: no deadline runs then
    in_dead_time: bool = False  # no camera exposes
    is_spoiled: bool = False  # a background with a stone in it
    frames: dict[CameraId, Frame] = field(default_factory=dict)
    lost: dict[CameraId, str] = field(default_factory=dict)  # of whom no frame is waited for, and why
    refused: set[CameraId] = field(default_factory=set)  # of whom only another exposure came
    unreadable: str | None = None  # what is wrong with the file that should have been replayed

    def is_complete(self, n_cameras: int) -> bool:
        """Whether nothing is waited for any longer."""
        return len(self.frames.keys() | self.lost.keys()) == n_cameras

    def bundle(self, cameras: Iterable[CameraId], reason: str) -> FrameBundle:
        """Return what came, in the order of `cameras`; `reason` is that of frames nobody knows anything of."""
        frames, missing = {}, {}
        for camera in cameras:
            if self.is_spoiled:
                missing[camera] = STONE_PASSED
            elif camera in self.frames:
                frames[camera] = self.frames[camera]
            else:
                unexplained = OTHER_EXPOSURE if camera in self.refused else reason
                missing[camera] = self.lost.get(camera, unexplained)
        return FrameBundle(trigger=self.trigger, frames=frames, missing=missing, unreadable=self.unreadable)
