"""Bundle adjustment of all cameras and balls: least residuals of the outlines, with the initial rig as a prior.

Each camera has ten parameters: a rotation (vector, world frame) and a shift against its initial pose, a factor on
its focal length (logarithm), its principal point and k1. Each ball has a centre; with balls of two sizes a common
offset of all outlines is free as well. The scale comes from the balls' diameters alone.

*Priors.* The initial rig is an observation of every parameter with a workshop's tolerances. They decide what the
balls cannot: where the rig is as a whole (a rigid motion changes no residual, so the solution closest to the initial
rig is taken), and how focal length and distance share a magnification. A focal length that is wrong by the same
factor in all cameras is expected (a lens focused at 300 mm has an image distance 9 % longer than its nominal focal
length); one that differs from camera to camera is not.

*Solver.* Levenberg-Marquardt on the normal equations, which are assembled from the blocks of the views: 10 + 3 + 1
unknowns per view, a few hundred in all.

*Outliers.* Soft-L1 on the rms residual of a view, by iteratively reweighted least squares: first with a wide scale,
since the initial rig is off by 70 px, then at the scale of the residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from pipeline.arrays import Floats, Indices, Matrix33, PointsMM, Values
from pipeline.calibration.sphere_image import N_SECTORS, Sightings, misfit, rays_of
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import CameraCalibration

N_CAMERA = 10
"""Number of parameters of a camera."""
ROTATION, SHIFT, FOCAL, PRINCIPAL, K1 = slice(0, 3), slice(3, 6), 6, slice(7, 9), 9
"""Where they are among the ten: rotation vector in rad, shift in mm, log of the focal length, px, k1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Standard deviations of a rig's parameters from its design."""

    rotation_deg: float = 1.0  # about each axis
    center_mm: float = 2.0  # along each axis
    focal: float = 0.015  # relative, of one camera from the others
    common_focal: float = 0.15  # relative, of all cameras alike
    principal_point_px: float = 15.0
    k1: float = 0.15  # simple lenses of this kind have -0.10 +- 0.05
    edge_px: float = 1.0  # common offset of all outlines


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A rig and the balls in it: one point of the parameter space."""

    initial: tuple[CameraCalibration, ...]
    parameters: Floats  # (cameras, 10) relative to `initial`
    centers_mm: PointsMM  # (D, 3) of the balls
    edge_px: float = 0.0

    @property
    def cameras(self) -> tuple[CameraCalibration, ...]:
        """The cameras with these parameters."""
        rotations = Rotation.from_rotvec(self.parameters[:, ROTATION]).as_matrix()
        return tuple(
            _changed(camera, rotation, change)
            for camera, rotation, change in zip(self.initial, rotations, self.parameters, strict=True)
        )

    def moved(self, step: Values) -> "Solution":
        """Return the solution after a step (P,) of all unknowns: cameras, balls, edge."""
        n_cameras = self.parameters.size
        change = step[:n_cameras].reshape(self.parameters.shape)
        parameters = self.parameters + change
        rotated = Rotation.from_rotvec(change[:, ROTATION]) * Rotation.from_rotvec(
            self.parameters[:, ROTATION]
        )
        parameters[:, ROTATION] = rotated.as_rotvec()
        return replace(
            self,
            parameters=parameters,
            centers_mm=self.centers_mm + step[n_cameras:-1].reshape(-1, 3),
            edge_px=self.edge_px + float(step[-1]),
        )


def _changed(camera: CameraCalibration, rotation: Matrix33, change: Values) -> CameraCalibration:
    """Return the camera with its ten parameters changed; `rotation` is the matrix of the first three."""
    R = camera.R @ rotation.T
    K = camera.K.copy()
    K[:2, :2] *= np.exp(change[FOCAL])
    K[:2, 2] += change[PRINCIPAL]
    distortion = camera.distortion.copy()
    distortion[0] += change[K1]
    return replace(camera, K=K, R=R, t_mm=-R @ (camera.center_mm + change[SHIFT]), distortion=distortion)


# --- the linearized problem ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Residuals of V views with S points each, and their derivatives by each view's own 14 unknowns."""

    residuals_px: Floats  # (V, S)
    jacobian: Floats  # (V, S, 14): camera 10, ball 3, edge 1
    unknowns: Indices  # (V, 14) their indices among all P

    def normal_equations(self, weights: Floats, n_unknowns: int) -> tuple[Floats, Values]:
        """Return J^T W J (P, P) and J^T W e (P,) with weights (V, S)."""
        weighted = self.jacobian * weights[..., None]
        matrix = weighted.transpose(0, 2, 1) @ self.jacobian
        right = np.einsum("vsi,vs->vi", weighted, self.residuals_px)
        places = self.unknowns[:, :, None] * n_unknowns + self.unknowns[:, None, :]
        flat = np.bincount(places.ravel(), matrix.ravel(), minlength=n_unknowns**2).astype(np.float64)
        gradient = np.bincount(self.unknowns.ravel(), right.ravel(), minlength=n_unknowns).astype(np.float64)
        return flat.reshape(n_unknowns, n_unknowns), gradient


