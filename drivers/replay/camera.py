"""The twin of a camera that delivers the frames of a recording."""

from drivers.errors import CameraUnavailableError
from drivers.interfaces import CameraVitals, EventSink
from drivers.replay.belt import ReplayBelt
from pipeline.frames import CameraId


class ReplayCamera:
    """Delivers its frames of the belt's recording while it is armed; those played at other times are dropped."""

    def __init__(self, camera: CameraId, belt: ReplayBelt) -> None:
        self._id = camera
        self._belt = belt
        self._is_open = False

    @property
    def id(self) -> CameraId:
        return self._id

    def open(self) -> None:
        """Raise `CameraUnavailableError` if the recording has no such camera."""
        if self._id not in self._belt.cameras:
            raise CameraUnavailableError(self._id, f"is not in the recording {self._belt.recording.path}")
        self._is_open = True

    def arm(self, sink: EventSink) -> None:
        if not self._is_open:
            raise CameraUnavailableError(self._id, "is not open")
        self._belt.cameras[self._id].plug(sink)

    def examine(self) -> CameraVitals:
        if not self._is_open:
            raise CameraUnavailableError(self._id, "is not open")
        return CameraVitals()

    def light(self, *, is_on: bool) -> None:
        """Raise `CameraUnavailableError`: a recording has no lamps."""
        problem = "has no lamp: it is a recording" if self._is_open else "is not open"
        raise CameraUnavailableError(self._id, problem)

    def disarm(self) -> None:
        if self._is_open:
            self._belt.cameras[self._id].unplug()

    def close(self) -> None:
        self.disarm()
        self._is_open = False
