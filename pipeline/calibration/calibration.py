"""Calibrate a rig from ball drops, and report the evidence for the result."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import mode
from typing import Literal

import numpy as np

from pipeline.arrays import Matrix33, PointsMM, Values
from pipeline.calibration import paper
from pipeline.calibration.bundle_adjustment import Solution, Tolerances, linearized
from pipeline.calibration.diagnosis import diagnose_after, diagnose_before
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.gravity import fall_of, upright
from pipeline.calibration.held_out import held_out_px, located_offsets_px, rms_by_camera
from pipeline.calibration.lens_fit import fit_lenses, lens_of
from pipeline.calibration.report import (
    CalibrationReport,
    NumberWithSd,
    PredictedUncertainty,
    ScaleSource,
)
from pipeline.calibration.robust_adjustment import Adjusted, adjust
from pipeline.calibration.sphere_image import view_offsets_px
from pipeline.calibration.uncertainty import (
    camera_uncertainties,
    common_factors,
    covariance,
    length_sd_percent,
)
from pipeline.errors import CalibrationError, CalibrationProblem, ProblemCode, RigError
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration


def calibrate(
    drops: Sequence[BallDrop],
    initial: RigCalibration,
    *,
    method: Literal["paper", "bundle"],
    created_at: str,
    name: str,
) -> CalibrationReport:
    """Calibrate the rig by one of two methods; the report's problems say what is doubtful about the result.

    Raises
    ------
    CalibrationError
        Nothing can be solved from these drops.
    """
    problems = diagnose_before(drops, initial)
    if any(problem.is_fatal for problem in problems):
        raise CalibrationError(problems)
    report = (
        by_bundle_adjustment(drops, initial, created_at=created_at, name=name)
        if method == "bundle"
        else by_paper(drops, initial, created_at=created_at, name=name)
    )
    return replace(report, problems=(*problems, *diagnose_after(report, drops)))


def by_bundle_adjustment(
    drops: Sequence[BallDrop],
    initial: RigCalibration,
    *,
    created_at: str,
    name: str,
    tolerances: Tolerances | None = None,
) -> CalibrationReport:
    """Adjust all cameras and balls together; the report has no problems yet.

    Raises
    ------
    CalibrationError
        Fewer than three drops agree with one another.
    """
    tolerances = tolerances or Tolerances()
    adjusted = adjust(drops, initial, tolerances)
    solution, sightings = adjusted.solution, adjusted.sightings
    residuals_px = linearized(solution, sightings).residuals_px
    after_px = rms_by_camera(sightings, view_offsets_px(sightings, residuals_px)[:, 1:], initial.camera_ids)
    initially = Solution(
        initial=initial.cameras,
        parameters=np.zeros_like(solution.parameters),
        centers_mm=solution.centers_mm,
    )
    before_px = located_offsets_px(initially, sightings)
    found = covariance(
        solution, sightings, noise=adjusted.noise, tolerances=tolerances, free_edge=adjusted.free_edge
    )
    distance_factor, focal_factor = common_factors(solution, found)
    diameters_mm = [drop.diameter_mm for drop in adjusted.drops if drop.diameter_mm is not None]
    fall = fall_of(solution.centers_mm, [drop.fall_ns for drop in adjusted.drops])
    R = np.eye(3) if fall is None else upright(fall).as_matrix()
    lenses = fit_lenses(adjusted.drops, solution.cameras, solution.centers_mm)
    length_percent = length_sd_percent(solution, found, diameters_mm)
    cameras = tuple(
        replace(_rotated(camera, R), rms_px=after_px.get(camera.id), lens=lens_of(camera, lenses))
        for camera in solution.cameras
    )
    return CalibrationReport(
        rig=RigCalibration(
            name=name,
            method="bundle",
            created_at=created_at,
            cameras=cameras,
            ball_diameter_mm=mode(diameters_mm) if diameters_mm else None,
            length_sd_percent=length_percent,
        ),
        initial=initial,
        drops_used=tuple(drop.name for drop in adjusted.drops),
        drops_left_out=adjusted.drops_left_out,
        views_left_out=_all_left_out(drops, adjusted),
        residuals_before_px=rms_by_camera(sightings, before_px, initial.camera_ids),
        residuals_after_px=after_px,
        held_out_px=held_out_px(adjusted, tolerances),
        scale=ScaleSource.BALL_DIAMETER if diameters_mm else ScaleSource.NOT_OBSERVABLE,
        edge_offset_px=solution.edge_px if adjusted.free_edge else None,
        ball_centers_mm=_named(adjusted.drops, solution.centers_mm @ R.T),
        distance_factor=distance_factor,
        focal_factor=focal_factor,
        lenses=lenses,
        fall=fall,
        uncertainty=PredictedUncertainty(
            cameras=camera_uncertainties(initial.camera_ids, solution, found),
            length_sd_percent=length_percent,
            observation_px=adjusted.noise.center_px,
        ),
    )


def by_paper(
    drops: Sequence[BallDrop], initial: RigCalibration, *, created_at: str, name: str
) -> CalibrationReport:
    """Calibrate by the paper's Algorithm 1; the report has no problems yet.

    Raises
    ------
    CalibrationError
        A camera saw too few drops for its twelve entries, or they lead to no camera.
    """
    used = [drop for drop in drops if sum(camera in drop.views for camera in initial.camera_ids) >= 2]
    problems = [
        CalibrationProblem(
            code=ProblemCode.CAMERA_SAW_TOO_FEW,
            detail=f"camera {camera} saw {n} drops whole, the paper's method needs {paper.MIN_DROPS}: "
            "drop more balls",
            camera=camera,
        )
        for camera in initial.camera_ids
        if (n := sum(camera in drop.views for drop in used)) < paper.MIN_DROPS
    ]
    if problems:
        raise CalibrationError(problems)
    points_mm = paper.ball_points_mm(used, initial)
    cameras = []
    for camera in initial.cameras:
        seen = [camera.id in drop.views for drop in used]
        try:
            cameras.append(paper.refined(camera, points_mm[seen], paper.centroids(used, camera.id)))
        except RigError as err:
            raise CalibrationError(
                [
                    CalibrationProblem(
                        code=ProblemCode.NO_CAMERA,
                        detail=f"the paper's method fails: {err}",
                        camera=camera.id,
                    )
                ]
            ) from err
    after_px = paper.residuals_px(used, points_mm, cameras)
    centers_mm, initial_mm = (
        np.array([camera.center_mm for camera in rig_cameras]) for rig_cameras in (cameras, initial.cameras)
    )
    diameters_mm = [drop.diameter_mm for drop in used if drop.diameter_mm is not None]
    return CalibrationReport(
        rig=RigCalibration(
            name=name,
            method="paper",
            created_at=created_at,
            cameras=tuple(replace(camera, rms_px=after_px[camera.id], lens=None) for camera in cameras),
            ball_diameter_mm=mode(diameters_mm) if diameters_mm else None,
        ),
        initial=initial,
        drops_used=tuple(drop.name for drop in used),
        drops_left_out={
            drop.name: "seen by fewer than two cameras" for drop in drops if drop.name not in _names(used)
        },
        views_left_out={drop.name: drop.refused for drop in drops if drop.refused},
        residuals_before_px=paper.residuals_px(used, points_mm, initial.cameras),
        residuals_after_px=after_px,
        held_out_px=None,
        scale=ScaleSource.NOT_OBSERVABLE,
        edge_offset_px=None,
        ball_centers_mm=_named(used, points_mm),
        distance_factor=_mean(np.linalg.norm(centers_mm, axis=1) / np.linalg.norm(initial_mm, axis=1)),
        focal_factor=_mean(
            np.array([new.focal_px / old.focal_px for new, old in zip(cameras, initial.cameras, strict=True)])
        ),
        lenses=None,
        fall=None,
        uncertainty=None,
    )


def _rotated(camera: CameraCalibration, R: Matrix33) -> CameraCalibration:
    """Return the camera in the world frame rotated by R."""
    return replace(camera, R=camera.R @ R.T)


def _all_left_out(drops: Sequence[BallDrop], adjusted: Adjusted) -> Mapping[str, Mapping[CameraId, str]]:
    """Return the views refused in the images together with those that contradict the solution, with the reasons."""
    both = {drop.name: {**drop.refused, **adjusted.views_left_out.get(drop.name, {})} for drop in drops}
    return {name: views for name, views in both.items() if views}


def _named(drops: Sequence[BallDrop], centers_mm: PointsMM) -> dict[str, tuple[float, float, float]]:
    return {
        drop.name: (float(x), float(y), float(z)) for drop, (x, y, z) in zip(drops, centers_mm, strict=True)
    }


def _names(drops: Sequence[BallDrop]) -> set[str]:
    return {drop.name for drop in drops}


def _mean(factors: Values) -> NumberWithSd:
    """Return the mean over cameras that were solved one by one, with its standard error."""
    return NumberWithSd(value=float(factors.mean()), sd=float(factors.std(ddof=1) / np.sqrt(len(factors))))