def linearized(solution: Solution, sightings: Sightings) -> Blocks:
    """Return the outlines' residuals at a solution, with their derivatives."""
    cameras = solution.cameras
    rays = rays_of(sightings, cameras)
    found = misfit(sightings, cameras, rays, solution.centers_mm)
    by_rotation = np.cross(rays, found.by_ray)
    rotations = np.array([camera.R for camera in cameras])[sightings.camera]
    in_camera = rays @ rotations.transpose(0, 2, 1)
    # derivative of the residual by the ray's normalized image coordinates (x, y)
    by_image = (found.by_ray @ rotations.transpose(0, 2, 1) * in_camera[..., 2:])[..., :2]
    xy = in_camera[..., :2] / in_camera[..., 2:]
    by_focal = -(by_image * xy).sum(axis=2)
    focal_px = np.array([np.diag(camera.K)[:2] for camera in cameras])[sightings.camera][:, None, :]
    jacobian = np.concatenate(
        [
            by_rotation,
            -found.by_center,
            (by_focal + found.residuals_px)[..., None],
            -by_image / focal_px,
            (by_focal * (xy**2).sum(axis=2))[..., None],
            found.by_center,
            np.full((*by_focal.shape, 1), -1.0),
        ],
        axis=2,
    )
    residuals_px = found.residuals_px - solution.edge_px
    if (unknown := np.isnan(sightings.radii_mm)).any():
        # the angle of a cone of unknown size is free: subtract the view's mean
        share = sightings.weights[unknown] / sightings.weights[unknown].sum(axis=1, keepdims=True)
        residuals_px[unknown] -= (share * residuals_px[unknown]).sum(axis=1, keepdims=True)
        jacobian[unknown] -= (share[..., None] * jacobian[unknown]).sum(axis=1, keepdims=True)
    n_cameras = len(cameras) * N_CAMERA
    n_unknowns = n_cameras + solution.centers_mm.size + 1
    unknowns = np.concatenate(
        [
            sightings.camera[:, None] * N_CAMERA + np.arange(N_CAMERA),
            n_cameras + sightings.drop[:, None] * 3 + np.arange(3),
            np.full((len(sightings), 1), n_unknowns - 1),
        ],
        axis=1,
    )
    return Blocks(residuals_px=residuals_px, jacobian=jacobian, unknowns=unknowns)


def prior_precision(n_cameras: int, n_drops: int, tolerances: Tolerances) -> Floats:
    """Return the inverse covariance (P, P) of the unknowns by the tolerances alone; that of the balls is zero."""
    t = tolerances
    sd = np.full((n_cameras, N_CAMERA), np.inf)
    sd[:, ROTATION] = np.deg2rad(t.rotation_deg)
    sd[:, SHIFT], sd[:, PRINCIPAL], sd[:, K1] = t.center_mm, t.principal_point_px, t.k1
    diagonal = np.concatenate([sd.ravel() ** -2.0, np.zeros(3 * n_drops), [t.edge_px**-2.0]])
    precision = np.diag(diagonal)
    focal = np.arange(n_cameras) * N_CAMERA + FOCAL
    covariance = t.focal**2 * np.eye(n_cameras) + t.common_focal**2
    precision[np.ix_(focal, focal)] = np.linalg.inv(covariance)
    return precision


# --- the solver ---

