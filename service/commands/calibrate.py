"""`stonefall calibrate`: calibrate the rig from a recording of falling balls or stones."""

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table
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
from drivers.files.times import utc_now
from pipeline.calibration import BallDrop, CalibrationError, CalibrationReport, ScaleSource
from pipeline.calibration.coverage import Coverage, coverage
from pipeline.calibration.paper import observe_centroids
from pipeline.calibration.report import UnseenLenses
from pipeline.calibration.self_calibration import StoneCalibration
from pipeline.frames import BundleKind, FrameBundle
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.mask_segmenter import MaskSegmenter
from pipeline.segmentation.subtraction import BackgroundSegmenter
from service.base.errors import UsageError
from service.calibration.drops import observe_drop, solve_drops
from service.calibration.states import BALL_DIAMETERS_MM, Method
from service.commands.options import Json, with_options
from service.processing.models.networks import load_model

NO_SCALE = "scale: not observable; lengths are those of the initial rig"
UNSEEN_LENSES = {
    UnseenLenses.NO_WIDTHS: "unknown, since the widths of edges were not measured",
    UnseenLenses.STOPPED_DOWN: "stopped down: edges are as wide at all depths, aperture and focus do not show",
    UnseenLenses.LITTLE_DEPTH: "unknown, since the balls fell in too thin a layer to show aperture and focus",
}


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    recording: Annotated[Path, typer.Argument()]
    """Folder of the recording of ball drops."""
    initial: Path
    """Rig file to start from: the design, or an older calibration."""
    out: Path
    """Rig file to write; an older one is replaced."""
    ball_diameter_mm: list[float] | None = None
    """Known diameter of the ball, mm; give it twice for balls of two sizes. Without it lengths are only as accurate
    as those of the initial rig."""
    method: Method = Method.BUNDLE
    """bundle: bundle adjustment; paper: Algorithm 1 of the paper; stones: new poses for cameras that moved, from
    any stones."""
    model: str | None = None
    """With --method paper: U2-Net whose masks show the ball, by the name of a fetched model or the path of an ONNX
    file; without it drops are compared with the empty rig."""
    force: bool = False
    """Write the rig even if it should not be used."""
    workers: Annotated[int, typer.Option(min=1, max=256)] = os.cpu_count() or 1
    """Threads that observe drops."""
    as_json: Json = False
    """Print the whole report as JSON."""


@with_options
def command(options: CalibrateOptions) -> None:
    """Calibrate the rig from drops of a ball of known diameter; a solution that should not be used is refused.

    Drops are the recording's bundles of kind `ball`; if it has none, all that do not show the empty rig.
    """
    diameters_mm = _distinct_diameters_mm(options.ball_diameter_mm or [])
    if options.method is Method.STONES and diameters_mm:
        raise typer.BadParameter(
            "method stones cannot tell the scale; leave this option out", param_hint="--ball-diameter-mm"
        )
    if options.model is not None and options.method is not Method.PAPER:
        raise typer.BadParameter("only --method paper takes a network's masks", param_hint="--model")
    if options.out.is_dir():
        raise UsageError(f"--out {options.out} is a folder; name a file")
    threadpool_limits(1)  # on matrices as small as these, threads only wait for one another
    source = open_recording(options.recording)
    start = read_rig(options.initial)
    require_rig_of(source, start, options.initial)
    unreadable = [str(error) for error in source.unreadable]
    kind = BundleKind.PARTICLE if options.method is Method.STONES else BundleKind.BALL
    observe: Callable[[FrameBundle], BallDrop]
    if options.model is not None:
        observe = partial(observe_centroids, masks=MaskSegmenter(load_model(options.model)), diameter_mm=None)
    else:  # never the network, whose training an edge must not depend on: views without comparison are left out
        background = _learn_background(source, unreadable)
        observe = partial(observe_drop, background=background, segmenter=BackgroundSegmenter(), kind=kind)
    drops = _observed(source, _drop_headers(source, kind), observe, options.workers, unreadable)
    try:
        solved = solve_drops(
            drops,
            start,
            method=options.method,
            diameters_mm=diameters_mm,
            created_at=utc_now("seconds"),
            name=options.out.stem,
        )
    except CalibrationError as err:
        if options.as_json:
            refusal = {"is_acceptable": False, "problems": [asdict(each) for each in err.problems]}
            typer.echo(json.dumps(refusal, indent=2))
        raise
    used = set(solved.report["drops_used"])
    covered = coverage([drop for drop in drops if drop.name in used], solved.rig)
    if options.as_json:
        document = {**solved.report, "coverage": asdict(covered), "unreadable": unreadable}
        typer.echo(json.dumps(document, indent=2))
    elif isinstance(solved.evidence, StoneCalibration):
        _print_stone_report(solved.evidence, unreadable)
    else:
        report = solved.evidence
        _print(_table(report, covered), _lines(report, covered, unreadable))
    if solved.refusal is not None and not options.force:
        raise UsageError(f"{options.out} was not written: {solved.refusal} (--force writes it all the same)")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_rig(options.out, solved.rig)


