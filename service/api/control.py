"""What the REST interface may ask of the running daemon: one protocol, plain values, no web, no devices.

The daemon implements `Control`; tests of the API put a fake in its place. Nothing here blocks: what a
device must be asked for is asked by the daemon's own tasks, and the answer is remembered.
"""

from typing import Protocol

from pipeline.frames import CameraId
from service.calibration.calibrations import Calibrations
from service.recording.recordings import Recordings
from service.status import AcquisitionState, AcquisitionStatus, AcquisitionTarget, CameraStatus, Health


class Control(Protocol):
    """The running daemon as the REST interface sees it; every method is called on the event loop."""

    @property
    def recordings(self) -> Recordings: ...

    @property
    def calibrations(self) -> Calibrations: ...

    def acquisition_status(self) -> AcquisitionStatus: ...

    async def set_acquisition(self, target: AcquisitionTarget) -> AcquisitionState:
        """Begin the transition and return the state it has reached; raises `ConflictError`."""
        ...

    def health(self) -> Health: ...

    def cameras(self) -> list[CameraStatus]:
        """All cameras of the rig, in page order."""
        ...

    async def snapshot(self, camera: CameraId) -> bytes | None:
        """Return the camera's latest frame as PNG; `None` while there is none."""
        ...
