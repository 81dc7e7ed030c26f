"""The daemon's opinion of itself: facts in, checks and a NAMUR NE 107 state out.

Degrade and flag instead of stop, never continue silently: whatever makes results worse than promised
has a check that names it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.views.quality import ViewsParameters
from service.acquisition.common_cause import cause_of_all
from service.health.optical_watch import OpticalFinding, Severity
from service.health.rig_watch import Suspicion
from service.status import (
    AcquisitionState,
    AcquisitionStatus,
    CalibrationFacts,
    CameraStatus,
    CheckStatus,
    DeviceState,
    Health,
    HealthCheck,
    Ne107,
)

LOW_DISK_BYTES = 1 << 30
"""Less free space on the store's file system is a warning, a tenth of it a failure."""
BLIND_TRIGGERS = 3
"""So many triggers in a row without any image: the cameras are well, the line between them and the gate is not."""
LOOP_MS = 250.0
"""A loop held up for longer matches frames late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What the daemon knows about itself at one moment."""

    acquisition: AcquisitionStatus
    blind_triggers: int  # in a row
    cameras: Sequence[CameraStatus]
    views: ViewsParameters  # how many cameras make which quality
    waiting: int  # bundles in the spool
    max_waiting: int
    overflows: int  # stones and balls lost because the spool was full
    workers: int  # processes that are up
    slots: int
    worker_restarts: int
    loop_ms: float  # longest hold-up of the event loop within a minute
    clock_step_s: float | None  # by which the wall clock was set lately
    late: Sequence[str]  # parts without progress, see supervision.Heartbeats
    has_background: bool
    has_network: bool = False  # which needs no background
    calibration: CalibrationFacts
    last_seq: int  # the newest durable result
    free_bytes: int  # on the store's file system
    segmentation_warning: str | None = None  # why outlines are not found as configured
    recording_trouble: str | None = None  # why a recording ended early
    left_out: int = 0  # results whose frames are not kept
    archive_trouble: str | None = None  # why lately
    suspicions: Sequence[Suspicion] = ()  # cameras that are not where their calibration says, see rig_watch
    optics: Sequence[OpticalFinding] = ()  # windows, lenses and light that should be looked at


def assess(facts: Facts) -> Health:
    """Judge every fact; the worst check decides.

    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow: reduced is *maintenance required*, degraded *out of specification*.
    """
    checks = _checks(facts)
    parent = checks["cameras"].status is CheckStatus.FAIL
    reasons = tuple(
        f"{name}: {check.detail}"
        for name, check in checks.items()
        if check.status is not CheckStatus.PASS and not (parent and name.startswith("camera:"))
    )
    failed = {name for name, check in checks.items() if check.status is CheckStatus.FAIL}
    usable = sum(camera.state is not DeviceState.LOST for camera in facts.cameras)
    has_failed = any(not name.startswith("camera:") for name in failed)
    state = facts.acquisition.state
    if state is AcquisitionState.HELD:
        has_failed = True
    if state is not AcquisitionState.ARMED:
        reasons = (f"acquisition: {state}", *reasons)
    return Health(
        ne107=_ne107(facts, usable, has_failed=has_failed, is_clean=not reasons),
        ready=(
            state is AcquisitionState.ARMED
            and not has_failed
            and usable >= facts.views.min
            and facts.has_background
        ),
        reasons=reasons,
        checks=checks,
    )


def _ne107(facts: Facts, usable: int, *, has_failed: bool, is_clean: bool) -> Ne107:
    if has_failed or usable < facts.views.min:
        return Ne107.FAILURE
    if (
        usable < facts.views.reduced
        or facts.clock_step_s is not None
        or not facts.has_background
        or any(suspicion.is_dropped for suspicion in facts.suspicions)
        or any(finding.severity is Severity.OUT_OF_SPECIFICATION for finding in facts.optics)
        or facts.calibration.trouble is not None
    ):
        return Ne107.OUT_OF_SPECIFICATION
    if facts.acquisition.state is not AcquisitionState.ARMED or facts.calibration.at_work is not None:
        return Ne107.CHECK_FUNCTION
    return Ne107.GOOD if is_clean else Ne107.MAINTENANCE_REQUIRED


