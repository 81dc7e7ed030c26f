"""Solve a calibration from its drops so far, in a process of its own."""

import asyncio
from collections.abc import Awaitable, Callable

from drivers.files.times import utc_now
from service.calibration.drop_files import outline_paths
from service.calibration.drop_jobs import Solved, SolveJob, solve
from service.calibration.files import CalibrationFiles, CalibrationRecord
from service.calibration.plan import Method
from service.processing.measure_job import RigFile, lower_priority
from service.processing.worker_pool import JobLostError, WorkerPool, WorkerStartError

SOLVE_DEADLINE_S = 300.0
"""The paper's method takes half a minute of one core."""

Solver = Callable[[SolveJob], Awaitable[Solved]]


async def solve_apart(job: SolveJob) -> Solved:
    """Run the job in a process of its own; raise `JobLostError` or `WorkerStartError` when that fails."""
    async with WorkerPool(
        slots=1, deadline_s=SOLVE_DEADLINE_S, prepare=lower_priority, context=None
    ) as pool:  # bundles do not wait for it
        return await pool.run(solve, job)


async def solve_calibration(
    files: CalibrationFiles, record: CalibrationRecord, initial: RigFile, rig_name: str, solver: Solver
) -> tuple[str | None, str | None]:
    """Return the id of the solved rig, and why it must not be used or why there is none."""
    paths = await asyncio.to_thread(outline_paths, files.drops(record.id))
    job = SolveJob(
        outline_paths=tuple(paths),
        initial_path=initial.path,
        diameters_mm=record.ball_diameters_mm,
        method=Method(record.method),  # as it was planned
        name=rig_name,
        created_at=utc_now(),
        folder=files.folder / record.id,
    )
    try:
        solution = await solver(job)
    except (JobLostError, WorkerStartError) as err:
        return None, f"the solution could not be computed: {err}"
    return solution.calibration_id, solution.refusal
