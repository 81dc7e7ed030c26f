"""Uncertainty of a calibration, from the normal equations at the solution.

The covariance of all unknowns is the inverse of their normal matrix, with the noise that the residuals show. Motions
of the rig as a whole change no measurement and are projected out. Added is what the residuals cannot show: the
tolerance of the ball's diameter, and, if balls of only one size were dropped, an offset of all outlines.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from pipeline.arrays import Floats, PointsMM
from pipeline.calibration.bundle_adjustment import (
    FOCAL,
    K1,
    N_CAMERA,
    PRINCIPAL,
    ROTATION,
    SHIFT,
    Noise,
    Solution,
    Tolerances,
    linearized,
    point_weights,
    prior_precision,
)
from pipeline.calibration.report import CameraUncertainty, NumberWithSd
from pipeline.calibration.sphere_image import N_SECTORS, Sightings
from pipeline.frames import CameraId

UNSEEN_EDGE_PX = 0.05
"""Standard deviation of the outlines' offset where it is not observable: the difference between segmentations."""
BALL_TOLERANCE_MM = 0.001
"""Standard deviation of a bearing ball's diameter (grade 40 and better)."""
HALF_LENGTH_MM = 10.0
"""Half of the length whose uncertainty is predicted; its middle is the origin."""
MARK_PX = 20.0
"""Radius of the circular marks at its ends; as they are seen without noise, any size gives the same."""


def covariance(
    solution: Solution, sightings: Sightings, *, noise: Noise, tolerances: Tolerances, free_edge: bool
) -> Floats:
    """Return the covariance (P, P) of the unknowns of `solution`, without motions of the rig as a whole."""
    blocks = linearized(solution, sightings)
    precision = prior_precision(len(solution.initial), len(solution.centers_mm), tolerances)
    normal, _ = blocks.normal_equations(point_weights(blocks, sightings, noise), len(precision))
    normal += precision
    if free_edge:
        found = np.linalg.inv(normal)
    else:
        found = np.zeros_like(normal)
        inverse = np.linalg.inv(normal[:-1, :-1])
        by_edge = np.append(-inverse @ normal[:-1, -1], 1.0)
        found[:-1, :-1] = inverse
        found += UNSEEN_EDGE_PX**2 * np.outer(by_edge, by_edge)
    fixing = _without_motion(solution, precision)
    return fixing @ found @ fixing.T


def _without_motion(solution: Solution, precision: Floats) -> Floats:
    """Return the projection (P, P) that subtracts from a change of the unknowns the closest rigid motion."""
    motions = np.zeros((len(precision), 6))
    centers_mm = np.array([camera.center_mm for camera in solution.cameras])
    n_cameras = len(centers_mm)
    of_cameras = motions[: n_cameras * N_CAMERA].reshape(n_cameras, N_CAMERA, 6)
    of_balls = motions[n_cameras * N_CAMERA : -1].reshape(-1, 3, 6)
    of_cameras[:, ROTATION, :3] = np.eye(3)
    of_cameras[:, SHIFT, 3:] = np.eye(3)
    of_balls[:, :, 3:] = np.eye(3)
    for axis, unit in enumerate(np.eye(3)):
        of_cameras[:, SHIFT, axis] = np.cross(unit, centers_mm)
        of_balls[:, :, axis] = np.cross(unit, solution.centers_mm)
    weighted = precision @ motions  # balls have no prior: only the cameras count
    return np.eye(len(precision)) - motions @ np.linalg.solve(weighted.T @ motions, weighted.T)


def camera_uncertainties(
    camera_ids: Sequence[CameraId], solution: Solution, covariance: Floats
) -> Mapping[CameraId, CameraUncertainty]:
    """Return for each camera the largest standard deviation of each kind of parameter."""
    n = len(camera_ids)
    sd = np.sqrt(np.diag(covariance)[: n * N_CAMERA]).reshape(n, N_CAMERA)
    return {
        camera: CameraUncertainty(
            rotation_deg=float(np.rad2deg(row[ROTATION].max())),
            center_mm=float(row[SHIFT].max()),
            focal_percent=float(100 * row[FOCAL]),
            principal_point_px=float(row[PRINCIPAL].max()),
            k1=float(row[K1]),
        )
        for camera, row in zip(camera_ids, sd, strict=True)
    }


