"""How accurate a calibration from ball drops is: rendered images of rigs with a workshop's deviations.

Per rig: 20 drops of a 10 mm ball, anywhere within +-9 mm, and some that are used in no fit. Of the drops one is cut
off by the border in several views, one has a dark dot stuck to it in others, and 3 % of all views show the ball 8 px
beside its place. Printed are

- reprojection, px rms: distance of the centres of the balls that were not used, as their outlines show them, from
  their common place (the paper's: of the centroids),
- length, %: the largest relative error, over all directions, of lengths that the calibrated rig measures,
- 3-D, um rms: error of points over +-12 mm after the best rigid motion,
- F, focus mm off: f-number found, and rms distance of the planes in focus from the true ones, beside the balls,

and the same for the paper's method on the same drops, without outliers.

Run: .venv/bin/python tests/accuracy/calibration.py [--rigs 4] [--seed 1] [--lens f2] [--wall spotted]
                                                  [--two-sizes] [--json]
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

from pipeline.calibration import BallDrop, CalibrationReport, calibrate, observe_ball
from pipeline.calibration.bundle_adjustment import N_CAMERA, Solution
from pipeline.calibration.held_out import located_offsets_px
from pipeline.calibration.paper import ball_points_mm, residuals_px
from pipeline.calibration.report import FoundLenses
from pipeline.calibration.sphere_image import sightings_of
from pipeline.errors import CalibrationError
from pipeline.evaluation.scene import BALL, build_scene, drop_ball, rig_error
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.background import WallKind
from pipeline.synthesis.bodies import ball
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.renderer import PlacedBody

N_DROPS = 20
N_HELD_OUT = 2
N_LARGE = 4
SMALL_MM, LARGE_MM = 10.0, 16.0
CUT_OFF_MM = (23.0, 3.0, -2.0)
"""Where a 10 mm ball reaches beyond the border of most images."""
SPOTTED_MM = (-3.0, 4.0, 2.0)
SPOTTED = tuple(CameraId(name) for name in ("c02", "c07", "c12"))
TRUE_FOCUS_MM = 300.0
OUTLIER_SHARE = 0.03
OUTLIER_PX = 8.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Photographed:
    """One rig and what it saw."""

    lens: LensPreset
    rig: RigCalibration  # the truth
    drops: tuple[BallDrop, ...]
    held_out: tuple[BallDrop, ...]
    large: tuple[BallDrop, ...]  # of another diameter
    cut_off: BallDrop
    spotted: BallDrop


def photographed(
    seed: int,
    n_drops: int = N_DROPS,
    n_large: int = 0,
    lens: LensPreset = LensPreset.SHARP,
    wall: WallKind = WallKind.PANELS,
) -> Photographed:
    """A rig of this seed and its drops, found in rendered images."""
    scene = build_scene(seed, exposure=LENS_PRESETS[lens], wall_kind=wall)

    def seen(bundle: FrameBundle) -> BallDrop:
        return observe_ball(bundle, scene.background, BackgroundSegmenter(), SMALL_MM)

    def ball_at(at_mm: Sequence[float], number: int, label: str) -> FrameBundle:
        placed = PlacedBody(body=ball(SMALL_MM), R=np.eye(3), offset_mm=np.array(at_mm))
        return scene.photograph(placed, stream(seed, BALL, number), label)

    to_be_spotted = ball_at(SPOTTED_MM, 301, "spotted")
    return Photographed(
        lens=lens,
        rig=scene.true_rig,
        drops=tuple(drop_ball(scene, number, SMALL_MM) for number in range(n_drops - 2)),
        held_out=tuple(drop_ball(scene, 100 + number, SMALL_MM) for number in range(N_HELD_OUT)),
        large=tuple(drop_ball(scene, 200 + number, LARGE_MM) for number in range(n_large)),
        cut_off=seen(ball_at(CUT_OFF_MM, 300, "cut-off")),
        spotted=seen(_with_dots(to_be_spotted, seen(to_be_spotted))),
    )


def _with_dots(bundle: FrameBundle, drop: BallDrop) -> FrameBundle:
    """The exposure with a dark dot, a third of the ball in diameter, on the ball's edge in some views."""
    frames = dict(bundle.frames)
    for camera in SPOTTED:
        image, view = frames[camera].image.copy(), drop.views[camera]
        at_uv = view.center_uv + view.radius_px * np.array([0.6, 0.8])
        cv2.circle(image, np.rint(at_uv).astype(int).tolist(), round(view.radius_px / 3), 45, cv2.FILLED)
        frames[camera] = replace(frames[camera], image=image)
    return replace(bundle, frames=frames)


