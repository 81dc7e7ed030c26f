"""`stonefall calibrate`: the rig's geometry from a recording of balls that fell through it."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from drivers.errors import RecordingError
from drivers.files.recording import (
    BundleHeader,
    Recording,
    open_recording,
    playback_order,
    read_bundle,
    require_rig_of,
)
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import (
    BallDrop,
    CalibrationError,
    CalibrationReport,
    Problem,
    ScaleSource,
    calibrate,
    observe_ball,
    report_document,
)
from pipeline.calibration.ball_sizes import with_diameters
from pipeline.calibration.coverage import Coverage, coverage
from pipeline.frames import BundleKind, FrameBundle
from pipeline.segmentation import BackgroundModel, segment_all
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.views.epipolar_tangency import Outlines, outlines_of
from service.calibration.plan import BALL_DIAMETERS_MM
from service.commands.calibrate_stones import calibrate_from_stones
from service.errors import UsageError

Seen = TypeVar("Seen")


class Method(StrEnum):
    """How the drops become a rig."""

    BUNDLE = "bundle"
    PAPER = "paper"
    STONES = "stones"


def command(
    recording: Annotated[Path, typer.Argument(help="Folder of the recording of ball drops.")],
    initial: Annotated[
        Path, typer.Option(help="Rig file to start from: the design, or an older calibration.")
    ],
    out: Annotated[Path, typer.Option(help="Rig file to write; an older one is replaced.")],
    ball_diameter_mm: Annotated[
        list[float] | None,
        typer.Option(
            help="Known diameter of the ball; twice for balls of two sizes. Without it lengths are only as good as "
            "the initial rig's."
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(
            help="paper is the Algorithm 1 of the paper; stones puts cameras that moved back, from any stones."
        ),
    ] = Method.BUNDLE,
    force: Annotated[
        bool, typer.Option("--force", help="Write the rig even if it should not be used.")
    ] = False,
    workers: Annotated[int, typer.Option(min=1, max=256)] = os.cpu_count() or 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole report as JSON.")] = False,
) -> None:
    """Calibrate a rig from the drops of a ball of known diameter; refuses what should not be used.

    Drops are the recording's bundles of kind `ball`; if it has none, all that do not show the empty rig.
    """
    diameters_mm = _distinct_diameters_mm(ball_diameter_mm or [])
    if method is Method.STONES and diameters_mm:
        raise typer.BadParameter(
            "stones do not show the scale; leave it out", param_hint="--ball-diameter-mm"
        )
    if out.is_dir():
        raise UsageError(f"--out {out} is a folder; name a rig file")
    threadpool_limits(1)  # many threads on matrices as small as these only wait for one another
    source = open_recording(recording)
    start = read_rig(initial)
    require_rig_of(source, start, initial)
    unreadable = [str(error) for error in source.unreadable]
    # never the network: a view that cannot be compared with the empty rig is better left out of a calibration
    background, segmenter = _learn_background(source, unreadable), BackgroundSegmenter()
    if method is Method.STONES:

        def outlines(bundle: FrameBundle) -> Outlines:
            return outlines_of(segment_all(bundle.frames, background, segmenter))

        stones = _observed(source, _fallen(source), outlines, workers, unreadable)
        calibrate_from_stones(stones, unreadable, start, out, force=force, as_json=as_json)
        return

    def ball(bundle: FrameBundle) -> BallDrop:
        return observe_ball(bundle, background, segmenter, None)

    drops = _observed(source, _balls(source), ball, workers, unreadable)
    try:
        report = calibrate(
            with_diameters(drops, start, diameters_mm),
            start,
            method="paper" if method is Method.PAPER else "bundle",
            created_at=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
            name=out.stem,
        )
    except CalibrationError as err:
        if as_json:
            refusal = {"is_acceptable": False, "problems": [asdict(each) for each in err.problems]}
            typer.echo(json.dumps(refusal, indent=2))
        raise
    covered = coverage([drop for drop in drops if drop.name in report.drops_used], report.rig)
    if as_json:
        document = report_document(report) | {"coverage": asdict(covered), "unreadable": unreadable}
        typer.echo(json.dumps(document, indent=2))
    else:
        _print_report(report, covered, unreadable)
    if not (report.is_acceptable or force):
        reasons = "; ".join(problem.detail for problem in report.problems if problem.is_fatal)
        raise UsageError(f"{out} was not written: {reasons} (--force writes it nevertheless)")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_rig(out, report.rig)


def _distinct_diameters_mm(diameters_mm: Sequence[float]) -> list[float]:
    low_mm, high_mm = BALL_DIAMETERS_MM
    for diameter_mm in diameters_mm:
        if not low_mm <= diameter_mm <= high_mm:
            raise typer.BadParameter(
                f"{diameter_mm:g}: must be {low_mm:g} to {high_mm:g}", param_hint="--ball-diameter-mm"
            )
    distinct = sorted(set(diameters_mm))
    if len(distinct) > 2:
        raise typer.BadParameter("at most two diameters", param_hint="--ball-diameter-mm")
    return distinct


def _learn_background(source: Recording, unreadable: list[str]) -> BackgroundModel:
    """What the cameras see of the empty rig; damaged bundles go to `unreadable`."""
    model: BackgroundModel = {}
    for header in playback_order(source):
        if header.kind is BundleKind.BACKGROUND:
            try:
                model = learn_background(model, read_bundle(header.path, source.camera_ids).frames)
            except RecordingError as err:
                unreadable.append(str(err))
    if not model:
        raise UsageError(
            f"{source.path} has no exposure of the empty rig, from which the balls are told: record some first, "
            "or name the folders that show it with `stonefall import --background`"
        )
    return model


def _balls(source: Recording) -> list[BundleHeader]:
    """The drops of the calibration ball; all that fell if the recording names none."""
    fell = _fallen(source)
    return [header for header in fell if header.kind is BundleKind.BALL] or fell


def _fallen(source: Recording) -> list[BundleHeader]:
    return [header for header in playback_order(source) if header.kind is not BundleKind.BACKGROUND]


def _observed(
    source: Recording,
    headers: Sequence[BundleHeader],
    look: Callable[[FrameBundle], Seen],
    workers: int,
    unreadable: list[str],
) -> list[Seen]:
    """What `look` sees in the bundles, in their order whatever the number of workers.

    Damaged bundles go to `unreadable`.
    """

    def observe(header: BundleHeader) -> Seen | RecordingError:
        try:
            bundle = read_bundle(header.path, source.camera_ids)
        except RecordingError as err:
            return err
        return look(bundle)

    # threads: nearly all of it is spent in OpenCV and NumPy, which let others run
    with ThreadPoolExecutor(workers) as pool:
        seen = pool.map(observe, headers)
        console = Console(file=sys.stderr)
        observed = list(track(seen, "observing", total=len(headers), console=console))
    unreadable += [str(each) for each in observed if isinstance(each, RecordingError)]
    return [each for each in observed if not isinstance(each, RecordingError)]


# --- what people read ---


def _print_report(report: CalibrationReport, covered: Coverage, unreadable: Sequence[str]) -> None:
    console = Console()
    console.print(_table(report, covered))
    for line in _lines(report, covered, unreadable):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _table(report: CalibrationReport, covered: Coverage) -> Table:
    table = Table("camera")
    for title in ("drops", "field %", "before px", "after px", "f px"):
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
            ", ".join(f"{n} x {reason}" for reason, n in refused.most_common()),
        )
    return table


def _lines(report: CalibrationReport, covered: Coverage, unreadable: Sequence[str]) -> Iterator[str]:
    yield from (f"unreadable: {each}" for each in unreadable)
    yield from (f"left out: {name}: {reason}" for name, reason in report.drops_left_out.items())
    extent = " x ".join(f"{each:.1f}" for each in covered.extent_mm)
    yield f"drops: {len(report.drops_used)} across {extent} mm; wanted: {covered.missing or 'nothing'}"
    if report.held_out_px is not None:
        yield f"drops not used in the fit: {report.held_out_px:.3f} px rms"
    if report.scale is ScaleSource.BALL_DIAMETER:
        yield "scale: from the diameter of the ball"
    else:
        yield "scale: not observable; lengths are those of the initial rig"
    if report.uncertainty is not None:
        yield f"length in the measuring volume: +- {report.uncertainty.length_sd_percent:.3f} % (1 sd)"
    if report.edge_offset_px is not None:
        side = "large" if report.edge_offset_px > 0 else "small"
        yield f"outlines are {abs(report.edge_offset_px):.3f} px too {side}, as balls of two sizes show"
    if report.fall is not None:
        tilt_deg = np.rad2deg(np.arccos(-report.fall.direction[2]))
        yield f"fall: {tilt_deg:.2f} +- {report.fall.sd_deg:.2f} degrees off the initial vertical; corrected"
    yield from (_problem_line(problem) for problem in report.problems)
    yield f"calibration: {report.rig.calibration_id}"


def _problem_line(problem: Problem) -> str:
    return f"{'refused' if problem.is_fatal else 'warning'}: {problem.detail}"


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
