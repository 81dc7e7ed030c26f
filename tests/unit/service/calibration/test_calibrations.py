"""Calibrations without cameras: transitions, drops, solution, restart."""

import errno
import time
from pathlib import Path

import pytest
from pydantic import TypeAdapter
from support.calibration_desk import (
    ARMED,
    BALL,
    CONFIGURED,
    MadeUpSolver,
    a_drop,
    accepted,
    open_desk,
    other_rig,
    solve,
    solved,
    state_of,
    until,
)

from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import CalibrationProblem
from pipeline.frames import BundleKind
from service.base.errors import StoreError
from service.base.messages import Code
from service.base.status import AcquisitionState
from service.calibration import calibrations
from service.calibration.files import CalibrationFiles, CalibrationRecord
from service.calibration.states import (
    OPEN,
    TRANSITIONS,
    CalibrationAction,
    CalibrationConflictError,
    CalibrationRequest,
    CalibrationState,
    Method,
    next_state,
)
from service.calibration.verifications import VerificationRequest
from service.processing.worker_slot import JobLostError


def test_every_open_calibration_can_be_cancelled_and_requests_can_be_repeated():
    for state in CalibrationState:
        assert (state in OPEN) == (state in TRANSITIONS[CalibrationAction.CANCEL][0])
    for action, (_, following) in TRANSITIONS.items():
        assert next_state("0002", following, action) is following
    for state in CalibrationState:
        for action in CalibrationAction:
            before, following = TRANSITIONS[action]
            if state not in (*before, following):
                with pytest.raises(CalibrationConflictError, match=f"0002 is {state}: {action}"):
                    next_state("0002", state, action)


@pytest.mark.parametrize(
    ("diameters_mm", "method"),
    [
        ((), Method.BUNDLE),
        ((10.0, 11.0), Method.BUNDLE),
        ((10.0, 15.0, 20.0), Method.PAPER),
        ((0.1,), Method.BUNDLE),
        ((10.0,), Method.STONES),
    ],
)
def test_a_plan_that_cannot_work_is_refused(diameters_mm, method):
    with pytest.raises(ValueError, match="ball_diameters_mm"):
        TypeAdapter(CalibrationRequest).validate_python({"ball_diameters_mm": diameters_mm, "method": method})


async def test_from_the_first_drop_to_the_roll_back(tmp_path: Path):
    told = []
    solver = MadeUpSolver()

    async def on_activated(rig, activation):
        told.append(rig.name)

    desk = open_desk(tmp_path, solver=solver, on_activated=on_activated)
    record = await desk.start(BALL, ARMED)
    assert desk.wants_balls
    assert desk.facts().at_work == "calibration 0002 is collecting: what falls is a ball"
    assert desk.collector is not None
    await desk.collector.add(a_drop(), {}, None)
    details = await desk.find(record.id)
    assert details is not None
    assert [drop.bundle for drop in details.drops] == ["000001-ball"]
    assert details.residuals_before_px == {"c01": 2.0}
    assert details.coverage.cameras[CONFIGURED.camera_ids[0]].n_drops == 1
    await solve(desk, record.id)
    assert solver.jobs[0].initial_path == desk.rig_file.path
    before = desk.rig_file
    await desk.act(record.id, CalibrationAction.ACCEPT, "the boss")
    assert desk.rig_file == before
    assert not desk.wants_balls
    await desk.act(record.id, CalibrationAction.ACTIVATE, "an engineer")
    assert (
        desk.rig_file.calibration_id
        == read_rig(desk.rig_file.path).calibration_id
        == other_rig().calibration_id
    )
    assert (desk.activated.id, desk.activated.by) == ("0002", "an engineer")
    assert (desk.active.by, desk.active.decided_by) == ("an engineer", "the boss")
    assert open_desk(tmp_path).rig_file == desk.rig_file
    await desk.act("0001", CalibrationAction.ACTIVATE)
    assert desk.rig_file == open_desk(tmp_path).rig_file == before
    assert told == ["another", "small"]


async def test_only_one_calibration_or_verification_is_open(tmp_path: Path):
    desk = open_desk(tmp_path)
    version = await accepted(desk)
    for state in (AcquisitionState.HELD, AcquisitionState.STOPPING):
        with pytest.raises(CalibrationConflictError, match=f"acquisition is {state}"):
            await desk.start(BALL, state)
    await desk.start(BALL, ARMED)
    with pytest.raises(
        CalibrationConflictError, match="0003 is collecting: accept, reject or cancel it first"
    ):
        await desk.start(BALL, ARMED)
    with pytest.raises(
        CalibrationConflictError, match="0003 is collecting: accept, reject or cancel it first"
    ):
        await desk.verify(VerificationRequest(), ARMED)
    with pytest.raises(CalibrationConflictError, match="0003 is collecting and starts from 0001"):
        await desk.act(version, CalibrationAction.ACTIVATE)
    await desk.act("0003", CalibrationAction.CANCEL)
    await desk.verify(VerificationRequest(), ARMED)
    with pytest.raises(CalibrationConflictError, match="verification 0001 waits"):
        await desk.start(BALL, ARMED)


async def test_while_stones_calibrate_they_count_as_stones(tmp_path: Path):
    desk = open_desk(tmp_path)
    await desk.start(CalibrationRequest(method=Method.STONES), ARMED)
    assert desk.collector is not None
    assert desk.collector.kind is BundleKind.PARTICLE
    assert not desk.wants_balls