def _distinct_diameters_mm(diameters_mm: Sequence[float]) -> list[float]:
    low_mm, high_mm = BALL_DIAMETERS_MM
    for diameter_mm in diameters_mm:
        if not low_mm <= diameter_mm <= high_mm:
            raise typer.BadParameter(
                f"{diameter_mm:g}: must be {low_mm:g} to {high_mm:g}", param_hint="--ball-diameter-mm"
            )
    distinct = sorted(set(diameters_mm))
    if len(distinct) > 2:
        raise typer.BadParameter("give one diameter, or two", param_hint="--ball-diameter-mm")
    return distinct


def _learn_background(source: Recording, unreadable: list[str]) -> BackgroundModel:
    """Learn the background from the exposures of the empty rig; damaged bundles are added to `unreadable`."""
    model: BackgroundModel = {}
    for header in playback_order(source):
        if header.kind is BundleKind.BACKGROUND:
            try:
                model = learn_background(model, read_bundle(header.path, source.camera_ids).frames)
            except RecordingError as err:
                unreadable.append(str(err))
    if not model:
        raise UsageError(
            f"{source.path} has no exposure of the empty rig, which drops are compared with: record some, "
            "or name the folders that show it with `stonefall import --background`"
        )
    return model


def _drop_headers(source: Recording, kind: BundleKind) -> list[BundleHeader]:
    """Return the bundles with drops: balls where wanted and the recording has some, else all but the empty rig."""
    fell = [header for header in playback_order(source) if header.kind is not BundleKind.BACKGROUND]
    balls = [header for header in fell if header.kind is BundleKind.BALL]
    return balls if balls and kind is BundleKind.BALL else fell


def _observed(
    source: Recording,
    headers: Sequence[BundleHeader],
    observe: Callable[[FrameBundle], BallDrop],
    workers: int,
    unreadable: list[str],
) -> list[BallDrop]:
    """Observe the drops in the bundles, in their order; damaged bundles are added to `unreadable`."""

    def read(header: BundleHeader) -> BallDrop | RecordingError:
        try:
            bundle = read_bundle(header.path, source.camera_ids)
        except RecordingError as err:
            return err
        return observe(bundle)

    # threads: nearly all time is spent in OpenCV and NumPy, which release the GIL
    with ThreadPoolExecutor(workers) as pool:
        console = Console(file=sys.stderr)
        found = list(track(pool.map(read, headers), "observing", total=len(headers), console=console))
    unreadable += [str(each) for each in found if isinstance(each, RecordingError)]
    return [each for each in found if not isinstance(each, RecordingError)]


def _print_stone_report(found: StoneCalibration, unreadable: Sequence[str]) -> None:
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
            NO_SCALE,
            f"calibration: {found.rig.calibration_id}",
        ),
    )


def _print(table: Table, lines: Iterable[str]) -> None:
    console = Console()
    console.print(table)
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _table(report: CalibrationReport, covered: Coverage) -> Table:
    figures = ("drops", "field %", "before px", "after px", "f px", "focus mm")
    table = Table("camera", *(Column(title, justify="right") for title in figures), "left out")
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
    yield "scale: from the diameter of the ball" if report.scale is ScaleSource.BALL_DIAMETER else NO_SCALE
    if report.uncertainty is not None:
        yield f"length in the measuring volume: +- {report.uncertainty.length_sd_percent:.3f} % (1 sd)"
    if isinstance(report.lenses, UnseenLenses):
        yield f"lenses: {UNSEEN_LENSES[report.lenses]}"
    elif report.lenses is not None:
        f_number, sigma_px = report.lenses.f_number, report.lenses.blur_px.value
        yield (
            f"lenses of {report.lenses.focal_length_mm:g} mm: F{f_number.value:.2f} +- {f_number.sd:.2f} (1 sd), "
            f"edges in focus {sigma_px:.2f} px wide (sigma)"
        )
    if report.edge_offset_px is not None:
        side = "large" if report.edge_offset_px > 0 else "small"
        yield f"outlines are {abs(report.edge_offset_px):.3f} px too {side}, as balls of two sizes show"
    if report.fall is not None:
        tilt_deg = np.rad2deg(np.arccos(-report.fall.direction[2]))
        yield f"fall: {tilt_deg:.2f} +- {report.fall.sd_deg:.2f} degrees off the initial vertical; corrected"
    for problem in report.problems:
        yield f"{'refused' if problem.is_fatal else 'warning'}: {problem.detail}"
    yield f"calibration: {report.rig.calibration_id}"


def _fixed(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
