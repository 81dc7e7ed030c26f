"""All cameras and all balls at once: the least misfit of the outlines, tied to the initial rig by its tolerances.

Each camera has ten parameters: a rotation (vector, world frame) and a shift against its initial pose, a factor on
its focal length (logarithm), its principal point and k1. Each ball has a centre; with balls of two sizes a common
offset of all outlines is free as well. The scale comes from the balls' diameters alone.

*Priors.* The initial rig is an observation of every parameter with a workshop's tolerances. They decide what the
balls cannot: where the rig is as a whole (a rigid motion changes no residual, so that the solution is the one that lies
closest to the initial rig), and the split between focal length and distance. A focal length that is wrong in all
cameras alike (a lens focused at 300 mm has a longer image distance than its name, 9 %) is expected; one that differs
from camera to camera is not.

*Solver.* Levenberg-Marquardt on the normal equations, which are assembled from the blocks of the views: 10 + 3 + 1
unknowns a view, a few hundred in all.

*Outliers.* Soft-L1 on the rms residual of a view, as iteratively reweighted squares: first wide, as the initial
rig is off by 70 px, then at the residuals' own scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from pipeline.calibration.sphere_image import N_SECTORS, Sightings, misfit, rays_of
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import CameraCalibration

Array = NDArray[np.float64]

N_CAMERA = 10
TURN, SHIFT, FOCAL, PRINCIPAL, K1 = slice(0, 3), slice(3, 6), 6, slice(7, 9), 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Standard deviations of a rig's parameters against its design."""

    rotation_deg: float = 1.0  # about each axis
    center_mm: float = 2.0  # along each axis
    focal: float = 0.015  # of one camera against the others
    common_focal: float = 0.15
    principal_point_px: float = 15.0
    k1: float = 0.15  # plain lenses of this kind have -0.10 +- 0.05
    edge_px: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A rig and the balls in it."""

    initial: tuple[CameraCalibration, ...]
    parameters: Array  # (cameras, 10) against `initial`
    centers_mm: Array  # (D, 3)
    edge_px: float = 0.0

    @property
    def cameras(self) -> tuple[CameraCalibration, ...]:
        turns = Rotation.from_rotvec(self.parameters[:, TURN]).as_matrix()
        return tuple(
            _changed(camera, turn, change)
            for camera, turn, change in zip(self.initial, turns, self.parameters, strict=True)
        )

    def moved(self, step: Array) -> "Solution":
        """After a step (P,) of the unknowns: cameras, balls, edge."""
        n_cameras = self.parameters.size
        change = step[:n_cameras].reshape(self.parameters.shape)
        parameters = self.parameters + change
        turned = Rotation.from_rotvec(change[:, TURN]) * Rotation.from_rotvec(self.parameters[:, TURN])
        parameters[:, TURN] = turned.as_rotvec()
        return replace(
            self,
            parameters=parameters,
            centers_mm=self.centers_mm + step[n_cameras:-1].reshape(-1, 3),
            edge_px=self.edge_px + float(step[-1]),
        )


def _changed(camera: CameraCalibration, turn: Array, change: Array) -> CameraCalibration:
    R = camera.R @ turn.T
    K = camera.K.copy()
    K[:2, :2] *= np.exp(change[FOCAL])
    K[:2, 2] += change[PRINCIPAL]
    distortion = camera.distortion.copy()
    distortion[0] += change[K1]
    return replace(camera, K=K, R=R, t_mm=-R @ (camera.center_mm + change[SHIFT]), distortion=distortion)


# --- the linearized problem ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Blocks:
    """Of V views with S points each: residuals and their derivatives by the view's own 14 unknowns."""

    residuals_px: Array  # (V, S)
    jacobian: Array  # (V, S, 14): camera 10, ball 3, edge 1
    unknowns: NDArray[np.intp]  # (V, 14) their places among all P

    def normal_equations(self, weights: Array, n_unknowns: int) -> tuple[Array, Array]:
        """J^T W J (P, P) and J^T W e (P,) with weights (V, S)."""
        weighted = self.jacobian * weights[..., None]
        matrix = weighted.transpose(0, 2, 1) @ self.jacobian
        right = np.einsum("vsi,vs->vi", weighted, self.residuals_px)
        places = self.unknowns[:, :, None] * n_unknowns + self.unknowns[:, None, :]
        flat = np.bincount(places.ravel(), matrix.ravel(), minlength=n_unknowns**2).astype(np.float64)
        gradient = np.bincount(self.unknowns.ravel(), right.ravel(), minlength=n_unknowns).astype(np.float64)
        return flat.reshape(n_unknowns, n_unknowns), gradient