def with_outliers(
    drops: Sequence[BallDrop], rng: np.random.Generator
) -> tuple[list[BallDrop], set[tuple[str, CameraId]]]:
    """The drops with 3 % of their views, at least one, shifted by 8 px, and which these are."""
    views = [(drop.name, camera) for drop in drops for camera in drop.views]
    n_shifted = max(1, round(OUTLIER_SHARE * len(views)))
    shifted = {views[index] for index in rng.choice(len(views), n_shifted, replace=False)}
    changed = []
    for drop in drops:
        seen = dict(drop.views)
        for camera, view in drop.views.items():
            if (drop.name, camera) in shifted:
                angle = rng.uniform(0, 2 * np.pi)
                shift_uv = OUTLIER_PX * np.array([np.cos(angle), np.sin(angle)])
                seen[camera] = replace(
                    view, outline_uv=view.outline_uv + shift_uv, center_uv=view.center_uv + shift_uv
                )
        changed.append(replace(drop, views=seen))
    return changed, shifted


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Of a calibrated rig."""

    reprojection_px: float
    length_percent: float
    rigid_um: float
    f_number: float | None = None
    f_number_sd: float | None = None
    focus_off_mm: float | None = None  # rms over the cameras of the planes in focus
    lens: str = ""  # why it is not found


def accuracy(report: CalibrationReport, true: RigCalibration, held_out: Sequence[BallDrop]) -> Accuracy:
    """What the rig makes of drops that it has not seen, and of points whose true images it is shown."""
    rig, error = report.rig, rig_error(report.rig, true)
    if rig.method == "paper":
        residuals = residuals_px(held_out, ball_points_mm(held_out, rig), rig.cameras)
        reprojection_px = float(np.sqrt(np.mean(np.square(list(residuals.values())))))
    else:
        reprojection_px = held_against(rig, held_out, report.edge_offset_px or 0.0)
    return Accuracy(
        reprojection_px=reprojection_px,
        length_percent=error.length_percent,
        rigid_um=1e3 * error.rms_mm,
        **lens_found(report, true),
    )


def held_against(rig: RigCalibration, drops: Sequence[BallDrop], edge_px: float) -> float:
    """Rms distance in px of the centres of drops from where this rig has them."""
    solution = Solution(
        initial=rig.cameras,
        parameters=np.zeros((len(rig.cameras), N_CAMERA)),
        centers_mm=np.zeros((0, 3)),
        edge_px=edge_px,
    )
    offsets_px = located_offsets_px(solution, sightings_of(drops, rig.camera_ids))
    return float(np.sqrt((offsets_px**2).sum(axis=1).mean()))


def solved(drops: Sequence[BallDrop], method: str) -> CalibrationReport:
    return calibrate(
        drops,
        nominal_rig(),
        method="paper" if method == "paper" else "bundle",
        created_at="2026-01-01T00:00:00Z",
        name="accuracy",
    )


def rows_of(seen: Photographed, seed: int) -> Iterator[tuple[str, CalibrationReport, Accuracy]]:
    """The calibrations of one rig, with and without what spoils them."""
    rng = stream(seed, 3)
    for n in (8, N_DROPS):
        spoilt, _ = with_outliers([*seen.drops[: n - 2], seen.cut_off, seen.spotted], rng)
        for label, drops, method in (
            (f"bundle, {n} drops, spoilt", spoilt, "bundle"),
            (f"paper, {min(n, len(seen.drops))} drops, clean", seen.drops[:n], "paper"),
        ):
            try:
                report = solved(drops, method)
            except CalibrationError as error:
                if method != "paper":  # which wants more balls seen whole
                    raise
                Console(stderr=True).print(f"rig {seed}, {label}: {error}")
                continue
            yield label, report, accuracy(report, seen.rig, seen.held_out)
    if seen.large:
        report = solved([*seen.drops[:16], *seen.large], "bundle")
        yield "bundle, 16 + 4 larger balls", report, accuracy(report, seen.rig, seen.held_out)


def table_of(rows: Sequence[tuple[int, str, CalibrationReport, Accuracy]]) -> Table:
    table = Table(
        "rig", "calibration", "before px", "after px", "reprojection px", "length %", "3-D um",
        "predicted length sd %", "edge px", "F", "focus mm off", "views left out",
        title="calibration from rendered ball drops, judged by what was not used",
    )  # fmt: skip
    for seed, label, report, found in rows:
        before, after = (
            np.sqrt(np.mean(np.square(list(each.values()))))
            for each in (report.residuals_before_px, report.residuals_after_px)
        )
        predicted = report.uncertainty and f"{report.uncertainty.length_sd_percent:.4f}"
        edge = "" if report.edge_offset_px is None else f"{report.edge_offset_px:+.3f}"
        left_out = sum(len(views) for views in report.views_left_out.values())
        table.add_row(
            str(seed), label, f"{before:.1f}", f"{after:.4f}", f"{found.reprojection_px:.4f}",
            f"{found.length_percent:.4f}", f"{found.rigid_um:.2f}", predicted or "", edge,
            found.lens if found.f_number is None else f"{found.f_number:.2f} +- {found.f_number_sd:.2f}",
            "" if found.focus_off_mm is None else f"{found.focus_off_mm:.2f}", str(left_out),
        )  # fmt: skip
    return table


def lens_found(report: CalibrationReport, true: RigCalibration) -> dict[str, Any]:
    """The f-number, and how far the planes in focus lie from the true ones; or why they are not seen."""
    lenses = report.lenses
    if not isinstance(lenses, FoundLenses):
        return {"lens": "" if lenses is None else lenses.value.replace("_", " ")}
    off_mm = focus_errors_mm(report.rig, true)
    return {
        "f_number": lenses.f_number.value,
        "f_number_sd": lenses.f_number.sd,
        "focus_off_mm": float(np.sqrt(np.square(off_mm).mean())),
    }


def focus_errors_mm(rig: RigCalibration, true: RigCalibration) -> list[float]:
    """How much further away each plane in focus is than the true one, in the world that both rigs measure."""
    error = rig_error(rig, true)
    return [
        camera.lens.focus_mm
        + float(true_camera.R[2] @ (error.R @ camera.center_mm + error.t_mm - true_camera.center_mm))
        - TRUE_FOCUS_MM
        for camera, true_camera in zip(rig.cameras, true.cameras, strict=True)
        if camera.lens is not None
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lens", type=LensPreset, choices=tuple(LensPreset), default=LensPreset.SHARP)
    parser.add_argument("--wall", type=WallKind, choices=tuple(WallKind), default=WallKind.PANELS)
    parser.add_argument("--two-sizes", action="store_true", help="also with four balls of 16 mm")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = [
        (seed, *row)
        for seed in range(arguments.seed, arguments.seed + arguments.rigs)
        for row in rows_of(
            photographed(
                seed,
                n_large=N_LARGE if arguments.two_sizes else 0,
                lens=arguments.lens,
                wall=arguments.wall,
            ),
            seed,
        )
    ]
    if arguments.json:
        found = [{"rig": seed, "calibration": label, **asdict(row)} for seed, label, _, row in rows]
        sys.stdout.write(json.dumps(found, indent=1) + "\n")
    else:
        Console(width=200).print(table_of(rows))
