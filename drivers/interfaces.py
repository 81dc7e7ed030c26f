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
class PlaybackEnded:
    """A replayed recording is through; devices of a real rig never say this."""

    received_ns: int


DeviceEvent = Trigger | Frame | FrameLost | CameraLost | GateLost | TriggersIgnored | PlaybackEnded


class EventSink(Protocol):
    """Where devices deliver; callable from any thread."""

    def deliver(self, event: DeviceEvent) -> bool:
        """Take the event without blocking; `False` when it was refused because the sink is full."""
        ...


class Camera(Protocol):
    """One camera of the rig: `open`, then any number of `arm` / `disarm`, then `close`.

    `close` is idempotent and allowed in every state; after `disarm` returns nothing more is delivered.
    """

    @property
    def id(self) -> CameraId: ...

    def open(self) -> None:
        """Connect and configure; raises `drivers.errors.CameraUnavailableError`."""
        ...

    def arm(self, sink: EventSink) -> None:
        """Expose at every trigger from now on and deliver to `sink`."""
        ...

    def disarm(self) -> None: ...

    def close(self) -> None: ...


class LightGate(Protocol):
    """The light gate; the same life cycle as a camera, armed last and disarmed first."""

    def open(self) -> None:
        """Connect; raises `drivers.errors.GateUnavailableError`."""
        ...

    def arm(self, sink: EventSink) -> None: ...

    def disarm(self) -> None: ...

    def close(self) -> None: ...
