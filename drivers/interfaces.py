"""The protocols of the hardware, `Camera`, `LightGate` and `EventSink`, and the events that devices deliver.

Threads: every call of a device may block for seconds (a GigE control call takes 2.5 s to fail), so callers keep
them off the event loop. Calls to one device may come from any thread, but one at a time. A device delivers its
events from a thread of its own to the sink that it was armed with.

Errors: calls raise `drivers.errors.DeviceError`. What goes wrong between calls is no exception but an event:
`FrameLost`, `CameraLost`, `TriggersLost`, `GateLost`.

Times: `received_ns` is the host's monotonic clock (in replay the clock of the belt) at the moment of the event.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from drivers.errors import LossCause
from pipeline.frames import CameraId, Frame, GateCount, Trigger


class FrameLossReason(StrEnum):
    """Reasons of a lost frame that code decides by; all other reasons are text for people."""

    DAMAGED = "damaged"
    """Its page in a bundle file is torn or does not match its checksum."""
    ABSENT = "absent"
    """The bundle file neither has the frame nor says why."""
    UNREADABLE = "unreadable"
    """Its bundle file cannot be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameLost:
    """The camera exposed, or should have, and its image did not arrive whole."""

    camera: CameraId
    received_ns: int
    reason: str  # a `FrameLossReason`, or what the driver of the camera says
    problem: str | None = None  # with `UNREADABLE`: what is wrong with the file


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLost:
    """The camera can no longer be used; it delivers nothing until it is closed, opened and armed again."""

    camera: CameraId
    received_ns: int
    reason: str
    cause: LossCause = LossCause.OTHER


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraBack:
    """A lost camera is armed again; delivered by the caller that opened it anew, not by the camera."""

    camera: CameraId
    received_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class GateLost:
    """The light gate can no longer be used; it delivers nothing until it is closed, opened and armed again."""

    received_ns: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggersIgnored:
    """The gate merged `count` edges with the stone before them (a bounce, a repeated line): they get no bundle."""

    received_ns: int
    count: int
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PulseEnded:
    """The beam is open again; the stone of trigger `sequence` had closed it for `width_ns`."""

    sequence: int
    received_ns: int
    width_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TriggersLost:
    """The gate counted `count` more stones than it announced; the cameras may have exposed for them."""

    received_ns: int
    count: int
    reason: str
    while_down: bool = False  # they fell while no process listened to the gate
    by_host: bool = False  # this machine took the edges of a line too late: nothing is wrong with the gate


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaybackEnded:
    """A replayed recording has been delivered to its end; real devices never deliver this."""

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
    """Figures that a camera and its stream report about themselves; None where the device has none."""

    serial: str | None = None
    model: str | None = None
    address: str | None = None
    temperature_c: float | None = None
    ptp_status: str | None = None  # such as Slave or Master
    ptp_offset_ns: int | None = None  # from the master's clock
    receive_buffer_bytes: int | None = None  # of the stream's socket, as the kernel granted it
    frames: int = 0  # received whole, since opened
    failed_frames: int = 0  # received in part, or given up
    missing_packets: int = 0
    resent_packets: int = 0
    warnings: tuple[str, ...] = ()  # what works but needs attention, with the remedy
    remarks: tuple[str, ...] = ()  # what opening changed, or did in another way; needs no attention