async def test_what_must_not_be_used_is_not_accepted(tmp_path: Path):
    problem = CalibrationProblem(code="wrong_diameter", detail="the ball is too small")
    solver = MadeUpSolver(problems=(problem,))
    desk = open_desk(tmp_path, solver=solver)
    name = await solved(desk)
    with pytest.raises(CalibrationConflictError, match="must not be used: the ball is too small"):
        await desk.act(name, CalibrationAction.ACCEPT)
    solver.problems = ()
    await solve(desk, name)  # more drops, another try
    await desk.act(name, CalibrationAction.ACCEPT)


@pytest.mark.parametrize(
    ("solver", "code"),
    [
        (
            MadeUpSolver(rig=None, problems=(CalibrationProblem(code="too_few", detail="too few drops"),)),
            Code.CALIBRATION_PROBLEM,
        ),
        (MadeUpSolver(failure=JobLostError("deadline", "too few drops")), Code.CALIBRATION_NOT_COMPUTED),
    ],
)
async def test_what_cannot_be_solved_goes_on_collecting(tmp_path: Path, solver: MadeUpSolver, code: Code):
    desk = open_desk(tmp_path, solver=solver)
    name = await solved(desk)
    details = await desk.find(name)
    assert details is not None
    assert details.state is CalibrationState.COLLECTING
    assert "too few drops" in str(details.detail)
    assert [each.code for each in details.findings] == [code]
    assert desk.wants_balls


async def test_a_solution_that_cannot_be_written_goes_on_collecting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    full = OSError(errno.ENOSPC, "No space left on device")
    solver = MadeUpSolver(failure=full)
    desk = open_desk(tmp_path, solver=solver)
    name = await solved(desk)
    assert state_of(desk, name) is CalibrationState.COLLECTING
    assert desk.all()[0].detail == "the solution cannot be written: No space left on device"
    solver.failure = None
    await desk.act(name, CalibrationAction.SOLVE)

    def write(files: CalibrationFiles, record: CalibrationRecord) -> None:
        raise full

    with monkeypatch.context() as patch:
        patch.setattr(CalibrationFiles, "write", write)
        await until(desk, lambda: state_of(desk, name) is not CalibrationState.SOLVING)
    assert state_of(desk, name) is CalibrationState.COLLECTING
    await solve(desk, name)
    assert state_of(desk, name) is CalibrationState.SOLVED


async def test_a_calibration_that_was_cancelled_before_it_was_solved_stays_so(tmp_path: Path):
    solver = MadeUpSolver()
    desk = open_desk(tmp_path, solver=solver)
    record = await desk.start(BALL, ARMED)
    await desk.act(record.id, CalibrationAction.SOLVE)
    await desk.act(record.id, CalibrationAction.CANCEL)
    following = await desk.start(BALL, ARMED)
    await solve(desk, following.id)  # after the one before
    assert state_of(desk, record.id) is CalibrationState.CANCELLED
    assert len(solver.jobs) == 1


async def test_an_open_calibration_survives_a_restart_without_its_unfinished_solution(tmp_path: Path):
    desk = open_desk(tmp_path)
    record = await desk.start(BALL, ARMED)
    assert desk.collector is not None
    await desk.collector.add(a_drop(), {}, None)
    await desk.act(record.id, CalibrationAction.SOLVE)
    again = open_desk(tmp_path)
    details = await again.find(record.id)
    assert details is not None
    assert (details.state, len(details.drops)) == (CalibrationState.COLLECTING, 1)
    await solve(again, record.id)
    assert state_of(open_desk(tmp_path), record.id) is CalibrationState.SOLVED
    report = tmp_path / "calibrations" / record.id / "report.json"
    report.write_text("{")
    again = open_desk(tmp_path)
    details = await again.find(record.id)
    assert details is not None
    assert (details.state, details.calibration_id) == (CalibrationState.COLLECTING, None)
    await solve(again, record.id)
    write_rig(tmp_path / "calibrations" / record.id / "rig.json", other_rig("not what was solved"))
    again = open_desk(tmp_path)
    assert state_of(again, record.id) is CalibrationState.COLLECTING
    assert await again.find(record.id) is not None
    changed = open_desk(tmp_path, other_rig())  # what its drops were compared with is not in use any more
    assert state_of(changed, record.id) is CalibrationState.CANCELLED


async def test_an_idle_calibration_is_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    desk = open_desk(tmp_path)
    await desk.start(BALL, ARMED)
    monkeypatch.setattr(calibrations, "IDLE_CHECK_S", 0.001)
    start_s = time.monotonic()
    await until(desk, lambda: time.monotonic() - start_s > 0.02)
    assert desk.wants_balls
    monkeypatch.setattr(calibrations, "IDLE_S", 0.0)
    await until(desk, lambda: not desk.wants_balls)
    assert "nothing fell" in str(open_desk(tmp_path).all()[0].detail)


async def test_a_damaged_drop_is_a_fault_of_the_store(tmp_path: Path):
    desk = open_desk(tmp_path)
    record = await desk.start(BALL, ARMED)
    (tmp_path / "calibrations" / record.id / "drops/00001.json").write_text('{"views": 3}')
    with pytest.raises(StoreError, match=r"00001\.json"):
        await desk.find(record.id)