def linearized(solution: Solution, sightings: Sightings) -> Blocks:
    """The outlines' misfit at a solution."""
    cameras = solution.cameras
    rays = rays_of(sightings, cameras)
    found = misfit(sightings, cameras, rays, solution.centers_mm)
    by_turn = np.cross(rays, found.by_ray)
    rotations = np.array([camera.R for camera in cameras])[sightings.camera]
    in_camera = rays @ rotations.transpose(0, 2, 1)
    # the normalized image point (x, y, 1) of the ray, and the residual's change with it
    by_image = (found.by_ray @ rotations.transpose(0, 2, 1) * in_camera[..., 2:])[..., :2]
    xy = in_camera[..., :2] / in_camera[..., 2:]
    by_focal = -(by_image * xy).sum(axis=2)
    focal_px = np.array([np.diag(camera.K)[:2] for camera in cameras])[sightings.camera][:, None, :]
    jacobian = np.concatenate(
        [
            by_turn,
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
        # the angle of a cone of unknown size is whatever its points say
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


def prior_precision(n_cameras: int, n_drops: int, tolerances: Tolerances) -> Array:
    """(P, P): inverse covariance of the unknowns before any ball is seen; nothing is known of the balls."""
    t = tolerances
    sd = np.full((n_cameras, N_CAMERA), np.inf)
    sd[:, TURN] = np.deg2rad(t.rotation_deg)
    sd[:, SHIFT], sd[:, PRINCIPAL], sd[:, K1] = t.center_mm, t.principal_point_px, t.k1
    diagonal = np.concatenate([sd.ravel() ** -2.0, np.zeros(3 * n_drops), [t.edge_px**-2.0]])
    precision = np.diag(diagonal)
    focal = np.arange(n_cameras) * N_CAMERA + FOCAL
    covariance = t.focal**2 * np.eye(n_cameras) + t.common_focal**2
    precision[np.ix_(focal, focal)] = np.linalg.inv(covariance)
    return precision


# --- the solver ---

MAX_ITERATIONS = 50
LEAST_DECREASE = 0.05
"""Of the cost, expected of the next step: such a step is 0.2 standard deviations of all unknowns together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """How large residuals may be."""

    point_px: float  # sd of a sector's point
    wide_px: float  # rms of a view from which on it counts less

    @property
    def center_px(self) -> float:
        """Sd of a ball's centre in one view, in u and in v: that of a circle through S points."""
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
    """The solution next to `start`, with the edge's offset or the cameras held if they are not free."""
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
            if expected_decrease < LEAST_DECREASE:
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


def unknowns_of(solution: Solution) -> Array:
    """(P,) with zeros for the balls, of which nothing is known before."""
    return np.concatenate(
        [solution.parameters.ravel(), np.zeros(solution.centers_mm.size), [solution.edge_px]]
    )


def view_rms_px(blocks: Blocks, sightings: Sightings) -> Array:
    """(V,) rms residual of each view's points."""
    weights = sightings.weights
    return np.sqrt((weights * blocks.residuals_px**2).sum(axis=1) / weights.sum(axis=1))


def soft_l1(values: Array, scale: float) -> Array:
    """About the square of small values, 2 `scale` times the large ones."""
    return 2 * scale**2 * (np.sqrt(1 + (values / scale) ** 2) - 1)


def point_weights(blocks: Blocks, sightings: Sightings, noise: Noise) -> Array:
    """(V, S) of the normal equations."""
    robust = 1 / np.sqrt(1 + (view_rms_px(blocks, sightings) / noise.wide_px) ** 2)
    return sightings.weights * robust[:, None] / noise.point_px**2


def triangulated(cameras: Sequence[CameraCalibration], sightings: Sightings, n_drops: int) -> Array:
    """(D, 3) mm: first guess of the balls, the points nearest to the rays through the middles of their outlines."""
    rays = rays_of(sightings, cameras)
    axes = (rays * sightings.weights[..., None]).sum(axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    optical_mm = np.array([camera.center_mm for camera in cameras])[sightings.camera]
    return np.array(
        [nearest_point(optical_mm[sightings.drop == d], axes[sightings.drop == d]) for d in range(n_drops)]
    )
