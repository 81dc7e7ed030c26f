"""Problems of a calibration, found before it is solved and after, each with the remedy.

A low residual is no evidence of accuracy: a wrong rig reproduces balls of a wrong diameter, or a few of them in a
thin column, perfectly. So the drops are judged first, then the solution against the rig's known design.
"""

from collections.abc import Iterator, Sequence

from pipeline.calibration import drop_checks, solution_checks
from pipeline.calibration.acceptance_limits import AcceptanceLimits
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.report import CalibrationReport
from pipeline.errors import CalibrationProblem
from pipeline.rig.cameras import RigCalibration


def diagnose_before(
    drops: Sequence[BallDrop], initial: RigCalibration, limits: AcceptanceLimits | None = None
) -> tuple[CalibrationProblem, ...]:
    """Return the problems of the drops, judged with the initial rig."""
    limits = limits or AcceptanceLimits()
    usable = [drop for drop in drops if len(drop.views) >= limits.min_views]
    if len(usable) < limits.min_drops:
        return (drop_checks.too_few_drops(usable, drops, limits),)
    order = tuple(drop_checks.order_problems(usable, initial, limits))
    if order:
        return order  # every other check would look at the wrong images
    return (
        *drop_checks.number_problems(usable, initial, limits),
        *drop_checks.size_problems(usable, initial, limits),
        *drop_checks.column_problems(usable, initial, limits),
    )


def diagnose_after(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits | None = None
) -> tuple[CalibrationProblem, ...]:
    """Return the problems of a solution.

    Large residuals do not make a result of the paper's method fatal: that method is kept to compare residuals with.
    """
    limits = limits or AcceptanceLimits()
    if causes := tuple(_causes(report, drops, limits)):
        return causes  # large residuals would only be a consequence
    return (
        *solution_checks.scale_problems(report, drops, limits),
        *solution_checks.left_out_problems(report, drops, limits),
        *solution_checks.moved_problems(report, limits),
        *solution_checks.focus_problems(report, limits),
        *solution_checks.residual_problems(report, limits),
        *solution_checks.uncertainty_problems(report, limits),
        *solution_checks.edge_problems(report, drops, limits),
    )


def _causes(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    yield from solution_checks.plausibility_problems(report)
    if report.rig.method != "paper":
        moved = tuple(solution_checks.step_problems(report, drops, limits))
        yield from moved or solution_checks.contradiction_problems(report, drops, limits)