def _checks(facts: Facts) -> Mapping[str, HealthCheck]:
    checks = {f"camera:{camera.id}": _camera(camera) for camera in facts.cameras}
    checks["cameras"] = _all_cameras(facts)
    rig = facts.acquisition
    is_gate_lost = rig.gate is DeviceState.LOST
    checks["gate"] = HealthCheck(
        status=_status(warn=bool(rig.gate_warnings), fail=is_gate_lost),
        observed_value=rig.gate,
        detail=rig.gate_error if is_gate_lost else "; ".join(rig.gate_warnings) or None,
    )
    is_blind = facts.blind_triggers >= BLIND_TRIGGERS
    checks["trigger_line"] = HealthCheck(
        status=_status(fail=is_blind),
        observed_value=facts.blind_triggers,
        observed_unit="triggers",
        detail=_if(
            is_blind,
            f"{facts.blind_triggers} triggers in a row without any image: look at the line from gate to cameras",
        ),
    )
    checks["loop"] = HealthCheck(
        status=_status(warn=facts.loop_ms > LOOP_MS),
        observed_value=round(facts.loop_ms, 1),
        observed_unit="ms",
        detail=_if(facts.loop_ms > LOOP_MS, f"held up for {facts.loop_ms:.0f} ms within the last minute"),
    )
    step_s = facts.clock_step_s
    checks["clock"] = HealthCheck(
        status=_status(warn=step_s is not None),
        observed_value=step_s,
        observed_unit="s",
        detail=None
        if step_s is None
        else f"the wall clock was set by {step_s:+.1f} s: times of results are in doubt",
    )
    checks["progress"] = _passes(not facts.late, f"no progress of {', '.join(facts.late)}")
    checks["queue"] = _queue(facts)
    checks["workers"] = HealthCheck(
        status=_status(warn=facts.workers < facts.slots, fail=facts.workers == 0),
        observed_value=facts.workers,
        observed_unit="processes",
        detail=f"{facts.workers} of {facts.slots} up, {facts.worker_restarts} restarts",
    )
    checks["background"] = HealthCheck(
        status=_status(warn=not facts.has_background),
        observed_value=facts.has_background,
        detail=_if(
            not facts.has_background,
            "the empty rig was not seen yet: let no stone fall for a moment"
            + ("; until then the network alone finds them" if facts.has_network else ""),
        ),
    )
    checks["segmentation"] = HealthCheck(
        status=_status(warn=facts.segmentation_warning is not None), detail=facts.segmentation_warning
    )
    checks["calibration"] = _calibration(facts.calibration)
    # a store that cannot be written ends the daemon, so whoever can still ask finds it working
    checks["store"] = HealthCheck(
        status=CheckStatus.PASS, observed_value=facts.last_seq, observed_unit="results"
    )
    checks["disk"] = HealthCheck(
        status=_status(warn=facts.free_bytes < LOW_DISK_BYTES, fail=facts.free_bytes < LOW_DISK_BYTES // 10),
        observed_value=facts.free_bytes,
        observed_unit="bytes",
        detail=f"{facts.free_bytes / 1e9:.1f} GB free for results",
    )
    trouble = facts.recording_trouble
    checks["recording"] = HealthCheck(status=_status(warn=trouble is not None), detail=trouble)
    checks["archive"] = HealthCheck(
        status=_status(warn=facts.archive_trouble is not None),
        observed_value=facts.left_out,
        observed_unit="left out",
        detail=facts.archive_trouble,
    )
    checks["rig"] = _rig(facts)
    checks["optics"] = _optics(facts)
    return checks


def _all_cameras(facts: Facts) -> HealthCheck:
    lost = [camera for camera in facts.cameras if camera.state is DeviceState.LOST]
    is_all = len(lost) == len(facts.cameras) > 1
    return HealthCheck(
        status=_status(fail=is_all),
        observed_value=len(facts.cameras) - len(lost),
        observed_unit="cameras",
        detail=_if(is_all, cause_of_all([camera.last_error for camera in lost])),
    )


def _camera(camera: CameraStatus) -> HealthCheck:
    is_lost = camera.state is DeviceState.LOST
    detail = camera.last_error if is_lost else "; ".join(camera.warnings) or None
    return HealthCheck(
        status=_status(warn=bool(camera.warnings), fail=is_lost), observed_value=camera.state, detail=detail
    )


def _rig(facts: Facts) -> HealthCheck:
    """What the stones say about the cameras."""
    scores_px = [camera.tangency_px for camera in facts.cameras if camera.tangency_px is not None]
    scores_px += [suspicion.score_px for suspicion in facts.suspicions]
    return HealthCheck(
        status=_status(warn=bool(facts.suspicions)),
        observed_value=round(max(scores_px), 2) if scores_px else None,
        observed_unit="px",
        detail="; ".join(f"{suspicion.camera or 'all'}: {suspicion.detail}" for suspicion in facts.suspicions)
        or None,
    )


def _optics(facts: Facts) -> HealthCheck:
    """What the images say about windows, lenses and light."""
    n_cameras = len(facts.cameras)
    concerned = {camera for finding in facts.optics for camera in finding.cameras}
    return HealthCheck(
        status=_status(warn=bool(facts.optics)),
        observed_value=n_cameras - len(concerned),
        observed_unit="cameras",
        detail="; ".join(
            f"{', '.join(finding.cameras) if 2 * len(finding.cameras) <= n_cameras else 'all'}: {finding.detail}"
            for finding in facts.optics
        )
        or None,
    )


def _calibration(facts: CalibrationFacts) -> HealthCheck:
    wrong = [each for each in (facts.trouble, facts.at_work) if each is not None]
    return HealthCheck(
        status=_status(warn=bool(wrong)),
        observed_value=facts.calibration_id,
        detail="; ".join(wrong) or f"{facts.method}, in use since {facts.used_since}",
    )


def _queue(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(warn=2 * facts.waiting > facts.max_waiting, fail=facts.waiting >= facts.max_waiting),
        observed_value=facts.waiting,
        observed_unit="bundles",
        detail=f"{facts.waiting} of {facts.max_waiting} waiting, {facts.overflows} lost",
    )


def _passes(is_good: bool, problem: str | None) -> HealthCheck:
    return HealthCheck(status=_status(fail=not is_good), detail=_if(not is_good, problem))


def _if(is_so: bool, detail: str | None) -> str | None:
    return detail if is_so else None


def _status(*, warn: bool = False, fail: bool = False) -> CheckStatus:
    if fail:
        return CheckStatus.FAIL
    return CheckStatus.WARN if warn else CheckStatus.PASS
