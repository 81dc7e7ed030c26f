"""The running daemon, as the REST interface sees it.

The daemon implements `Control`; tests of the API put a fake in its place. Nothing here blocks: the daemon's own tasks
query the devices, and this returns what they found last.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from prometheus_client import Histogram

from drivers.interfaces import CameraVitals
from pipeline.frames import CameraId, Image
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    AcquisitionTarget,
    CameraStatus,
    ConfigurationState,
    Health,
)
from service.calibration.calibrations import Calibrations
from service.delivery.webhooks import Webhooks
from service.health.alarms.alarms import Alarms
from service.health.facts import Facts
from service.host.diagnostics.inputs import Inputs
from service.lots.shifts import LotsSettings
from service.recording.recordings import Recordings
from service.remeasuring.remeasuring import Remeasuring


class Control(Protocol):
    """Methods and state of the daemon that routes use. Call every method on the event loop."""

    @property
    def recordings(self) -> Recordings: ...

    @property
    def calibrations(self) -> Calibrations: ...

    @property
    def lots(self) -> LotsSettings: ...

    @property
    def alarms(self) -> Alarms: ...

    @property
    def remeasuring(self) -> Remeasuring: ...

    @property
    def webhooks(self) -> Webhooks: ...

    @property
    def delays(self) -> Histogram:
        """Time from each trigger to its durable outcome."""
        ...

    @property
    def latest_delays_s(self) -> Sequence[float]:
        """The latest hundred of these; none in replay, which has a clock of its own."""
        ...

    def configuration(self) -> Mapping[str, Any]:
        """Return all settings by section, secrets included."""
        ...

    def configuration_state(self) -> ConfigurationState:
        """Return the state of the file that they are from: in use, refused, or a restart needed."""
        ...

    def diagnostic_inputs(self) -> Inputs:
        """Return the inputs of an archive for support, but for those of the daemon; reads files: on a thread."""
        ...

    def facts(self) -> Facts:
        """Return the state in figures."""
        ...

    def acquisition_status(self) -> AcquisitionStatus: ...

    async def set_acquisition(self, target: AcquisitionTarget) -> AcquisitionState:
        """Begin the transition and return the state it has reached; raise `ConflictError` where there is none."""
        ...

    def health(self) -> Health: ...

    def cameras(self) -> list[CameraStatus]:
        """Return the status of all cameras, in the order of the rig."""
        ...

    async def show_camera(self, camera: CameraId, seconds: float) -> CameraVitals:
        """Let its lamp blink; raise `NotDisarmedError` or `CameraUnavailableError` where that is not possible."""
        ...

    def latest_image(self, camera: CameraId) -> Image | None:
        """Return the latest frame of the camera; None before the first."""
        ...
