"""The daemon's opinion of itself: facts in, checks and a NAMUR NE 107 state out.

Degrade and flag instead of stop, never continue silently: whatever makes results worse than promised
has a check that names it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.particle import ViewsParameters
from service.control import AcquisitionState, CameraStatus, Check, CheckStatus, Health, Ne107

LOW_DISK_BYTES = 1 << 30
"""Less free space on the store's file system is a warning, a tenth of it a failure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What the daemon knows about itself at one moment."""

    acquisition: AcquisitionState
    trouble: str | None  # why the acquisition is held
    cameras: Sequence[CameraStatus]
    views: ViewsParameters  # how many cameras make which quality
    waiting: int  # bundles in the spool
    max_waiting: int
    overflows: int  # bundles lost because the spool was full
    workers: int  # processes that are up
    slots: int
    worker_restarts: int
    late: Sequence[str]  # parts without progress, see supervision.Heartbeats
    has_background: bool
    calibration_id: str
    last_seq: int  # the newest durable result
    free_bytes: int  # on the store's file system


def assess(facts: Facts) -> Health:
    """Judge every fact; the worst check decides.

    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow (domain 4.3): reduced is *maintenance required*, degraded *out of specification*.
    """
    checks = _checks(facts)
    reasons = tuple(
        f"{name}: {check.detail}" for name, check in checks.items() if check.status is not CheckStatus.PASS
    )
    failed = {name for name, check in checks.items() if check.status is CheckStatus.FAIL}
    usable = sum(camera.state != "lost" for camera in facts.cameras)
    has_failed = any(not name.startswith("camera:") for name in failed)
    is_armed = facts.acquisition is AcquisitionState.ARMED
    if not is_armed:
        reasons = (f"acquisition: {facts.acquisition}", *reasons)
    return Health(
        ne107=_ne107(facts, usable, has_failed=has_failed, is_clean=not reasons),
        ready=is_armed and not has_failed and usable >= facts.views.min,
        reasons=reasons,
        checks=checks,
    )


def _ne107(facts: Facts, usable: int, *, has_failed: bool, is_clean: bool) -> Ne107:
    if has_failed or usable < facts.views.min:
        return Ne107.FAILURE
    if usable < facts.views.reduced:
        return Ne107.OUT_OF_SPECIFICATION
    if facts.acquisition is not AcquisitionState.ARMED:
        return Ne107.CHECK_FUNCTION
    return Ne107.GOOD if is_clean else Ne107.MAINTENANCE_REQUIRED


def _checks(facts: Facts) -> Mapping[str, Check]:
    checks = {f"camera:{camera.id}": _camera(camera) for camera in facts.cameras}
    checks["gate"] = _passes(facts.trouble is None, facts.trouble)
    checks["progress"] = _passes(not facts.late, f"no progress of {', '.join(facts.late)}")
    checks["queue"] = _queue(facts)
    checks["workers"] = Check(
        status=_status(warn=facts.workers < facts.slots, fail=facts.workers == 0),
        value=facts.workers,
        unit="processes",
        detail=f"{facts.workers} of {facts.slots} up, {facts.worker_restarts} restarts",
    )
    checks["background"] = Check(
        status=_status(warn=not facts.has_background),
        value=facts.has_background,
        detail=None if facts.has_background else "the empty rig was not seen yet",
    )
    checks["calibration"] = Check(status=CheckStatus.PASS, value=facts.calibration_id)
    # a store that cannot be written ends the daemon, so whoever can still ask finds it working
    checks["store"] = Check(status=CheckStatus.PASS, value=facts.last_seq, unit="results")
    checks["disk"] = Check(
        status=_status(warn=facts.free_bytes < LOW_DISK_BYTES, fail=facts.free_bytes < LOW_DISK_BYTES // 10),
        value=facts.free_bytes,
        unit="bytes",
        detail=f"{facts.free_bytes / 1e9:.1f} GB free for results",
    )
    return checks


def _camera(camera: CameraStatus) -> Check:
    is_lost = camera.state == "lost"
    return Check(
        status=_status(fail=is_lost), value=camera.state, detail=camera.last_error if is_lost else None
    )


def _queue(facts: Facts) -> Check:
    return Check(
        status=_status(warn=2 * facts.waiting > facts.max_waiting, fail=facts.waiting >= facts.max_waiting),
        value=facts.waiting,
        unit="bundles",
        detail=f"{facts.waiting} of {facts.max_waiting} waiting, {facts.overflows} lost",
    )


def _passes(is_good: bool, problem: str | None) -> Check:
    return Check(status=_status(fail=not is_good), detail=None if is_good else problem)


def _status(*, warn: bool = False, fail: bool = False) -> CheckStatus:
    if fail:
        return CheckStatus.FAIL
    return CheckStatus.WARN if warn else CheckStatus.PASS
