"""What the REST interface may ask of the running daemon: one protocol, plain values, no web, no devices.

The daemon implements `Control`; tests of the API put a fake in its place. Nothing here blocks: what a
device must be asked for is asked by the daemon's own tasks, and the answer is remembered.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

from pipeline.frames import CameraId
from service.errors import ServiceError
from service.health.optical_watch import CameraOptics
from service.recording.recordings import Recordings

if TYPE_CHECKING:
    from service.calibration.sessions import Calibrations  # which needs the words of this module


class AcquisitionState(StrEnum):
    """Where the rig stands between stones being ignored and stones being measured."""

    DISARMED = "disarmed"
    """Nobody listens to the light gate."""
    ARMING = "arming"
    ARMED = "armed"
    """Every trigger becomes a bundle."""
    HELD = "held"
    """Armed is wanted, own trouble prevents it; the daemon keeps trying."""
    DISARMING = "disarming"
    STOPPING = "stopping"
    """The daemon is on its way out; nothing can be asked of it any more."""


class AcquisitionTarget(StrEnum):
    """What may be asked for."""

    ARMED = "armed"
    DISARMED = "disarmed"


TRANSITIONS: Mapping[tuple[AcquisitionState, AcquisitionTarget], AcquisitionState] = {
    (AcquisitionState.DISARMED, AcquisitionTarget.ARMED): AcquisitionState.ARMING,
    (AcquisitionState.ARMING, AcquisitionTarget.ARMED): AcquisitionState.ARMING,
    (AcquisitionState.ARMED, AcquisitionTarget.ARMED): AcquisitionState.ARMED,
    (AcquisitionState.HELD, AcquisitionTarget.ARMED): AcquisitionState.HELD,
    (AcquisitionState.DISARMED, AcquisitionTarget.DISARMED): AcquisitionState.DISARMED,
    (AcquisitionState.ARMING, AcquisitionTarget.DISARMED): AcquisitionState.DISARMING,
    (AcquisitionState.ARMED, AcquisitionTarget.DISARMED): AcquisitionState.DISARMING,
    (AcquisitionState.HELD, AcquisitionTarget.DISARMED): AcquisitionState.DISARMING,
    (AcquisitionState.DISARMING, AcquisitionTarget.DISARMED): AcquisitionState.DISARMING,
}
"""The state that follows a request; asking for what already is or comes changes nothing. A pair that is
absent is a conflict: arming while disarming, and anything while stopping."""


class ConflictError(ServiceError):
    """The acquisition cannot go from its current state to the one asked for."""

    def __init__(self, current: AcquisitionState, target: AcquisitionTarget) -> None:
        super().__init__(f"acquisition is {current} and cannot become {target} now")
        self.current = current
        self.target = target


def next_state(current: AcquisitionState, target: AcquisitionTarget) -> AcquisitionState:
    """Return the state after asking for `target`; raise `ConflictError` where the table has no answer."""
    try:
        return TRANSITIONS[current, target]
    except KeyError:
        raise ConflictError(current, target) from None


class CheckStatus(StrEnum):
    """Of one check, from best to worst."""

    PASS = "pass"  # noqa: S105 - the word of the health+json draft
    WARN = "warn"
    FAIL = "fail"


class Ne107(StrEnum):
    """Device state in the words of NAMUR NE 107."""

    GOOD = "good"
    CHECK_FUNCTION = "check_function"
    """Results are temporarily not to be trusted: calibration, replay, service."""
    MAINTENANCE_REQUIRED = "maintenance_required"
    """Still right, but not for long."""
    OUT_OF_SPECIFICATION = "out_of_specification"
    """Results are less certain than promised."""
    FAILURE = "failure"
    """No results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One thing that was looked at."""

    status: CheckStatus
    value: float | int | str | bool | None = None
    unit: str | None = None
    detail: str | None = None  # for people: what is wrong and where


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The daemon's opinion of itself."""

    ne107: Ne107
    ready: bool  # the next stone will be measured
    reasons: tuple[str, ...] = ()  # why not ready, or why not `good`
    checks: Mapping[str, Check] = field(default_factory=dict)
    """By name: `camera:c01`, `cameras`, `gate`, `trigger_line`, `progress`, `loop`, `queue`, `workers`, `background`,
    `segmentation`, `calibration`, `clock`, `store`, `disk`, `archive`, `recording`, `rig`, `optics`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraStatus:
    """One camera's state, and its counters since the daemon started."""

    id: CameraId
    state: str  # closed, armed, lost
    last_error: str | None = None
    recoveries: int = 0  # from a loss
    serial: str | None = None
    model: str | None = None
    address: str | None = None
    frames: int = 0
    fps: float = 0.0
    lost: int = 0  # reported as lost by the camera or its driver
    late: int = 0  # arrived after their bundle was closed
    duplicates: int = 0
    missing: int = 0  # bundles without a frame of this camera
    strays: int = 0  # frames without a trigger
    not_exposed: int = 0  # triggers its frame ids did not count
    unannounced: int = 0  # exposures without a trigger, by its frame ids
    failed_frames: int = 0  # received in part, since it was opened
    missing_packets: int = 0
    resent_packets: int = 0
    receive_buffer_bytes: int | None = None
    temperature_c: float | None = None
    ptp_offset_ns: int | None = None
    latency_ms: float | None = None  # mean, from the trigger to the frame's arrival
    latency_min_ms: float | None = None
    latency_max_ms: float | None = None
    skew_us: float | None = None  # of its exposures beside those of the other cameras
    last_frame_age_s: float | None = None
    tangency_px: float | None = None  # its outlines against those of the others, see rig_watch.CameraScore
    tangency_drift_px: float | None = None
    residual_px: float | None = None
    residual_drift_px: float | None = None
    optics: CameraOptics | None = None  # how well it sees
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquisitionStatus:
    """The rig as a whole; counters are of the time since it was last armed."""

    state: AcquisitionState
    trouble: str | None = None  # why it is held
    activity: str = "idle"  # idle (not armed), measuring, suspended (no stone for a while)
    cameras_armed: int = 0
    cameras: int = 0
    gate: str = "closed"
    gate_error: str | None = None
    gate_warnings: tuple[str, ...] = ()
    last_stone_age_s: float | None = None  # None before the first
    triggers: int = 0
    orphans: int = 0  # announced by the frames alone
    unseen: int = 0  # counted by the gate, announced and photographed by nobody
    in_dead_time: int = 0
    triggers_ignored: int = 0  # bounces and doubles that the gate merged
    triggers_lost: int = 0  # gaps in the gate's counter
    events_refused: int = 0  # by the full inbox


class Control(Protocol):
    """The running daemon as the REST interface sees it; every method is called on the event loop."""

    @property
    def recordings(self) -> Recordings: ...

    @property
    def calibrations(self) -> "Calibrations": ...

    def acquisition(self) -> AcquisitionStatus: ...

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
