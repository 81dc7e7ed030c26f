"""The two seams to the hardware: `Camera` and `LightGate`, and the events they deliver.

Every call may block for seconds (a GigE control call takes 2.5 s to fail): callers keep them off
the event loop. Events come from any thread through a sink that never blocks. A loss is an event.
"""

from dataclasses import dataclass
from typing import Protocol

from pipeline.frames import CameraId, Frame, Trigger


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLost:
    """The camera exposed, or should have, and the image did not arrive whole."""

    camera: CameraId
    received_ns: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLost:
    """The camera no longer answers; its session is over until it is opened again."""

    camera: CameraId
    received_ns: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraBack:
    """The camera is armed again; told by whoever brought it back."""

    camera: CameraId
    received_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class GateLost:
    """The light gate no longer answers."""

    received_ns: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggersIgnored:
    """The gate merged or skipped edges (bounce, double, too fast a sequence): counted, no bundle."""

    received_ns: int
    count: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseEnded:
    """The beam is open again: how long the stone of trigger `sequence` interrupted it."""

    sequence: int
    received_ns: int
    width_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggersLost:
    """The gate's own counter went on by more than was announced: the cameras may have exposed."""

    received_ns: int
    count: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaybackEnded:
    """A replayed recording is through; devices of a real rig never say this."""

    received_ns: int


DeviceEvent = (
    Trigger
    | PulseEnded
    | TriggersLost
    | TriggersIgnored
    | GateLost
    | Frame
    | FrameLost
    | CameraLost
    | CameraBack
    | PlaybackEnded
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraVitals:
    """What a camera and its stream tell about themselves; None where the device cannot say."""

    serial: str | None = None
    model: str | None = None
    address: str | None = None
    temperature_c: float | None = None
    ptp_offset_ns: int | None = None  # from the master's clock
    receive_buffer_bytes: int | None = None  # of the stream's socket, as the kernel granted it
    frames: int = 0  # received whole, since opened
    failed_frames: int = 0  # received in part, or given up
    missing_packets: int = 0
    resent_packets: int = 0
    warnings: tuple[str, ...] = ()  # what works but should be looked at, with the remedy


class EventSink(Protocol):
    """Where devices deliver; callable from any thread."""

    def deliver(self, event: DeviceEvent) -> bool:
        """Take the event without blocking; `False` when it was refused because the sink is full."""
        ...


class Camera(Protocol):
    """One camera of the rig: `open`, then any number of `arm` / `disarm`, then `close`.

    `close` is idempotent and allowed in every state; after `disarm` returns nothing more is delivered.
    Calls come from any thread, but one at a time.
    """

    @property
    def id(self) -> CameraId: ...

    def open(self) -> None:
        """Connect and configure; raises `drivers.errors.CameraUnavailableError`."""
        ...

    def arm(self, sink: EventSink) -> None:
        """Expose at every trigger from now on and deliver to `sink`."""
        ...

    def examine(self) -> CameraVitals:
        """Ask an open or armed camera how it is.

        Raises `CameraUnavailableError` when it does not answer, is no longer ours, or is not set as `open` set it.
        """
        ...

    def disarm(self) -> None: ...

    def close(self) -> None: ...


class LightGate(Protocol):
    """The light gate; the same life cycle as a camera, armed last and disarmed first."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What works but should be looked at, with the remedy; never blocks."""
        ...

    def open(self) -> None:
        """Connect; raises `drivers.errors.GateUnavailableError`."""
        ...

    def arm(self, sink: EventSink) -> None: ...

    def test_pulse(self) -> None:
        """Expose without a stone: a `BACKGROUND` trigger follows.

        Raises `GateUnavailableError` when this gate has no way to trigger the cameras, or is not armed.
        """
        ...

    def disarm(self) -> None: ...

    def close(self) -> None: ...
