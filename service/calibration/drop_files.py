"""The drops of a calibration on disk, and the details of a calibration that they make up.

`<number>.npz` holds the outlines, `<number>.json` the figures that are shown. The second is written last: a drop
without it does not count.
"""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import numpy as np
from pydantic import PlainSerializer

from drivers.files.durable import replacing, write_json
from pipeline.calibration import BallDrop, BallView
from pipeline.calibration.coverage import Coverage, coverage
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base.schema import served
from service.calibration.files import CalibrationFiles, CalibrationSummary, fields_of, read_document

HEADER = "header.json"
"""Name of the array that is no camera's; a camera id has no dot."""


AS_NAMES = PlainSerializer(list, return_type=list[str])
"""Over REST a mapping from cameras is the list of their names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenCircle:
    """Approximate place and size of a drop in one view."""

    center_uv: tuple[float, float]
    radius_px: float


@served
class ObservedDrop:
    """One ball or stone that was observed."""

    bundle: str
    """Name of the bundle of images."""
    diameter_mm: float | None = None
    """Requested diameter that is closest to its apparent size, mm; null: a stone, or too few views."""
    views: Annotated[Mapping[CameraId, SeenCircle], AS_NAMES] = field(default_factory=dict)
    """Cameras whose image shows it whole."""
    refused: Mapping[CameraId, str] = field(default_factory=dict)
    """Cameras left out, each with the reason."""
    center_mm: tuple[float, float, float] | None = None
    """Centre of the ball in the frame of the rig, mm; null when it was not located."""
    residuals_px: Mapping[CameraId, float] = field(default_factory=dict)
    """Per camera, px, with the calibration in use when it fell: centre of the ball against its position from
    all views; of a stone the median epipolar residual."""
    vertical_minus_horizontal_mm: float | None = None
    """Vertical minus horizontal diameter of a ball, mm; null: unknown, or a stone."""
    problem: str | None = None
    """Why nothing was observed; null otherwise."""


def _without_outlines(drop: ObservedDrop) -> BallDrop:
    """Return the drop with centres and radii only, which is enough to judge the coverage."""
    none_uv = np.empty((0, 2))
    views = {
        camera: BallView(
            outline_uv=none_uv, center_uv=np.array(seen.center_uv), radius_px=seen.radius_px, rms_px=0.0
        )
        for camera, seen in drop.views.items()
    }
    return BallDrop(name=drop.bundle, diameter_mm=drop.diameter_mm, views=views)


@served
class CalibrationDocument(CalibrationSummary):
    """One calibration with its drops and its report."""

    drops: Sequence[ObservedDrop]
    """In the order in which they fell."""
    coverage: Coverage
    """How well the drops so far cover volume and images."""
    residuals_before_px: Mapping[CameraId, float]
    """Per camera, rms over the drops so far, with the calibration in use when they fell, px."""
    report: Mapping[str, Any] | None
    """Result of the solution: residuals before and after (px), drops and views left out, centres of the balls (mm),
    f-number and focus of the lenses (mm) or why they do not show, uncertainty, problems; null before it is solved."""


def calibration_document(
    files: CalibrationFiles, summary: CalibrationSummary, rig_in_use: RigCalibration
) -> CalibrationDocument:
    """Read the drops and the report of a calibration, or raise `RecordingError`.

    Without a solution the rig in use judges the coverage.
    """
    drops = kept_drops(files.drops(summary.id))
    is_solved = summary.calibration_id is not None
    squares: dict[CameraId, list[float]] = {}
    for drop in drops:
        for camera, residual_px in drop.residuals_px.items():
            squares.setdefault(camera, []).append(residual_px**2)
    rig = files.rig(summary) if is_solved else rig_in_use
    report = (files.report(summary) if is_solved else None) or {}
    return CalibrationDocument(
        **fields_of(summary),
        drops=drops,
        coverage=coverage([_without_outlines(drop) for drop in drops], rig),
        residuals_before_px={camera: fmean(squares[camera]) ** 0.5 for camera in sorted(squares)},
        report={name: value for name, value in report.items() if name != "rig"} or None,
    )


def write_drop(path: Path, drop: BallDrop) -> None:
    """Write a drop with its outlines to an npz file."""
    header = asdict(drop)
    arrays: dict[str, Any] = {camera: view.pop("outline_uv") for camera, view in header["views"].items()}
    arrays[HEADER] = np.array(json.dumps(header, default=np.ndarray.tolist))
    with path.open("wb") as file:
        np.savez(file, **arrays)


def read_drop(path: Path) -> BallDrop:
    """Read a drop that `write_drop` has written."""
    with path.open("rb") as file, np.load(file) as arrays:
        header = json.loads(str(arrays[HEADER]))
        for camera, view in header["views"].items():
            header["views"][camera] = BallView(
                outline_uv=arrays[camera], center_uv=np.array(view.pop("center_uv")), **view
            )
    return BallDrop(**header)


def keep_drop(folder: Path, drop: ObservedDrop, outlines_path: Path | None) -> None:
    """Store a drop durably under the next number; `outlines_path` is None when nothing was observed."""
    path = folder / f"{len(list(folder.glob('*.json'))) + 1:05d}.npz"
    path.unlink(missing_ok=True)  # left by a crash before its JSON was written
    if outlines_path is not None:
        with replacing(path) as unfinished:
            shutil.copyfile(outlines_path, unfinished)
    write_json(path.with_suffix(".json"), asdict(drop))


def kept_drops(folder: Path) -> list[ObservedDrop]:
    """Read the drops of a folder, in the order in which they fell; raise `RecordingError` when one is damaged."""
    return [read_document(path, ObservedDrop) for path in sorted(folder.glob("*.json"))]


def outline_paths(folder: Path) -> list[Path]:
    """Return the files of outlines, in the order of the drops; drops without any are left out."""
    return [path for each in sorted(folder.glob("*.json")) if (path := each.with_suffix(".npz")).exists()]
