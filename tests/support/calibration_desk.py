"""Calibrations in a folder of a test, with a solver that returns what the test wants."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from support.eventually import PATIENCE_S
from support.recordings import small_rig

from drivers.files.durable import write_json
from drivers.files.rig_file import write_rig
from pipeline.calibration import CalibrationProblem
from pipeline.rig.cameras import RigCalibration
from service.base.status import AcquisitionState
from service.calibration.calibrations import Calibrations
from service.calibration.drop_files import ObservedDrop, SeenCircle
from service.calibration.drops import Solved, SolveJob, refusal_of
from service.calibration.files import Activation
from service.calibration.startup import load_calibrations
from service.calibration.states import CalibrationAction, CalibrationRequest, CalibrationState
from service.calibration.verification_limits import VerificationParameters
from service.calibration.verifications import Verifications

CONFIGURED = small_rig()
ARMED = AcquisitionState.ARMED
BALL = CalibrationRequest(ball_diameters_mm=(10.0,), by="an engineer")


def other_rig(name: str = "another") -> RigCalibration:
    return replace(CONFIGURED, name=name, method="bundle")


@dataclass
class MadeUpSolver:
    """Solver that returns the rig, or the problems, that a test wants."""

    rig: RigCalibration | None = field(default_factory=other_rig)
    problems: tuple[CalibrationProblem, ...] = ()
    failure: Exception | None = None
    jobs: list[SolveJob] = field(default_factory=list)

    async def __call__(self, job: SolveJob) -> Solved:
        await asyncio.sleep(0)
        self.jobs.append(job)
        if self.failure is not None:
            raise self.failure
        if self.rig is None:
            return Solved(calibration_id=None, refusal=refusal_of(self.problems))
        write_rig(job.folder / "rig.json", self.rig)
        write_json(job.folder / "report.json", {"residuals_after_px": {}, "rig": {}})
        return Solved(calibration_id=self.rig.calibration_id, refusal=refusal_of(self.problems))


def open_desk(
    folder: Path,
    configured: RigCalibration = CONFIGURED,
    solver: MadeUpSolver | None = None,
    parameters: VerificationParameters | None = None,
    on_activated: Callable[[RigCalibration, Activation], Awaitable[None]] | None = None,
) -> Calibrations:
    """Open the calibrations of a folder as the daemon does when it starts."""
    found = load_calibrations(folder / "calibrations", configured)
    verifications = Verifications(folder / "verifications", parameters or VerificationParameters())

    async def nothing(rig: RigCalibration, activation: Activation) -> None:
        pass

    return Calibrations(
        found, verifications, on_activated=on_activated or nothing, solver=solver or MadeUpSolver()
    )


def a_drop(name: str = "000001-ball") -> ObservedDrop:
    camera = CONFIGURED.camera_ids[0]
    return ObservedDrop(
        bundle=name,
        diameter_mm=10.0,
        views={camera: SeenCircle(center_uv=(30.0, 20.0), radius_px=5.0)},
        residuals_px={camera: 2.0},
        vertical_minus_horizontal_mm=0.01,
    )


def state_of(desk: Calibrations, name: str) -> CalibrationState:
    return next(record.state for record in desk.all() if record.id == name)


async def solved(desk: Calibrations) -> str:
    """Open and solve a calibration; return its name."""
    record = await desk.start(BALL, ARMED)
    await solve(desk, record.id)
    return record.id


async def solve(desk: Calibrations, name: str) -> None:
    await desk.act(name, CalibrationAction.SOLVE)
    await until(desk, lambda: state_of(desk, name) is not CalibrationState.SOLVING)


async def until(desk: Calibrations, is_so: Callable[[], bool]) -> None:
    """Run the task of the calibrations until a condition holds."""
    task = asyncio.create_task(desk.run())
    async with asyncio.timeout(PATIENCE_S):
        while not is_so():  # noqa: ASYNC110 - nobody signals it
            await asyncio.sleep(0.001)
    task.cancel()
    await asyncio.wait([task])


async def accepted(desk: Calibrations) -> str:
    name = await solved(desk)
    await desk.act(name, CalibrationAction.ACCEPT)
    return name
