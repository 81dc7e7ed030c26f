"""Assess the daemon's health: facts in, named checks and a NAMUR NE 107 state out.

The daemon degrades and flags instead of stopping, and never continues silently: everything that makes results worse
than specified has a check that names it.
"""

from collections.abc import Callable, Mapping

from drivers.interfaces import ProcessState
from service.base.status import (
    AcquisitionState,
    CameraStatus,
    CheckStatus,
    DeviceState,
    Health,
    HealthCheck,
    Ne107,
)
from service.health.device_words import gate_ne107, rig_ne107
from service.health.facts import Facts
from service.health.optical_watch import Severity
from service.health.store_checks import disk, disk_days, retention, store

BLIND_TRIGGERS = 3
"""Triggers in a row without any image from which the line between gate and cameras is taken to be broken."""
LOOP_MS = 250.0
"""Delay of the event loop above which frames may be matched late."""


def assess(facts: Facts) -> Health:
    """Return all checks, and the state that follows from them.

    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow: reduced is *maintenance required*, degraded *out of specification*.
    """
    of_cameras = {f"camera:{camera.id}": _camera(camera) for camera in facts.cameras}
    of_all = {name: check(facts) for name, check in CHECKS.items()}
    told = of_all if facts.common_cause is not None else of_cameras | of_all
    reasons = tuple(
        f"{name}: {check.detail}" for name, check in told.items() if check.status is not CheckStatus.PASS
    )
    state = facts.acquisition.state
    if state is not AcquisitionState.ARMED:
        reasons = (f"acquisition: {state}", *reasons)
    has_failed = state is AcquisitionState.HELD or any(
        check.status is CheckStatus.FAIL for check in of_all.values()
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
        checks=of_cameras | of_all,
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
        status=CheckStatus.of(warn=bool(camera.warnings), fail=is_lost),
        observed_value=camera.state,
        detail=camera.last_error if is_lost else "; ".join(camera.warnings) or None,
    )


def _all_cameras(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(fail=facts.common_cause is not None),
        observed_value=_usable_cameras(facts),
        observed_unit="cameras",
        detail=facts.common_cause,
    )


def _gate(facts: Facts) -> HealthCheck:
    rig = facts.acquisition
    is_lost = rig.gate is DeviceState.LOST
    return HealthCheck(
        status=CheckStatus.of(warn=bool(rig.gate_warnings), fail=is_lost),
        observed_value=rig.gate,
        detail=rig.gate_error if is_lost else "; ".join(rig.gate_warnings) or None,
    )


def _camera_process(facts: Facts) -> HealthCheck:
    process = facts.camera_process
    return HealthCheck(
        status=CheckStatus.of(
            warn=process.state is ProcessState.REPLACED, fail=process.state is ProcessState.SILENT
        ),
        observed_value=process.replaced,
        observed_unit="replaced",
        detail=process.trouble,
    )


def _trigger_line(facts: Facts) -> HealthCheck:
    """Check that triggers have images; while the process of the cameras is silent, that is the reason for none."""
    n_blind = facts.blind_triggers
    is_broken = n_blind >= BLIND_TRIGGERS and facts.camera_process.state is not ProcessState.SILENT
    problem = f"{n_blind} triggers in a row without any image: look at the line from gate to cameras"
    return HealthCheck(
        status=CheckStatus.of(fail=is_broken),
        observed_value=n_blind,
        observed_unit="triggers",
        detail=problem if is_broken else None,
    )


def _loop(facts: Facts) -> HealthCheck:
    is_slow = facts.loop_ms > LOOP_MS
    problem = f"blocked for {facts.loop_ms:.0f} ms within the last minute: look at the load of the machine"
    return HealthCheck(
        status=CheckStatus.of(warn=is_slow),
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
        status=CheckStatus.of(warn=problem is not None),
        observed_value=step_s,
        observed_unit="s",
        detail=problem,
    )


def _progress(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(fail=bool(facts.late)),
        detail=f"no progress of {', '.join(facts.late)}: look at the journal" if facts.late else None,
    )