class ProcessState(StrEnum):
    """State of the process that runs the library of the cameras."""

    RUNNING = "running"
    """It sends its heartbeat, or there is none."""
    SILENT = "silent"
    """It has missed heartbeats: no image comes, and it is replaced unless it sends one soon."""
    REPLACED = "replaced"
    """It ended, or hung and was killed, within the last minute."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraProcessStatus:
    """The state of the process of the cameras; a rig without one has always this state."""

    state: ProcessState = ProcessState.RUNNING
    replaced: int = 0  # since the daemon started
    trouble: str | None = None  # what is wrong, or was within the last minute


class EventSink(Protocol):
    """Receiver of the events of any number of devices."""

    def deliver(self, event: DeviceEvent) -> bool:
        """Take an event; `False` when the sink is full and refused it.

        Callable from any thread, never blocks, never raises. A device goes on after a refusal; the sink counts it.
        """
        ...


class Camera(Protocol):
    """One camera of the rig, in the states closed, open and armed.

    `open` and `close` lead from closed to open and back, `arm` and `disarm` from open to armed and back, any number
    of times. `disarm` and `close` are allowed in every state, do nothing where there is nothing to do, and raise
    nothing.
    """

    @property
    def id(self) -> CameraId:
        """The camera's place in the rig, not the serial number of the device in it."""
        ...

    def open(self) -> None:
        """Connect to the camera, configure it, and verify the configuration.

        Raises
        ------
        CameraUnavailableError
            It does not answer, is another one, is in use, or cannot be set as configured; it is closed then.
        """
        ...

    def arm(self, sink: EventSink) -> None:
        """Expose at every trigger from now on, and deliver each exposure to `sink`, as `Frame` or `FrameLost`.

        Frames come in the order of exposure with consecutive `frame_id`, their images read-only and never written
        again. A camera that is lost delivers one `CameraLost`.

        Raises
        ------
        CameraUnavailableError
            The camera is not open, or refuses to start.
        """
        ...

    def examine(self) -> CameraVitals:
        """Return the vital signs of an open or armed camera, read from the device itself.

        Raises
        ------
        CameraUnavailableError
            It is not open, does not answer, is another one, is no longer under our control, or is not set as `open`
            set it. The caller closes it then and opens it anew.
        """
        ...

    def light(self, *, is_on: bool) -> None:
        """Switch the lamp by which a person finds an open camera, on or off.

        Only while it is not armed: `arm` and `close` give the lamp back to what it usually shows.

        Raises
        ------
        CameraUnavailableError
            The camera is not open, is armed, has no lamp, or does not do it.
        """
        ...

    def disarm(self) -> None:
        """Stop exposing; once this returns nothing more is delivered, not even what was on its way."""
        ...

    def close(self) -> None:
        """Disarm and let go of the camera, so that others can use it."""
        ...


class LightGate(Protocol):
    """The light gate, with the states and rules of a `Camera`; armed last and disarmed first.

    An armed gate delivers a `Trigger` for every stone at once, then `PulseEnded` where it can tell the width.
    `Trigger.sequence` counts what exposes the cameras, stones and test pulses alike, and goes on when the gate is
    closed and opened again. A gate that is lost delivers one `GateLost`.
    """

    @property
    def warnings(self) -> tuple[str, ...]:
        """Things that work but need attention, each with the remedy; never blocks, allowed in every state."""
        ...

    def resume(self, count: GateCount, n_known: int) -> None:
        """Go on from the count of an earlier process, before the gate is opened for the first time.

        A gate with a counter of its own reports what it has counted since as `TriggersLost` when it is armed, less
        the `n_known` that have been accounted for; any other ignores the call.
        """
        ...

    def open(self) -> None:
        """Connect to the gate and wait until it answers.

        Raises
        ------
        GateUnavailableError
            It is not there, is in use, or does not answer; it is closed then.
        """
        ...

    def arm(self, sink: EventSink) -> None:
        """Deliver to `sink` from now on; raises `GateUnavailableError` when the gate is not open."""
        ...

    def test_pulse(self) -> None:
        """Expose all cameras without a stone; a `BACKGROUND` trigger is delivered like any other.

        Raises
        ------
        GateUnavailableError
            The gate is not armed, does not answer, or has no way to trigger the cameras.
        """
        ...

    def disarm(self) -> None:
        """Deliver nothing more once this returns; a live gate goes on triggering the cameras by its wire."""
        ...

    def close(self) -> None:
        """Disarm and let go of the gate's port or line."""
        ...
