"""The NE 107 word of each device."""

import pytest

from pipeline.frames import CameraId
from service.base.status import AcquisitionState, AcquisitionStatus, CalibrationFacts, CameraStatus, Ne107
from service.health.device_words import camera_ne107, gate_ne107, rig_ne107
from service.health.optical_watch import OpticalFinding, Severity
from service.health.rig_watch import Suspicion

C01 = CameraId("c01")
MOVED = Suspicion(camera=C01, score_px=0.8, is_dropped=False, detail="moved")
DROPPED = Suspicion(camera=C01, score_px=2.0, is_dropped=True, detail="moved")
OTHER = Suspicion(camera=CameraId("c02"), score_px=2.0, is_dropped=True, detail="moved")
DUSTY = OpticalFinding(cameras=(C01,), severity=Severity.MAINTENANCE, detail="clean")
DARK = OpticalFinding(cameras=(C01,), severity=Severity.OUT_OF_SPECIFICATION, detail="clean")


@pytest.mark.parametrize(
    ("state", "warnings", "suspicions", "findings", "word"),
    [
        ("armed", (), (), (), Ne107.GOOD),
        ("armed", (), (OTHER,), (), Ne107.GOOD),
        ("armed", ("its buffer is small",), (), (), Ne107.MAINTENANCE_REQUIRED),
        ("armed", (), (MOVED,), (), Ne107.MAINTENANCE_REQUIRED),
        ("armed", (), (), (DUSTY,), Ne107.MAINTENANCE_REQUIRED),
        ("armed", (), (DROPPED,), (), Ne107.OUT_OF_SPECIFICATION),
        ("armed", (), (), (DARK,), Ne107.OUT_OF_SPECIFICATION),
        ("closed", (), (), (), Ne107.CHECK_FUNCTION),
        ("closed", (), (), (DARK,), Ne107.OUT_OF_SPECIFICATION),
        ("lost", (), (), (DARK,), Ne107.FAILURE),
    ],
)
def test_the_word_of_a_camera(state, warnings, suspicions, findings, word):
    camera = CameraStatus(id=C01, state=state, warnings=warnings)
    assert camera_ne107(camera, suspicions, findings) is word


@pytest.mark.parametrize(
    ("gate", "warnings", "word"),
    [
        ("armed", (), Ne107.GOOD),
        ("armed", ("the beam is closed",), Ne107.MAINTENANCE_REQUIRED),
        ("closed", (), Ne107.CHECK_FUNCTION),
        ("lost", ("the beam is closed",), Ne107.FAILURE),
    ],
)
def test_the_word_of_the_gate(gate, warnings, word):
    rig = AcquisitionStatus(state=AcquisitionState.ARMED, gate=gate, gate_warnings=warnings)
    assert gate_ne107(rig) is word


def test_the_word_of_the_rig_is_that_of_geometry_and_optics():
    def facts(**more: str) -> CalibrationFacts:
        return CalibrationFacts(calibration_id="rig", method="bundle", used_since="2026", **more)

    assert rig_ne107((), (), facts()) is Ne107.GOOD
    assert rig_ne107((OTHER,), (), facts()) is Ne107.OUT_OF_SPECIFICATION
    assert rig_ne107((MOVED,), (DUSTY,), facts()) is Ne107.MAINTENANCE_REQUIRED
    assert rig_ne107((), (), facts(at_work="what falls is a ball")) is Ne107.CHECK_FUNCTION
    assert rig_ne107((), (), facts(trouble="verification 1 failed")) is Ne107.OUT_OF_SPECIFICATION
