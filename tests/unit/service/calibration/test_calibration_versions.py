"""Which calibration is in use: activation, roll back, damaged files, a crash between two writes."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from support.calibration_desk import ARMED, CONFIGURED, MadeUpSolver, accepted, open_desk, other_rig

import drivers.files.durable
from drivers.files.rig_file import read_rig
from service.base.aside import incidents
from service.calibration.states import CalibrationAction, CalibrationConflictError
from service.calibration.verifications import VerificationRequest, VerificationState


def test_the_configured_rig_is_the_first_version_and_wins_when_it_is_changed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    for _ in range(2):
        desk = open_desk(tmp_path)
        assert (desk.active.id, desk.rig_file.calibration_id) == ("0001", CONFIGURED.calibration_id)
        assert [record.note for record in desk.all()] == ["initial"]
    assert "configured rig file was changed" not in caplog.text
    desk = open_desk(tmp_path, other_rig())
    assert (desk.active.id, desk.rig_file.calibration_id) == ("0002", other_rig().calibration_id)
    assert "configured rig file was changed" in caplog.text
    desk = open_desk(tmp_path)  # changed back: it is version one again, not a third
    assert (desk.active.id, len(desk.all()), len(desk.activations)) == ("0001", 2, 3)


async def test_a_rig_of_other_cameras_or_a_damaged_one_is_not_activated(tmp_path: Path):
    fewer = replace(other_rig(), cameras=CONFIGURED.cameras[:3])
    desk = open_desk(tmp_path, solver=MadeUpSolver(rig=fewer))
    name = await accepted(desk)
    with pytest.raises(CalibrationConflictError, match="other cameras: c04"):
        await desk.act(name, CalibrationAction.ACTIVATE)
    (tmp_path / "calibrations" / name / "rig.json").write_text("{")
    with pytest.raises(
        CalibrationConflictError, match=r"rig file cannot be used: is not JSON.*; activate another one"
    ):
        await desk.act(name, CalibrationAction.ACTIVATE)
    assert desk.active.id == open_desk(tmp_path).active.id == "0001"


async def test_when_the_one_in_use_is_damaged_the_one_before_is_used(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    desk = open_desk(tmp_path)
    name = await accepted(desk)
    await desk.act(name, CalibrationAction.ACTIVATE)
    assert desk.facts().trouble is None
    (tmp_path / "calibrations" / name / "rig.json").write_text("{")
    again = open_desk(tmp_path)
    assert again.active.id == "0001"
    assert f"calibration {name} cannot be used, the one before is" in caplog.text
    assert f"calibration {name} cannot be used (is not JSON" in str(again.facts().trouble)
    await again.act("0001", CalibrationAction.ACTIVATE)
    assert again.facts().trouble is open_desk(tmp_path).facts().trouble is None
    shutil.rmtree(tmp_path / "calibrations" / name)
    (tmp_path / "calibrations/0001/rig.json").unlink()
    assert (
        open_desk(tmp_path).rig_file.calibration_id
        == read_rig(tmp_path / "calibrations/0001/rig.json").calibration_id
    )


async def test_a_damaged_list_of_activations_is_set_aside_and_told(tmp_path: Path):
    desk = open_desk(tmp_path)
    await desk.act(await accepted(desk), CalibrationAction.ACTIVATE)
    (tmp_path / "calibrations/activations.json").write_bytes(b"\xff{")
    desk = open_desk(tmp_path)
    assert (desk.active.id, len(desk.all())) == ("0001", 2)
    assert "activate the one that is right" in str(desk.facts().trouble)
    (incident,) = incidents(tmp_path)
    assert "activations.json" in incident
    assert "activate the one that is right" in incident
    assert (tmp_path / incident.partition(":")[0] / "activations.json").read_bytes() == b"\xff{"
    await desk.act("0002", CalibrationAction.ACTIVATE)
    assert desk.facts().trouble is open_desk(tmp_path).facts().trouble is None
    assert open_desk(tmp_path).active.id == "0002"


async def test_when_none_in_use_can_be_read_the_configured_one_is_used(tmp_path: Path):
    calibrations, fewer = tmp_path / "calibrations", replace(CONFIGURED, cameras=CONFIGURED.cameras[:3])
    open_desk(tmp_path, fewer)
    open_desk(tmp_path)
    shutil.rmtree(calibrations / "0002")  # and the one before is of other cameras
    desk = open_desk(tmp_path)
    assert (desk.active.id, desk.rig_file.calibration_id) == ("0002", CONFIGURED.calibration_id)
    assert read_rig(desk.rig_file.path).calibration_id == CONFIGURED.calibration_id
    assert "no calibration that was in use can be read" in str(desk.facts().trouble)
    (calibrations / "0002/session.json").write_text("{")
    assert open_desk(tmp_path).active.id == "0003"


async def test_an_activation_ends_a_verification(tmp_path: Path):
    desk = open_desk(tmp_path)
    name = await accepted(desk)
    verification = await desk.verify(VerificationRequest(), ARMED)
    await desk.act(name, CalibrationAction.ACTIVATE)
    found = desk.verifications.find(verification.id)
    assert found is not None
    assert found.state is VerificationState.CANCELLED


@contextmanager
def snapshots_of(folder: Path, into: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Path]]:
    """Collect copies of a folder as a kill would leave it, one before each durable write."""
    taken: list[Path] = []
    sync = drivers.files.durable.sync

    def sync_and_copy(path: Path) -> None:
        taken.append(into / str(len(taken)))
        shutil.copytree(folder, taken[-1])
        sync(path)

    with monkeypatch.context() as patch:
        patch.setattr(drivers.files.durable, "sync", sync_and_copy)
        yield taken


async def test_a_kill_between_two_writes_leaves_the_old_or_the_new_one_active(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    state = tmp_path / "state"
    with snapshots_of(state, tmp_path / "killed", monkeypatch) as first:
        desk = open_desk(state)
    for left in first:
        assert open_desk(left).active.calibration_id == CONFIGURED.calibration_id
    with snapshots_of(state, tmp_path / "killed later", monkeypatch) as later:
        name = await accepted(desk)
        await desk.act(name, CalibrationAction.ACTIVATE)
    active = [open_desk(left).active.id for left in later]
    assert set(active) == {"0001", name}
    assert active == sorted(active)
