"""Findings about cameras, and the NE 107 word of each device: a camera, the light gate, and the rig.

The rig is the geometry and optics of the cameras, which `rig_watch` and `optical_watch` judge.
"""

from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum

from pipeline.frames import CameraId
from service.base.camera_status import CameraStatus
from service.base.messages import CodedText, about, joined
from service.base.status import AcquisitionStatus, CalibrationFacts, DeviceState, Ne107


class Severity(IntEnum):
    """Severity of a finding."""

    NOTHING = 0
    MAINTENANCE = 1
    OUT_OF_SPECIFICATION = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFinding:
    """Something that should be cleaned, adjusted or replaced, or a camera that contradicts its calibration."""

    cameras: tuple[CameraId, ...]
    """Cameras that see it, worst first; none: most have it in common, and it is of no camera alone."""
    severity: Severity
    detail: CodedText  # what it is, how much, and the remedy
    score_px: float = 0.0  # of geometry: how far outlines are from where they should be


def described(findings: Collection[CameraFinding], n_cameras: int) -> CodedText | None:
    """Return the findings in one line, each after its cameras, None when there are none."""
    names = (", ".join(each.cameras) if 2 * len(each.cameras) <= n_cameras else "" for each in findings)
    return joined([about(name or "all", each.detail) for name, each in zip(names, findings, strict=True)])


def camera_ne107(camera: CameraStatus, findings: Collection[CameraFinding]) -> Ne107:
    """Return the word of a camera, by what is said of this camera alone."""
    own = [finding for finding in findings if camera.id in finding.cameras]
    return _word(camera.state, own, needs_attention=bool(camera.warnings))


def gate_ne107(rig: AcquisitionStatus) -> Ne107:
    """Return the word of the light gate."""
    return _word(rig.gate, needs_attention=bool(rig.gate_warnings))


def rig_ne107(findings: Collection[CameraFinding], calibration: CalibrationFacts) -> Ne107:
    """Return the word of the rig: whether its geometry and optics are as calibrated."""
    if calibration.trouble is not None:
        return Ne107.OUT_OF_SPECIFICATION
    return _word(DeviceState.ARMED if calibration.at_work is None else DeviceState.CLOSED, findings)


def _word(
    state: DeviceState, findings: Collection[CameraFinding] = (), *, needs_attention: bool = False
) -> Ne107:
    if state is DeviceState.LOST:
        return Ne107.FAILURE
    if any(finding.severity is Severity.OUT_OF_SPECIFICATION for finding in findings):
        return Ne107.OUT_OF_SPECIFICATION
    if state is DeviceState.CLOSED:
        return Ne107.CHECK_FUNCTION
    return Ne107.MAINTENANCE_REQUIRED if needs_attention or findings else Ne107.GOOD
