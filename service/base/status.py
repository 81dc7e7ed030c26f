"""What the daemon reports about itself: states, checks, health and calibration.

The REST interface returns these models themselves: a field that is added here is documented, checked and served.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPStatus
from typing import Literal

from pydantic import BaseModel, ConfigDict

from service.base.errors import ProblemError, ProblemKind
from service.base.messages import CodedFinding, Said, findings_of
from service.base.schema import always_present


class Report(BaseModel):
    """A report of one part of the daemon at one moment."""

    model_config = ConfigDict(frozen=True, use_attribute_docstrings=True, json_schema_extra=always_present)


class ConfigurationState(Report):
    """What became of the configuration file since the daemon has read it."""

    loaded_at: str
    """When the settings in use were read"""
    restart_needed_for: tuple[str, ...]
    """Settings, as `section.name`, that the file says otherwise by now and a restart alone applies"""
    problem: str | None
    """Why the file was refused at the last SIGHUP; the settings before stay in use"""


class DeviceState(StrEnum):
    """State of one camera or of the light gate."""

    CLOSED = "closed"
    ARMED = "armed"
    LOST = "lost"
    """It does not work or does not answer; the daemon keeps trying to bring it back."""


class AcquisitionState(StrEnum):
    """State of the rig, from ignoring stones to measuring them."""

    DISARMED = "disarmed"
    """Triggers of the light gate are ignored."""
    ARMING = "arming"
    ARMED = "armed"
    """Every trigger becomes a bundle."""
    HELD = "held"
    """Arming was requested, but devices are lost or nothing can be stored; it is armed again by itself."""
    DISARMING = "disarming"
    STOPPING = "stopping"
    """The daemon is stopping and accepts no more requests."""


class AcquisitionTarget(StrEnum):
    """A state of the rig that can be requested."""

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
"""The state that follows a request; requesting a state that is reached or on its way changes nothing. Pairs that are
missing are conflicts: arming while disarming, and anything while stopping."""


class ConflictError(ProblemError):
    """The acquisition cannot change from its current state to the requested one."""

    kinds = (
        ProblemKind(
            "transition-conflict", HTTPStatus.CONFLICT, "The acquisition cannot change to this state now"
        ),
    )

    def __init__(self, current: AcquisitionState, target: AcquisitionTarget) -> None:
        detail = f"acquisition is {current} and cannot become {target} now"
        super().__init__(detail, current=current, target=target)


class NotDisarmedError(ProblemError):
    """The acquisition holds the cameras exclusively."""

    kinds = (ProblemKind("not-disarmed", HTTPStatus.CONFLICT, "The rig must be disarmed first"),)

    def __init__(self, current: AcquisitionState) -> None:
        super().__init__(f"acquisition is {current}: it must be disarmed first", current=current)


def next_state(current: AcquisitionState, target: AcquisitionTarget) -> AcquisitionState:
    """Return the state that follows a request for `target`; raise `ConflictError` where `TRANSITIONS` has none."""
    try:
        return TRANSITIONS[current, target]
    except KeyError:
        raise ConflictError(current, target) from None


class CheckStatus(StrEnum):
    """Result of one check, from best to worst."""

    PASS = "pass"  # noqa: S105 - a word of the health+json draft
    WARN = "warn"
    FAIL = "fail"


class Ne107(StrEnum):
    """Device state in the words of NAMUR NE 107."""

    GOOD = "good"
    CHECK_FUNCTION = "check_function"
    """Results are temporarily not to be trusted: calibration, replay, service."""
    MAINTENANCE_REQUIRED = "maintenance_required"
    """Results are still as specified, but will not be for long."""
    OUT_OF_SPECIFICATION = "out_of_specification"
    """Results are less certain than specified."""
    FAILURE = "failure"
    """There are no results."""


class AcquisitionStatus(Report):
    """State of the rig; counters begin when it is armed."""

    state: AcquisitionState
    """State of the rig; `held`: arming was requested, and devices or the store do not allow it"""
    trouble: Said | None = None
    """Why it is held; null when it is not"""
    activity: Literal["idle", "measuring", "suspended"] = "idle"
    """Suspended: armed, and no stone for a minute"""
    cameras_armed: int = 0
    """Cameras that expose at each trigger"""
    cameras: int = 0
    """Cameras of the rig"""
    gate: DeviceState = DeviceState.CLOSED
    """State of the light gate"""
    gate_error: Said | None = None
    """Why the light gate is lost; null when it is not"""
    gate_warnings: tuple[Said, ...] = ()
    """What works but needs attention, with the remedy"""
    last_stone_age_s: float | None = None
    """Seconds since the last stone; null before the first"""
    triggers: int = 0
    """Since the rig was armed, exposures of the empty rig among them"""
    orphans: int = 0
    """Stones that the gate did not announce; measured all the same"""
    unseen: int = 0
    """Stones that only the gate's counter shows, without announcement or image; lost"""
    in_dead_time: int = 0
    """Triggers too soon after another; lost"""
    triggers_ignored: int = 0
    """Bounces merged by the gate with the stone before them, and late announcements of orphans"""
    triggers_lost: int = 0
    """Gaps in the gate's own counter: stones it did not announce, orphans or unseen"""
    events_refused: int = 0
    """Frames dropped because the daemon was too slow"""


class HealthCheck(Report):
    """Result of one check of the daemon's health."""

    status: CheckStatus
    """Result of the check"""
    observed_value: float | int | str | bool | None = None
    """What was observed; null when there is no value"""
    observed_unit: str | None = None
    """Unit of `observed_value`; null: none"""
    detail: str | None = None
    """What is wrong and what to do, in words; null when nothing is"""
    findings: tuple[CodedFinding, ...] = ()
    """What `detail` says, as codes with their parameters"""


Checks = Mapping[str, HealthCheck]
"""Checks by name: all of the daemon, or those of one part."""


def health_check(
    detail: str | None,
    value: float | str | None = None,
    unit: str | None = None,
    *,
    warn: bool = False,
    fail: bool = False,
) -> HealthCheck:
    """Return a check with the worst status that applies, and what was observed."""
    status = CheckStatus.FAIL if fail else CheckStatus.WARN if warn else CheckStatus.PASS
    return HealthCheck(
        status=status, observed_value=value, observed_unit=unit, detail=detail, findings=findings_of(detail)
    )


def trouble_check(
    trouble: str | None, value: float | str | None = None, unit: str | None = None
) -> HealthCheck:
    """Return a check that warns of a trouble in its own words, and passes without one."""
    return health_check(trouble, value, unit, warn=trouble is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """State of the daemon, with the checks that it follows from."""

    ne107: Ne107
    ready: bool
    """Whether the next stone will be measured."""
    reasons: tuple[str, ...] = ()
    """Why it is not ready, or not `good`."""
    findings: tuple[CodedFinding, ...] = ()
    """What the reasons say, as codes with their parameters."""
    checks: Checks
    """By name, in the order of `alarms.toml`."""
    gate_ne107: Ne107 = Ne107.GOOD
    rig_ne107: Ne107 = Ne107.GOOD


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationFacts:
    """The calibration that stones are measured with now."""

    calibration_id: str
    method: str
    used_since: str
    """Time of its activation, RFC 3339."""
    at_work: str | None = None
    """Which open calibration or verification collects drops, None if none does."""
    trouble: str | None = None
    """Why results of this calibration are not to be trusted, None if they are."""