MAX_ITERATIONS = 50
MIN_DECREASE = 0.05
"""Expected decrease of the cost at which the solver stops: 0.2 standard deviations of all unknowns together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """Scale of the residuals."""

    point_px: float  # standard deviation of a sector's point
    wide_px: float  # rms residual of a view at which soft-L1 begins to bound it

    @property
    def center_px(self) -> float:
        """Standard deviation of a ball's centre in one view, in u and in v: that of a circle through S points."""
        return self.point_px / sqrt(N_SECTORS / 2)


def solve(
    start: Solution,
    sightings: Sightings,
    *,
    noise: Noise,
    tolerances: Tolerances,
    free_cameras: bool = True,
    free_edge: bool = False,
) -> Solution:
    """Return the local optimum near `start`; the cameras, or the offset of the outlines, stay if they are not free."""
    n_cameras, n_drops = len(start.initial), len(start.centers_mm)
    precision = prior_precision(n_cameras, n_drops, tolerances)
    free = np.ones(len(precision), bool)
    free[: n_cameras * N_CAMERA] = free_cameras
    free[-1] = free_edge

    def cost_of(solution: Solution, blocks: Blocks) -> float:
        unknowns = unknowns_of(solution)
        views = (sightings.weights.sum(axis=1) * soft_l1(view_rms_px(blocks, sightings), noise.wide_px)).sum()
        return float(views / noise.point_px**2 + unknowns @ precision @ unknowns)

    solution, damping = start, 1e-6
    blocks = linearized(solution, sightings)
    cost = cost_of(solution, blocks)
    for _ in range(MAX_ITERATIONS):
        weights = point_weights(blocks, sightings, noise)
        matrix, gradient = blocks.normal_equations(weights, len(precision))
        matrix += precision
        gradient += precision @ unknowns_of(solution)
        matrix, gradient = matrix[np.ix_(free, free)], gradient[free]
        scale = np.sqrt(np.diag(matrix))
        while True:
            scaled = matrix / np.outer(scale, scale) + damping * np.eye(len(scale))
            step = np.zeros(len(free))
            step[free] = -cho_solve(cho_factor(scaled), gradient / scale) / scale
            expected_decrease = -float(gradient @ step[free])
            proposed = solution.moved(step)
            if expected_decrease < MIN_DECREASE:
                return proposed
            proposed_blocks = linearized(proposed, sightings)
            decrease = cost - cost_of(proposed, proposed_blocks)
            if decrease >= 0:
                break
            damping *= 10
        if decrease > 0.75 * expected_decrease:
            damping /= 10
        solution, blocks, cost = proposed, proposed_blocks, cost - decrease
    return solution


def unknowns_of(solution: Solution) -> Values:
    """Return the unknowns' deviations (P,) from their priors; zeros for the balls, which have none."""
    return np.concatenate(
        [solution.parameters.ravel(), np.zeros(solution.centers_mm.size), [solution.edge_px]]
    )


def view_rms_px(blocks: Blocks, sightings: Sightings) -> Values:
    """Return the rms residual (V,) of each view's points."""
    weights = sightings.weights
    return np.sqrt((weights * blocks.residuals_px**2).sum(axis=1) / weights.sum(axis=1))


def soft_l1(values: Values, scale: float) -> Values:
    """Return the soft-L1 loss: about the square of values below `scale`, 2 `scale` times those far above."""
    return 2 * scale**2 * (np.sqrt(1 + (values / scale) ** 2) - 1)


def point_weights(blocks: Blocks, sightings: Sightings, noise: Noise) -> Floats:
    """Return the weights (V, S) of the points in the normal equations."""
    robust = 1 / np.sqrt(1 + (view_rms_px(blocks, sightings) / noise.wide_px) ** 2)
    return sightings.weights * robust[:, None] / noise.point_px**2


def triangulated(cameras: Sequence[CameraCalibration], sightings: Sightings, n_drops: int) -> PointsMM:
    """Return first guesses (D, 3) of the balls' centres: the points nearest to the mean rays of their outlines."""
    rays = rays_of(sightings, cameras)
    axes = (rays * sightings.weights[..., None]).sum(axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    optical_mm = np.array([camera.center_mm for camera in cameras])[sightings.camera]
    return np.array(
        [nearest_point(optical_mm[sightings.drop == d], axes[sightings.drop == d]) for d in range(n_drops)]
    )