def common_factors(solution: Solution, covariance: Floats) -> tuple[NumberWithSd, NumberWithSd]:
    """Return the mean ratios of the cameras' distances and of the focal lengths to those of the initial rig."""
    initial_mm = np.array([camera.center_mm for camera in solution.initial])
    distances_mm = np.linalg.norm(initial_mm, axis=1, keepdims=True)
    now_mm = np.linalg.norm(initial_mm + solution.parameters[:, SHIFT], axis=1, keepdims=True)
    rows = np.zeros((2, *solution.parameters.shape))
    rows[0][:, SHIFT] = initial_mm / distances_mm**2 / len(initial_mm)
    rows[1][:, FOCAL] = 1 / len(initial_mm)
    flat = rows.reshape(2, -1)
    n = flat.shape[1]
    sd = np.sqrt(np.einsum("ij,jk,ik->i", flat, covariance[:n, :n], flat))
    focal = float(np.exp(solution.parameters[:, FOCAL].mean()))
    return (
        NumberWithSd(value=float((now_mm / distances_mm).mean()), sd=float(sd[0])),
        NumberWithSd(value=focal, sd=float(sd[1]) * focal),
    )


def length_sd_percent(solution: Solution, covariance: Floats, diameters_mm: Sequence[float]) -> float:
    """Return the standard deviation of a length of 20 mm about the origin, rms over directions.

    It is that of the calibration alone: all cameras see the ends of the length without noise.
    """
    directions = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
    directions = directions[directions @ [9, 3, 1] > 0]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ends_mm = HALF_LENGTH_MM * np.concatenate([directions, -directions])
    by_unknowns = _by_unknowns(solution, ends_mm)
    first, second = np.split(by_unknowns, 2)
    lengths = np.einsum("ni,nij->nj", directions, first - second)
    n = lengths.shape[1]
    variances = np.einsum("ij,jk,ik->i", lengths, covariance[:n, :n], lengths) / (2 * HALF_LENGTH_MM) ** 2
    tolerance = BALL_TOLERANCE_MM / float(np.mean(diameters_mm)) if diameters_mm else 0.0
    return float(100 * np.sqrt(variances.mean() + tolerance**2))


def _by_unknowns(solution: Solution, points_mm: PointsMM) -> Floats:
    """Return the derivatives (N, 3, U) of points located with these cameras by the U unknowns of the cameras."""
    cameras = solution.cameras
    angles = np.linspace(0, 2 * np.pi, N_SECTORS, endpoint=False)
    circle_uv = MARK_PX * np.column_stack([np.cos(angles), np.sin(angles)])
    marks_uv = np.stack([camera.project(points_mm)[0] for camera in cameras])  # (cameras, N, 2)
    n_cameras, n_points = marks_uv.shape[:2]
    camera, point = (index.ravel() for index in np.indices((n_cameras, n_points)))
    marks = Sightings(
        camera=camera,
        drop=point,
        points_uv=marks_uv.reshape(-1, 1, 2) + circle_uv,
        angles=np.broadcast_to(angles, (len(camera), N_SECTORS)),
        weights=np.ones((len(camera), N_SECTORS)),
        radii_mm=np.full(len(camera), np.nan),
    )
    jacobian = linearized(
        Solution(initial=solution.initial, parameters=solution.parameters, centers_mm=points_mm), marks
    ).jacobian.reshape(n_cameras, n_points, N_SECTORS, -1)
    by_camera, by_point = jacobian[..., :N_CAMERA], jacobian[..., N_CAMERA : N_CAMERA + 3]
    normal = np.einsum("cnsi,cnsj->nij", by_point, by_point)
    right = np.einsum("cnsi,cnsj->nicj", by_point, by_camera).reshape(n_points, 3, -1)
    return -np.linalg.solve(normal, right)
