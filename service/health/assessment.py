"""Assess the daemon's health: the checks of its parts in, a NAMUR NE 107 state out.

The daemon degrades and flags instead of stopping, and never continues silently: everything that makes results worse
than specified has a check that names it, made by the part that it is about. Here is what crosses parts.
"""

from collections.abc import Iterable, Sequence

from pipeline.views.quality import ViewsParameters
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    CalibrationFacts,
    Checks,
    CheckStatus,
    Health,
    Ne107,
)
from service.health.alarms.rules import CAMERA, load_rules
from service.health.device_words import gate_ne107, rig_ne107
from service.health.optical_watch import OpticalFinding, Severity
from service.health.rig_watch import Suspicion

DOUBTFUL = ("clock", "background", "calibration")
"""Checks that, unless they pass, say that results are less certain than specified."""


def assess(
    parts: Iterable[Checks],
    *,
    rig: AcquisitionStatus,
    views: ViewsParameters,
    calibration: CalibrationFacts,
    suspicions: Sequence[Suspicion],
    findings: Sequence[OpticalFinding],
) -> Health:
    """Return the checks of all parts, in the order of `alarms.toml`, and the state that follows from them.

    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow: reduced is *maintenance required*, degraded *out of specification*.
    """
    checks = _in_order(parts)
    of_all = {name: check for name, check in checks.items() if not name.startswith(f"{CAMERA}:")}
    # what all cameras have in common explains each of them
    told = checks if checks["cameras"].status is CheckStatus.PASS else of_all
    reasons = tuple(
        f"{name}: {check.detail}" for name, check in told.items() if check.status is not CheckStatus.PASS
    )
    is_armed = rig.state is AcquisitionState.ARMED
    if not is_armed:
        reasons = (f"acquisition: {rig.state}", *reasons)
    has_failed = rig.state is AcquisitionState.HELD or any(
        check.status is CheckStatus.FAIL for check in of_all.values()
    )
    usable = sum(check.status is not CheckStatus.FAIL for name, check in checks.items() if name not in of_all)
    passes = {name for name, check in checks.items() if check.status is CheckStatus.PASS}
    if has_failed or usable < views.min:
        ne107 = Ne107.FAILURE
    elif (
        usable < views.reduced
        or not passes.issuperset(DOUBTFUL)
        or any(suspicion.is_dropped for suspicion in suspicions)
        or any(finding.severity is Severity.OUT_OF_SPECIFICATION for finding in findings)
    ):
        ne107 = Ne107.OUT_OF_SPECIFICATION
    elif not is_armed or "drops" not in passes:
        ne107 = Ne107.CHECK_FUNCTION
    else:
        ne107 = Ne107.MAINTENANCE_REQUIRED if reasons else Ne107.GOOD
    return Health(
        ne107=ne107,
        ready=is_armed and not has_failed and usable >= views.min and "background" in passes,
        reasons=reasons,
        checks=checks,
        gate_ne107=gate_ne107(rig),
        rig_ne107=rig_ne107(suspicions, findings, calibration),
    )


def _in_order(parts: Iterable[Checks]) -> Checks:
    order = {name: place for place, name in enumerate(load_rules().checks)}
    checks = {name: check for part in parts for name, check in part.items()}
    return dict(sorted(checks.items(), key=lambda item: order[item[0].partition(":")[0]]))
