"""Assess the daemon's health: the checks of its parts in, a NAMUR NE 107 state out.

The daemon degrades and flags instead of stopping, and never continues silently: everything that makes results worse
than specified has a check that names it, made by the part that it is about. Here is what crosses parts.
"""

from collections.abc import Iterable
from dataclasses import replace

from pipeline.views.quality import ViewsParameters
from service.base.messages import Code, about, message
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    Checks,
    CheckStatus,
    Health,
    HealthCheck,
    Ne107,
)
from service.health.alarms.rules import CAMERA, Priority, load_rules
from service.health.findings import gate_ne107


def assess(
    parts: Iterable[Checks], *, acquisition: AcquisitionStatus, views: ViewsParameters, rig_ne107: Ne107
) -> Health:
    """Return the checks of all parts, in the order of `alarms.toml`, and the state that follows from them.

    Reasons are in the order of their alarms' priorities, the most urgent first, and then in that of the checks.
    NE 107: a failed check other than a camera's is *failure*; cameras count as the quality of the results
    they still allow: reduced is *maintenance required*, degraded *out of specification*.
    """
    rules = load_rules()
    order = {name: place for place, name in enumerate(rules.checks)}
    by_name = {name: check for part in parts for name, check in part.items()}
    checks = dict(sorted(by_name.items(), key=lambda item: order[item[0].partition(":")[0]]))
    passing = {name for name, check in checks.items() if check.status is CheckStatus.PASS}
    failing = {name for name, check in checks.items() if check.status is CheckStatus.FAIL}
    cameras = {name for name in checks if name.startswith(f"{CAMERA}:")}
    # what all cameras have in common explains each of them; a bad product is no matter of the device
    explained = passing | {name for name, word in rules.ne107.items() if word is Ne107.GOOD}
    explained |= set() if "cameras" in passing else cameras
    told = sorted(
        (name for name in checks if name not in explained), key=lambda name: _rank(name, checks[name])
    )
    reasons = tuple(f"{name}: {checks[name].detail}" for name in told)
    findings = tuple(
        replace(each, subjects=(name, *each.subjects)) for name in told for each in checks[name].findings
    )
    is_armed = acquisition.state is AcquisitionState.ARMED
    if not is_armed:
        state = about("acquisition", message(Code(f"acquisition_{acquisition.state}")))
        reasons, findings = (str(state), *reasons), (*state.findings, *findings)
    usable = len(cameras - failing)
    words = {word for name, word in rules.ne107.items() if name not in passing}
    if acquisition.state is AcquisitionState.HELD or failing - cameras or usable < views.min:
        ne107 = Ne107.FAILURE
    elif usable < views.reduced or Ne107.OUT_OF_SPECIFICATION in (*words, rig_ne107):
        ne107 = Ne107.OUT_OF_SPECIFICATION
    elif not is_armed or Ne107.CHECK_FUNCTION in words:
        ne107 = Ne107.CHECK_FUNCTION
    else:
        ne107 = Ne107.MAINTENANCE_REQUIRED if reasons else Ne107.GOOD
    return Health(
        ne107=ne107,
        ready=is_armed and ne107 is not Ne107.FAILURE and "background" in passing,
        reasons=reasons,
        findings=findings,
        checks=checks,
        gate_ne107=gate_ne107(acquisition),
        rig_ne107=rig_ne107,
    )


def _rank(name: str, check: HealthCheck) -> int:
    """Return 0 for the most urgent check, by the priority of its alarm, and more for others."""
    rule = load_rules().of(name)
    priority = None if rule is None else rule.priority(check.status)
    return len(Priority) if priority is None else priority.rank