def _queue(facts: Facts) -> HealthCheck:
    waiting = f"{facts.waiting} of {facts.max_waiting} waiting"
    trouble = facts.spool_trouble
    return HealthCheck(
        status=CheckStatus.of(
            warn=2 * facts.waiting > facts.max_waiting or trouble is not None,
            fail=facts.waiting >= facts.max_waiting,
        ),
        observed_value=facts.waiting,
        observed_unit="bundles",
        detail=waiting if trouble is None else f"{waiting}; within the last minute: {trouble}",
    )


def _workers(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(
            warn=facts.workers < facts.slots or facts.worker_trouble is not None, fail=facts.workers == 0
        ),
        observed_value=facts.workers,
        observed_unit="processes",
        detail=f"{facts.workers} of {facts.slots} up, {facts.worker_restarts} restarts"
        + (f"; within the last minute: {facts.worker_trouble}" if facts.worker_trouble else ""),
    )


def _quarantine(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(warn=bool(facts.quarantined)),
        observed_value=len(facts.quarantined),
        observed_unit="bundles",
        detail=f"no worker survived {', '.join(facts.quarantined)}" if facts.quarantined else None,
    )


def _background(facts: Facts) -> HealthCheck:
    problem = "the empty rig was not exposed yet: let no stone fall for a moment"
    if facts.has_network:
        problem += "; until then the network alone finds them"
    return HealthCheck(
        status=CheckStatus.of(warn=not facts.has_background),
        observed_value=facts.has_background,
        detail=None if facts.has_background else problem,
    )


def _calibration(facts: Facts) -> HealthCheck:
    calibration = facts.calibration
    return HealthCheck(
        status=CheckStatus.of(warn=calibration.trouble is not None),
        observed_value=calibration.calibration_id,
        detail=calibration.trouble or f"{calibration.method}, in use since {calibration.used_since}",
    )


def _archive(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(warn=facts.archive_trouble is not None),
        observed_value=facts.left_out,
        observed_unit="left out",
        detail=facts.archive_trouble,
    )


def _webhooks(facts: Facts) -> HealthCheck:
    return HealthCheck(
        status=CheckStatus.of(warn=bool(facts.webhook_troubles)),
        observed_value=len(facts.webhook_troubles),
        observed_unit="disabled",
        detail="; ".join(facts.webhook_troubles) or None,
    )


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
        status=CheckStatus.of(warn=bool(facts.suspicions)),
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
        status=CheckStatus.of(warn=bool(facts.optical_findings)),
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
        status=CheckStatus.of(warn=trend.warning is not None),
        observed_value=None if trend.supported_share is None else round(trend.supported_share, 3),
        observed_unit="share",
        detail=trend.warning,
    )


def _trouble(trouble: str | None) -> HealthCheck:
    """Return a check that warns of a trouble in its own words, and passes without one."""
    return HealthCheck(status=CheckStatus.of(warn=trouble is not None), detail=trouble)


CHECKS: Mapping[str, Callable[[Facts], HealthCheck]] = {
    "cameras": _all_cameras,
    "gate": _gate,
    "camera_process": _camera_process,
    "trigger_line": _trigger_line,
    "loop": _loop,
    "clock": _clock,
    "progress": _progress,
    "queue": _queue,
    "workers": _workers,
    "quarantine": _quarantine,
    "background": _background,
    "segmentation": lambda facts: _trouble(facts.segmentation_warning),
    "calibration": _calibration,
    "drops": lambda facts: _trouble(facts.calibration.at_work),  # then what falls is no stone
    "store": store,
    "disk": disk,
    "disk_days": disk_days,
    "retention": retention,
    "backup": lambda facts: _trouble(facts.backup_trouble),
    "keys": lambda facts: _trouble(facts.key_trouble),
    "recording": lambda facts: _trouble(facts.recording_trouble),
    "archive": _archive,
    "webhooks": _webhooks,
    "file_drop": lambda facts: _trouble(facts.file_drop_trouble),
    "configuration": _configuration,
    "rig": _rig,
    "optics": _optics,
    "refinement": _refinement,
}
"""All checks but those of single cameras, by name, in the order in which they are reported."""
