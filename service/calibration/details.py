"""One calibration in detail, for following and reviewing it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from pipeline.calibration.coverage import Coverage, coverage
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.calibration.drop_files import ObservedDrop, drop_without_outlines, kept_drops
from service.calibration.files import CalibrationFiles, CalibrationRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDetails:
    """A calibration with its drops, in the order in which they fell, their coverage and its report."""

    record: CalibrationRecord
    drops: list[ObservedDrop]
    coverage: Coverage
    residuals_px: Mapping[CameraId, float]  # rms over the drops, with the calibration in use when they fell
    report: Mapping[str, Any] | None


def calibration_details(
    files: CalibrationFiles, record: CalibrationRecord, rig_in_use: RigCalibration
) -> CalibrationDetails:
    """Read the details of a calibration; blocks. Without a solution the rig in use judges the coverage.

    Raises
    ------
    RecordingError
        A file of the calibration is damaged.
    """
    drops = kept_drops(files.drops(record.id))
    is_solved = record.calibration_id is not None
    return CalibrationDetails(
        record=record,
        drops=drops,
        coverage=coverage(
            [drop_without_outlines(drop) for drop in drops], files.rig(record) if is_solved else rig_in_use
        ),
        residuals_px=_rms(drops),
        report=files.report(record) if is_solved else None,
    )


def _rms(drops: Iterable[ObservedDrop]) -> dict[CameraId, float]:
    squares: dict[CameraId, list[float]] = {}
    for drop in drops:
        for camera, residual_px in drop.residuals_px.items():
            squares.setdefault(camera, []).append(residual_px**2)
    return {camera: fmean(squares[camera]) ** 0.5 for camera in sorted(squares)}
