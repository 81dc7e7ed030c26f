"""The NE 107 word of each device: a camera, the light gate, and the rig, which is their geometry and optics."""

from collections.abc import Sequence

from service.base.status import AcquisitionStatus, CalibrationFacts, CameraStatus, DeviceState, Ne107
from service.health.optical_watch import OpticalFinding, Severity
from service.health.rig_watch import Suspicion


def camera_ne107(
    camera: CameraStatus, suspicions: Sequence[Suspicion], findings: Sequence[OpticalFinding]
) -> Ne107:
    """Return the word of a camera, by what is said of this camera alone."""
    return _word(
        camera.state,
        [suspicion for suspicion in suspicions if suspicion.camera == camera.id],
        [finding for finding in findings if camera.id in finding.cameras],
        needs_attention=bool(camera.warnings),
    )


def gate_ne107(rig: AcquisitionStatus) -> Ne107:
    """Return the word of the light gate."""
    return _word(rig.gate, needs_attention=bool(rig.gate_warnings))


def rig_ne107(
    suspicions: Sequence[Suspicion], findings: Sequence[OpticalFinding], calibration: CalibrationFacts
) -> Ne107:
    """Return the word of the rig: whether its geometry and optics are as calibrated."""
    if calibration.trouble is not None:
        return Ne107.OUT_OF_SPECIFICATION
    state = DeviceState.ARMED if calibration.at_work is None else DeviceState.CLOSED
    return _word(state, suspicions, findings)


def _word(
    state: DeviceState,
    suspicions: Sequence[Suspicion] = (),
    findings: Sequence[OpticalFinding] = (),
    *,
    needs_attention: bool = False,
) -> Ne107:
    if state is DeviceState.LOST:
        return Ne107.FAILURE
    if any(suspicion.is_dropped for suspicion in suspicions) or any(
        finding.severity is Severity.OUT_OF_SPECIFICATION for finding in findings
    ):
        return Ne107.OUT_OF_SPECIFICATION
    if state is DeviceState.CLOSED:
        return Ne107.CHECK_FUNCTION
    return Ne107.MAINTENANCE_REQUIRED if needs_attention or suspicions or findings else Ne107.GOOD
