"""The printed report of a calibration: a table of the cameras, and a line for each further finding."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from pipeline.calibration import CalibrationProblem, CalibrationReport, ScaleSource
from pipeline.calibration.coverage import Coverage
from pipeline.calibration.report import FoundLenses, UnseenLenses
from pipeline.calibration.self_calibration import StoneCalibration

UNSEEN_LENSES = {
    UnseenLenses.NO_WIDTHS: "unknown, since the widths of edges were not measured",
    UnseenLenses.STOPPED_DOWN: "stopped down: edges are as wide at all depths, aperture and focus do not show",
    UnseenLenses.LITTLE_DEPTH: "unknown, since the balls fell in too thin a layer to show aperture and focus",
}


def print_ball_report(report: CalibrationReport, covered: Coverage, unreadable: Sequence[str]) -> None:
    """Print a calibration from balls, and the coverage of its drops."""
    _print(_table(report, covered), _lines(report, covered, unreadable))


def print_stone_report(found: StoneCalibration, unreadable: Sequence[str]) -> None:
    """Print which cameras were given new poses from stones."""
    table = Table("camera", "before px", "after px", "turned °", "shifted mm")
    for camera in found.rig.camera_ids:
        movement = found.moved.get(camera)
        table.add_row(
            camera,
            _fixed(found.scores_before_px.get(camera), 2),
            _fixed(found.scores_after_px.get(camera), 2),
            "" if movement is None else f"{movement.rotation_deg:.3f}",
            "" if movement is None else f"{movement.shift_mm:.3f}",
        )
    _print(
        table,
        (
            *(f"unreadable: {each}" for each in unreadable),
            f"from {found.n_fitted} stones, judged by {found.n_judges} others",
            "scale: not observable; lengths are those of the initial rig",
            f"calibration: {found.rig.calibration_id}",
        ),
    )


def _print(table: Table, lines: Iterable[str]) -> None:
    console = Console()
    console.print(table)
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _table(report: CalibrationReport, covered: Coverage) -> Table:
    table = Table("camera")
    for title in ("drops", "field %", "before px", "after px", "f px", "focus mm"):
        table.add_column(title, justify="right")
    table.add_column("left out")
    for camera in report.rig.cameras:
        refused = Counter(
            views[camera.id].partition(":")[0]
            for views in report.views_left_out.values()
            if camera.id in views
        )
        table.add_row(
            camera.id,
            str(covered.cameras[camera.id].n_drops),
            f"{100 * covered.cameras[camera.id].field_share:.0f}",
            _fixed(report.residuals_before_px.get(camera.id), 1),
            _fixed(report.residuals_after_px.get(camera.id), 3),
            f"{camera.focal_px:.1f}",
            _fixed(camera.lens.focus_mm if camera.lens else None, 1),
            ", ".join(f"{n} x {reason}" for reason, n in refused.most_common()),
        )
    return table


def _lines(report: CalibrationReport, covered: Coverage, unreadable: Sequence[str]) -> Iterator[str]:
    yield from (f"unreadable: {each}" for each in unreadable)
    yield from (f"left out: {name}: {reason}" for name, reason in report.drops_left_out.items())
    extent = " x ".join(f"{each:.1f}" for each in covered.extent_mm)
    yield f"drops: {len(report.drops_used)} across {extent} mm; missing: {covered.missing or 'nothing'}"
    if report.held_out_px is not None:
        yield f"drops not used in the fit: {report.held_out_px:.3f} px rms"
    if report.scale is ScaleSource.BALL_DIAMETER:
        yield "scale: from the diameter of the ball"
    else:
        yield "scale: not observable; lengths are those of the initial rig"
    if report.uncertainty is not None:
        yield f"length in the measuring volume: +- {report.uncertainty.length_sd_percent:.3f} % (1 sd)"
    if report.lenses is not None:
        yield _lens_line(report.lenses)
    if report.edge_offset_px is not None:
        side = "large" if report.edge_offset_px > 0 else "small"
        yield f"outlines are {abs(report.edge_offset_px):.3f} px too {side}, as balls of two sizes show"
    if report.fall is not None:
        tilt_deg = np.rad2deg(np.arccos(-report.fall.direction[2]))
        yield f"fall: {tilt_deg:.2f} +- {report.fall.sd_deg:.2f} degrees off the initial vertical; corrected"
    yield from (_problem_line(problem) for problem in report.problems)
    yield f"calibration: {report.rig.calibration_id}"


def _lens_line(lenses: FoundLenses | UnseenLenses) -> str:
    if isinstance(lenses, UnseenLenses):
        return f"lenses: {UNSEEN_LENSES[lenses]}"
    f_number, sigma_px = lenses.f_number, lenses.blur_px.value
    return (
        f"lenses of {lenses.focal_length_mm:g} mm: F{f_number.value:.2f} +- {f_number.sd:.2f} (1 sd), "
        f"edges in focus {sigma_px:.2f} px wide (sigma)"
    )


def _problem_line(problem: CalibrationProblem) -> str:
    return f"{'refused' if problem.is_fatal else 'warning'}: {problem.detail}"


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
