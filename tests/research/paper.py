"""The paper repeated on rendered images: its methods and times, and Figures 7, 8, 9 and 11, beside ours.

https://doi.org/10.1051/wujns/2024294301. What is compared is like for like: same images, same bodies, same truth. The
published figures are of real parts in a real rig, and stand beside them for orientation only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import fmean, median
from typing import Any

import cv2
import numpy as np

from pipeline.calibration import BallDrop, CalibrationReport
from pipeline.calibration.paper import ball_points_mm
from pipeline.evaluation.distance_picture import Picture, with_lettering
from pipeline.evaluation.summaries import compare_with_paper, summarize
from pipeline.evaluation.trials import ISOLEVELS, STANDARDS, Method
from pipeline.frames import Image
from pipeline.rig.cameras import CameraCalibration
from pipeline.synthesis.stones import STONE_FORMS
from research.accuracy import BenchPlan, BenchResult, RigName, picture_name

PUBLISHED_S = {"segmentation": 16 / 4.95, "reconstruction": 0.6}
"""Times of its section 2 for 16 views: U2-Net at 4.95 images a second on a GPU, and all that follows."""
METHODS: Mapping[RigName, tuple[Method, ...]] = {
    "paper": (*ISOLEVELS, "paper's field"),
    "ours": ("photo",),
}
RED, BLUE, GREEN = (200, 40, 40), (40, 70, 210), (20, 140, 50)
INK, WHITE = (60, 60, 60), (255, 255, 255)


def stage_seconds(result: BenchResult) -> dict[str, dict[str, float]]:
    """Return the median processor time a stone of both methods, s, as the paper parts it."""
    found: dict[str, dict[str, float]] = {}
    for label, method in (("paper's method", "paper's method"), ("ours", "photo")):
        times_ms = {stage: median(each) for (name, stage), each in result.stages_ms.items() if name == method}
        segment_ms = times_ms.pop("segment", float("nan"))
        found[label] = {
            "segmentation": segment_ms / 1000,
            "reconstruction": sum(times_ms.values()) / 1000,
        }
    return found


def document(plan: BenchPlan, result: BenchResult) -> dict[str, Any]:
    """Return everything that the tables have, JSON-ready."""
    return {
        "seed": plan.seed,
        "lens": plan.lens,
        "model": plan.model,
        "distances": [asdict(each) | {"ratio": each.ratio} for each in compare_with_paper(result.trials)],
        "isolevels": [
            {"isolevel": ISOLEVELS[each.method], **each.document()}
            for each in summarize(result.trials)
            if each.method in ISOLEVELS
        ],
        "seconds": {"published": PUBLISHED_S, **stage_seconds(result)},
        "calibration": {
            name: {"before_px": report.residuals_before_px, "after_px": report.residuals_after_px}
            for name, report in result.reports.items()
        },
    }


def write_pictures(plan: BenchPlan, result: BenchResult, folder: Path) -> list[Path]:
    """Write Figures 7, 8, 9 and 11 as PNG files and return their paths."""
    written = []
    report = result.reports.get("paper")
    if report is not None and result.first_view is not None:
        figure_7 = _figure_7(result.first_view, result.paper_drops, report)
        pictures = {"figure-7": figure_7, "figure-8": _figure_8(report)}
        for name, picture in pictures.items():
            written.append(folder / f"{name}.png")
            cv2.imwrite(str(written[-1]), picture[..., ::-1])
    for name, bodies in (("figure-9", list(STANDARDS)), ("figure-11", list(STONE_FORMS))):
        columns = [_column(folder, body) for body in bodies if body in plan.poses]
        if columns := [column for column in columns if column is not None]:
            written.append(folder / f"{name}.png")
            cv2.imwrite(str(written[-1]), np.hstack(columns))
    return written


def _column(folder: Path, body: str) -> Picture | None:
    """Return the pictures of a body, paper's method above ours, as they were written (BGR); None without them."""
    names = [picture_name(body, "paper", "paper's method"), picture_name(body, "ours", "photo")]
    read = [
        np.asarray(found, np.uint8) for name in names if (found := cv2.imread(str(folder / name))) is not None
    ]
    return np.vstack(read) if len(read) == len(names) else None


def _figure_7(view: Image, drops: Sequence[BallDrop], report: CalibrationReport) -> Picture:
    """Draw the first camera's view (H, W) of a drop: all centroids, and as projected before and after calibration."""
    camera = report.initial.cameras[0]
    after = next(each for each in report.rig.cameras if each.id == camera.id)
    picture = np.repeat(view[..., None], 3, axis=2)
    points_mm = ball_points_mm(drops, report.initial)
    for drop, point_mm in zip(drops, points_mm, strict=True):
        if camera.id in drop.views:
            cv2.circle(picture, _whole(drop.views[camera.id].center_uv), 7, GREEN, 2, cv2.LINE_AA)
        for color, calibrated, half in ((RED, camera, 12), (BLUE, after, 16)):
            u, v = _whole(_pinhole(calibrated, point_mm))
            cv2.rectangle(picture, (u - half, v - half), (u + half, v + half), color, 2, cv2.LINE_AA)
    texts = [
        (
            f"camera {camera.id}, {len(drops)} drops: centroids of the masks (green circles), before (red) and",
            24,
            40,
            0.8,
        ),
        ("after calibration (blue)", 24, 74, 0.8),
    ]
    return with_lettering(np.ascontiguousarray(picture, np.uint8), texts)


def _whole(point_uv: Any) -> tuple[int, int]:
    u, v = np.rint(point_uv).astype(int)
    return int(u), int(v)


def _pinhole(camera: CameraCalibration, point_mm: Any) -> Any:
    u, v, w = camera.projection @ np.append(point_mm, 1.0)
    return np.array([u / w, v / w])


def _figure_8(report: CalibrationReport) -> Picture:
    """Draw each camera's rms error of the balls' centroids before and after, with the numbers above the bars."""
    cameras = list(report.residuals_before_px)
    height, bottom, left, step = 560, 500, 70, 74
    picture = np.full((height, left + step * len(cameras) + 20, 3), 255, np.uint8)
    highest_px = max(report.residuals_before_px.values())
    texts = [
        (
            "rms distance of centroids from projections, px: before (red) and after (blue) calibration",
            left,
            34,
            0.6,
        )
    ]
    for number, camera in enumerate(cameras):
        x = left + step * number
        for offset, color, error_px in (
            (0, RED, report.residuals_before_px[camera]),
            (28, BLUE, report.residuals_after_px[camera]),
        ):
            top = bottom - max(round(400 * error_px / highest_px), 1)
            cv2.rectangle(picture, (x + offset, top), (x + offset + 24, bottom), color, cv2.FILLED)
            texts.append((f"{error_px:.3g}", x + offset - 2, top - 8, 0.4))
        texts.append((str(camera), x + 10, bottom + 24, 0.5))
    mean_px = [fmean(each.values()) for each in (report.residuals_before_px, report.residuals_after_px)]
    texts.append((f"mean of all: {mean_px[0]:.1f} px before, {mean_px[1]:.2f} px after", left, 60, 0.6))
    return with_lettering(picture, texts)
