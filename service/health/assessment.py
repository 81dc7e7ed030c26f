"""Assess the daemon's health: facts in, named checks and a NAMUR NE 107 state out.

The daemon degrades and flags instead of stopping, and never continues silently: everything that makes results worse
than specified has a check that names it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from pipeline.views.quality import ViewsParameters
from service.health.device_words import gate_ne107, rig_ne107
from service.health.optical_watch import OpticalFinding, Severity
from service.health.refinement_watch import RefinementTrend
from service.health.retention_checks import disk_days, retention
from service.health.rig_watch import Suspicion
from service.status import (
    AcquisitionState,
    AcquisitionStatus,
    CalibrationFacts,
    CameraStatus,
    CheckStatus,
    ConfigurationState,
    DeviceState,
    Health,
    HealthCheck,
    Ne107,
)
from service.store.disk_use import RetentionFacts

LOW_DISK_BYTES = 1 << 30
"""Free space on the store's file system below which health warns; below a tenth of it, the check fails."""
BLIND_TRIGGERS = 3
"""Triggers in a row without any image from which the line between gate and cameras is taken to be broken."""
LOOP_MS = 250.0
"""Delay of the event loop above which frames may be matched late."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """Everything that the daemon knows about its own state at one moment."""

    acquisition: AcquisitionStatus
    cameras: Sequence[CameraStatus]
    common_cause: str | None = None  # why all cameras are lost
    blind_triggers: int  # in a row, without any image
    views: ViewsParameters  # how many cameras make which quality

    waiting: int  # bundles in the spool
    without_outcome: int = 0  # these, and losses that are not stored yet
    max_waiting: int
    spool_trouble: str | None = None  # what went wrong with it lately: stones lost, its folder deleted
    workers: int  # processes that run
    slots: int
    worker_restarts: int
    worker_trouble: str | None = None  # how the latest process failed that did so lately
    quarantined: Sequence[str] = ()  # files of bundles that no worker survived
    late: Sequence[str]  # parts without progress, see `service.daemon.heartbeats`
    loop_ms: float  # longest delay of the event loop within a minute
    clock_step_s: float | None  # by which the wall clock was set lately
    clock_is_unset: bool = False  # since the host started, as one without a battery

    has_background: bool
    has_network: bool = False  # which needs no background
    segmentation_warning: str | None = None  # why outlines are not found as configured
    calibration: CalibrationFacts
    suspicions: Sequence[Suspicion] = ()  # cameras that contradict their calibration, see `rig_watch`
    optical_findings: Sequence[OpticalFinding] = ()  # windows, lenses and light to clean or repair
    refinement: RefinementTrend  # what the pixels inside the outlines say of the stones

    last_seq: int  # the newest durable result
    store_trouble: str | None = None  # why nothing can be written now, with the remedy
    store_incidents: Sequence[str] = ()  # what was moved aside at a start, see `service.store.history`
    backup_trouble: str | None = None  # why the last backup failed
    retention: RetentionFacts | None = None  # what the store takes, and what was removed
    free_bytes: int | None  # on the store's file system, None if that does not answer
    key_trouble: str | None = None  # why keys of the store's folder are not accepted
    recording_trouble: str | None = None  # why a recording ended early
    left_out: int = 0  # results whose frames were not archived
    archive_trouble: str | None = None  # why frames were not archived lately
    webhook_troubles: Sequence[str] = ()  # endpoints that are told nothing any more
    file_drop_trouble: str | None = None  # why files of closed lots cannot be written
    configuration: ConfigurationState | None = None  # what became of its file


def assess(facts: Facts) -> Health:
    """Return all checks, and the state that follows from them.

    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow: reduced is *maintenance required*, degraded *out of specification*.
    """
    checks = {f"camera:{camera.id}": _camera(camera) for camera in facts.cameras}
    checks |= {name: check(facts) for name, check in CHECKS.items()}
    has_common_cause = checks["cameras"].status is CheckStatus.FAIL
    reasons = tuple(
        f"{name}: {check.detail}"
        for name, check in checks.items()
        if check.status is not CheckStatus.PASS and not (has_common_cause and name.startswith("camera:"))
    )
    state = facts.acquisition.state
    if state is not AcquisitionState.ARMED:
        reasons = (f"acquisition: {state}", *reasons)
    has_failed = state is AcquisitionState.HELD or any(
        check.status is CheckStatus.FAIL and not name.startswith("camera:") for name, check in checks.items()
    )
    usable = _usable_cameras(facts)
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
        gate_ne107=gate_ne107(facts.acquisition),
        rig_ne107=rig_ne107(facts.suspicions, facts.optical_findings, facts.calibration),
    )


def _ne107(facts: Facts, usable: int, *, has_failed: bool, is_clean: bool) -> Ne107:
    if has_failed or usable < facts.views.min:
        return Ne107.FAILURE
    if (
        usable < facts.views.reduced
        or facts.clock_step_s is not None
        or facts.clock_is_unset
        or not facts.has_background
        or any(suspicion.is_dropped for suspicion in facts.suspicions)
        or any(finding.severity is Severity.OUT_OF_SPECIFICATION for finding in facts.optical_findings)
        or facts.calibration.trouble is not None
    ):
        return Ne107.OUT_OF_SPECIFICATION
    if facts.acquisition.state is not AcquisitionState.ARMED or facts.calibration.at_work is not None:
        return Ne107.CHECK_FUNCTION
    return Ne107.GOOD if is_clean else Ne107.MAINTENANCE_REQUIRED


def _usable_cameras(facts: Facts) -> int:
    return sum(camera.state is not DeviceState.LOST for camera in facts.cameras)


def _camera(camera: CameraStatus) -> HealthCheck:
    is_lost = camera.state is DeviceState.LOST
    return HealthCheck(
        status=_status(warn=bool(camera.warnings), fail=is_lost),
        observed_value=camera.state,
        detail=camera.last_error if is_lost else "; ".join(camera.warnings) or None,
    )


def _all_cameras(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(fail=facts.common_cause is not None),
        observed_value=_usable_cameras(facts),
        observed_unit="cameras",
        detail=facts.common_cause,
    )


def _gate(facts: Facts) -> HealthCheck:
    rig = facts.acquisition
    is_lost = rig.gate is DeviceState.LOST
    return HealthCheck(
        status=_status(warn=bool(rig.gate_warnings), fail=is_lost),
        observed_value=rig.gate,
        detail=rig.gate_error if is_lost else "; ".join(rig.gate_warnings) or None,
    )


def _trigger_line(facts: Facts) -> HealthCheck:
    n_blind = facts.blind_triggers
    is_broken = n_blind >= BLIND_TRIGGERS
    problem = f"{n_blind} triggers in a row without any image: look at the line from gate to cameras"
    return HealthCheck(
        status=_status(fail=is_broken),
        observed_value=n_blind,
        observed_unit="triggers",
        detail=problem if is_broken else None,
    )


def _loop(facts: Facts) -> HealthCheck:
    is_slow = facts.loop_ms > LOOP_MS
    problem = f"held up for {facts.loop_ms:.0f} ms within the last minute: look at the load of the machine"
    return HealthCheck(
        status=_status(warn=is_slow),
        observed_value=round(facts.loop_ms, 1),
        observed_unit="ms",
        detail=problem if is_slow else None,
    )


def _clock(facts: Facts) -> HealthCheck:
    step_s, problem = facts.clock_step_s, None
    if facts.clock_is_unset:
        problem = (
            "the wall clock was not set since the host started: give it a time server, or timedatectl set-time;"
            " until then results are marked time_is_doubtful"
        )
    elif step_s is not None:
        problem = f"the wall clock was set by {step_s:+.1f} s: times of results are in doubt"
    return HealthCheck(
        status=_status(warn=problem is not None), observed_value=step_s, observed_unit="s", detail=problem
    )


def _progress(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(fail=bool(facts.late)),
        detail=f"no progress of {', '.join(facts.late)}: look at the journal" if facts.late else None,
    )


def _queue(facts: Facts) -> HealthCheck:
    waiting = f"{facts.waiting} of {facts.max_waiting} waiting"
    trouble = facts.spool_trouble
    return HealthCheck(
        status=_status(
            warn=2 * facts.waiting > facts.max_waiting or trouble is not None,
            fail=facts.waiting >= facts.max_waiting,
        ),
        observed_value=facts.waiting,
        observed_unit="bundles",
        detail=waiting if trouble is None else f"{waiting}; within the last minute: {trouble}",
    )


def _workers(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(
            warn=facts.workers < facts.slots or facts.worker_trouble is not None, fail=facts.workers == 0
        ),
        observed_value=facts.workers,
        observed_unit="processes",
        detail=f"{facts.workers} of {facts.slots} up, {facts.worker_restarts} restarts"
        + (f"; within the last minute: {facts.worker_trouble}" if facts.worker_trouble else ""),
    )


def _quarantine(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(warn=bool(facts.quarantined)),
        observed_value=len(facts.quarantined),
        observed_unit="bundles",
        detail=f"no worker survived {', '.join(facts.quarantined)}" if facts.quarantined else None,
    )


def _background(facts: Facts) -> HealthCheck:
    problem = "the empty rig was not exposed yet: let no stone fall for a moment"
    if facts.has_network:
        problem += "; until then the network alone finds them"
    return HealthCheck(
        status=_status(warn=not facts.has_background),
        observed_value=facts.has_background,
        detail=None if facts.has_background else problem,
    )


def _segmentation(facts: Facts) -> HealthCheck:
    warning = facts.segmentation_warning
    return HealthCheck(status=_status(warn=warning is not None), detail=warning)


def _calibration(facts: Facts) -> HealthCheck:
    calibration = facts.calibration
    return HealthCheck(
        status=_status(warn=calibration.trouble is not None),
        observed_value=calibration.calibration_id,
        detail=calibration.trouble or f"{calibration.method}, in use since {calibration.used_since}",
    )


def _drops(facts: Facts) -> HealthCheck:
    """Check whether what falls is a stone."""
    at_work = facts.calibration.at_work
    return HealthCheck(status=_status(warn=at_work is not None), detail=at_work)


def _store(facts: Facts) -> HealthCheck:
    is_held = facts.store_trouble is not None
    held = [f"{facts.store_trouble}; {facts.without_outcome} stones wait for it"] if is_held else []
    aside = [f"store.dir/{incident.removesuffix('.')}" for incident in facts.store_incidents]
    if aside:
        aside.append("look at it, restore a backup if results are missing, then move it out of store.dir")
    return HealthCheck(
        status=_status(warn=bool(aside), fail=is_held),
        observed_value=facts.last_seq,
        observed_unit="results",
        detail="; ".join(held + aside) or None,
    )


def _disk(facts: Facts) -> HealthCheck:
    if facts.free_bytes is None:
        return HealthCheck(status=CheckStatus.FAIL, detail="the file system of store.dir does not answer")
    return HealthCheck(
        status=_status(warn=facts.free_bytes < LOW_DISK_BYTES, fail=facts.free_bytes < LOW_DISK_BYTES // 10),
        observed_value=facts.free_bytes,
        observed_unit="bytes",
        detail=f"{facts.free_bytes / 1e9:.1f} GB free for results",
    )


def _backup(facts: Facts) -> HealthCheck:
    return HealthCheck(status=_status(warn=facts.backup_trouble is not None), detail=facts.backup_trouble)


def _keys(facts: Facts) -> HealthCheck:
    return HealthCheck(status=_status(warn=facts.key_trouble is not None), detail=facts.key_trouble)


def _recording(facts: Facts) -> HealthCheck:
    trouble = facts.recording_trouble
    return HealthCheck(status=_status(warn=trouble is not None), detail=trouble)


def _archive(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(warn=facts.archive_trouble is not None),
        observed_value=facts.left_out,
        observed_unit="left out",
        detail=facts.archive_trouble,
    )


def _webhooks(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=_status(warn=bool(facts.webhook_troubles)),
        observed_value=len(facts.webhook_troubles),
        observed_unit="disabled",
        detail="; ".join(facts.webhook_troubles) or None,
    )


def _file_drop(facts: Facts) -> HealthCheck:
    trouble = facts.file_drop_trouble
    return HealthCheck(status=_status(warn=trouble is not None), detail=trouble)


def _configuration(facts: Facts) -> HealthCheck:
    """Check that the daemon works with what the configuration file says."""
    state = facts.configuration
    if state is None or (state.problem is None and not state.restart_needed_for):
        return HealthCheck(status=CheckStatus.PASS)
    waiting = f"a restart is needed for {', '.join(state.restart_needed_for)}"
    refused = f"the configuration was refused, the one of {state.loaded_at} stays in use: {state.problem}"
    return HealthCheck(status=CheckStatus.WARN, detail=waiting if state.problem is None else refused)


def _rig(facts: Facts) -> HealthCheck:
    """Check whether cameras still are where their calibration says, by the outlines of the stones."""
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
    """Check how well the cameras see: windows, lenses and light."""
    n_cameras = len(facts.cameras)
    concerned = {camera for finding in facts.optical_findings for camera in finding.cameras}
    return HealthCheck(
        status=_status(warn=bool(facts.optical_findings)),
        observed_value=n_cameras - len(concerned),
        observed_unit="cameras",
        detail="; ".join(
            f"{', '.join(finding.cameras) if 2 * len(finding.cameras) <= n_cameras else 'all'}: {finding.detail}"
            for finding in facts.optical_findings
        )
        or None,
    )


def _refinement(facts: Facts) -> HealthCheck:
    """Check whether there is time to look for dents, and whether pixels show as much as they did."""
    trend = facts.refinement
    return HealthCheck(
        status=_status(warn=trend.warning is not None),
        observed_value=None if trend.supported_share is None else round(trend.supported_share, 3),
        observed_unit="share",
        detail=trend.warning,
    )


def _status(*, warn: bool = False, fail: bool = False) -> CheckStatus:
    if fail:
        return CheckStatus.FAIL
    return CheckStatus.WARN if warn else CheckStatus.PASS


CHECKS: Mapping[str, Callable[[Facts], HealthCheck]] = {
    "cameras": _all_cameras,
    "gate": _gate,
    "trigger_line": _trigger_line,
    "loop": _loop,
    "clock": _clock,
    "progress": _progress,
    "queue": _queue,
    "workers": _workers,
    "quarantine": _quarantine,
    "background": _background,
    "segmentation": _segmentation,
    "calibration": _calibration,
    "drops": _drops,
    "store": _store,
    "disk": _disk,
    "disk_days": lambda facts: disk_days(facts.retention),
    "retention": lambda facts: retention(facts.retention),
    "backup": _backup,
    "keys": _keys,
    "recording": _recording,
    "archive": _archive,
    "webhooks": _webhooks,
    "file_drop": _file_drop,
    "configuration": _configuration,
    "rig": _rig,
    "optics": _optics,
    "refinement": _refinement,
}
"""All checks but those of single cameras, by name, in the order in which they are reported."""
