"""The running daemon, as the REST interface sees it.

The daemon implements `Control`; tests of the routes put a fake in its place. Nothing here blocks: the daemon's own
tasks query the devices, and this returns what they found last.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar

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

T = TypeVar("T")


class Control(Protocol):
    """Methods and state of the daemon that routes use. Call every method on the event loop."""

    def part(self, kind: type[T]) -> T:
        """Return the part of this class, or its state now: the routes of a room ask for the class of that room."""
        ...

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
