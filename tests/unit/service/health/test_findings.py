"""Findings in words, and the NE 107 word of each device."""

import pytest

from pipeline.frames import CameraId
from service.base.camera_status import CameraStatus
from service.base.status import AcquisitionState, AcquisitionStatus, CalibrationFacts, Ne107
from service.health.findings import CameraFinding, Severity, camera_ne107, described, gate_ne107, rig_ne107

C01 = CameraId("c01")
C02 = CameraId("c02")
MOVED = CameraFinding(cameras=(C01,), severity=Severity.MAINTENANCE, detail="moved", score_px=0.8)
DARK = CameraFinding(cameras=(C01,), severity=Severity.OUT_OF_SPECIFICATION, detail="clean")
OTHER = CameraFinding(cameras=(C02,), severity=Severity.OUT_OF_SPECIFICATION, detail="moved", score_px=2.0)
COMMON = CameraFinding(cameras=(), severity=Severity.OUT_OF_SPECIFICATION, detail="focus", score_px=2.0)


@pytest.mark.parametrize(
    ("state", "warnings", "findings", "word"),
    [
        ("armed", (), (), Ne107.GOOD),
        ("armed", (), (OTHER, COMMON), Ne107.GOOD),
        ("armed", ("its buffer is small",), (), Ne107.MAINTENANCE_REQUIRED),
        ("armed", (), (MOVED,), Ne107.MAINTENANCE_REQUIRED),
        ("armed", (), (MOVED, DARK), Ne107.OUT_OF_SPECIFICATION),
        ("closed", (), (), Ne107.CHECK_FUNCTION),
        ("closed", (), (DARK,), Ne107.OUT_OF_SPECIFICATION),
        ("lost", (), (DARK,), Ne107.FAILURE),
    ],
)
def test_the_word_of_a_camera(state, warnings, findings, word):
    camera = CameraStatus(id=C01, state=state, warnings=warnings)
    assert camera_ne107(camera, findings) is word


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

    assert rig_ne107((), facts()) is Ne107.GOOD
    assert rig_ne107((OTHER,), facts()) is Ne107.OUT_OF_SPECIFICATION
    assert rig_ne107((MOVED,), facts()) is Ne107.MAINTENANCE_REQUIRED
    assert rig_ne107((), facts(at_work="what falls is a ball")) is Ne107.CHECK_FUNCTION
    assert rig_ne107((), facts(trouble="verification 1 failed")) is Ne107.OUT_OF_SPECIFICATION


def test_findings_are_told_with_their_cameras_or_as_those_of_all():
    both = CameraFinding(cameras=(C01, C02), severity=Severity.MAINTENANCE, detail="dust")
    assert described((MOVED, COMMON, both), n_cameras=3) == "c01: moved; all: focus; all: dust"
    assert described((both,), n_cameras=4) == "c01, c02: dust"
    assert described((), n_cameras=3) is None
