"""Model of a ball's image, the cone of viewing rays that touch it, and the residuals of observed outlines.

The rays from an optical centre c that touch a sphere of radius r about C make the angle asin(r / |C - c|) with the
direction to C. A point of the outline is therefore wrong by

    e = f (angle between its ray and C - c  -  asin(r / |C - c|))

in px, whatever the shape of the image and the distortion of the lens. The centroid of the outline, which is not the
image of the centre (0.06 px off for a ball of 10 mm 10 mm beside the axis), is never used.

The points of an outline are averaged over sectors. This loses nothing, as the residual that a wrong camera or ball
causes varies slowly along the outline.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Floats, Indices, PointsMM, Values
from pipeline.calibration.drops import BallDrop, BallView
from pipeline.calibration.ellipse import harmonics, polar
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration

N_SECTORS = 24
"""Number of sectors of an outline."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """All V views of all drops, with S = `N_SECTORS` points each."""

    camera: Indices  # (V,) index of the camera in the rig
    drop: Indices  # (V,)
    points_uv: Floats  # (V, S, 2)
    angles: Floats  # (V, S) rad, direction of each point from the centre of the outline
    weights: Floats  # (V, S) share of the sector's outline that was seen, 0..1
    radii_mm: Values  # (V,) radius of the ball; NaN: unknown

    def __len__(self) -> int:
        return len(self.camera)

    def of_drops(self, chosen: Indices) -> "Sightings":
        """Return the sightings of some drops, which are renumbered in their order."""
        number = np.full(max(int(self.drop.max()), int(chosen.max())) + 1, -1)
        number[chosen] = np.arange(len(chosen))
        mask = number[self.drop] >= 0
        return Sightings(
            camera=self.camera[mask],
            drop=number[self.drop[mask]],
            points_uv=self.points_uv[mask],
            angles=self.angles[mask],
            weights=self.weights[mask],
            radii_mm=self.radii_mm[mask],
        )


def sightings_of(drops: Sequence[BallDrop], camera_ids: Sequence[CameraId]) -> Sightings:
    """Return the drops' views by these cameras, drop by drop in the order of the cameras."""
    camera, drop, points_uv, angles, weights, radii_mm = [], [], [], [], [], []
    for d, ball in enumerate(drops):
        for c, camera_id in enumerate(camera_ids):
            if camera_id not in ball.views:
                continue
            points, angle, weight = sector_means(ball.views[camera_id])
            camera.append(c)
            drop.append(d)
            points_uv.append(points)
            angles.append(angle)
            weights.append(weight)
            radii_mm.append(np.nan if ball.diameter_mm is None else ball.diameter_mm / 2)
    return Sightings(
        camera=np.array(camera, dtype=np.intp),
        drop=np.array(drop, dtype=np.intp),
        points_uv=np.array(points_uv).reshape(-1, N_SECTORS, 2),
        angles=np.array(angles).reshape(-1, N_SECTORS),
        weights=np.array(weights).reshape(-1, N_SECTORS),
        radii_mm=np.array(radii_mm),
    )


def sector_means(view: BallView) -> tuple[Floats, Values, Values]:
    """Return a mean point (S, 2) of each sector of the outline, its angle (S,), and the share (S,) that was seen, 0..1.

    The distances from the outline's own ellipse are averaged, since the mean of an arc's points lies inside it.
    """
    angles, radii_px = polar(view.outline_uv, view.center_uv)
    design = harmonics(angles, 2)
    ellipse = np.linalg.lstsq(design, radii_px)[0]
    sector = np.minimum(((angles + np.pi) / (2 * np.pi) * N_SECTORS).astype(int), N_SECTORS - 1)
    count = np.bincount(sector, minlength=N_SECTORS)
    n = np.maximum(count, 1)
    middle = (np.arange(N_SECTORS) + 0.5) * 2 * np.pi / N_SECTORS - np.pi
    mean_angle = middle + np.bincount(sector, angles - middle[sector], minlength=N_SECTORS) / n
    mean_px = np.bincount(sector, radii_px - design @ ellipse, minlength=N_SECTORS) / n
    radii_px = harmonics(mean_angle, 2) @ ellipse + mean_px
    points_uv = view.center_uv + radii_px[:, None] * np.column_stack([np.cos(mean_angle), np.sin(mean_angle)])
    full = np.median(count[count > 0])
    return points_uv, mean_angle, np.minimum(count / full, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Misfit:
    """Residuals of sightings, and their derivatives."""

    residuals_px: Floats
    """(V, S); of a ball of unknown size the angle itself, from which the view's mean must be subtracted."""
    by_center: Floats  # (V, S, 3) px per mm of the ball's centre; by the camera's centre, the negative
    by_ray: Floats  # (V, S, 3) px per unit of the ray's unit vector, world frame


def rays_of(sightings: Sightings, cameras: Sequence[CameraCalibration]) -> Floats:
    """Return the unit viewing rays (V, S, 3) through all points, in the world frame."""
    rays = np.zeros((*sightings.points_uv.shape[:2], 3))
    for index, camera in enumerate(cameras):
        own = sightings.camera == index
        if own.any():
            rays[own] = camera.rays(sightings.points_uv[own].reshape(-1, 2)).reshape(-1, N_SECTORS, 3)
    return rays


def misfit(
    sightings: Sightings, cameras: Sequence[CameraCalibration], rays: Floats, centers_mm: PointsMM
) -> Misfit:
    """Return the residuals of balls at `centers_mm` (D, 3) whose outlines are seen along `rays` (V, S, 3)."""
    optical_mm = np.array([camera.center_mm for camera in cameras])[sightings.camera]
    focal_px = np.array([camera.focal_px for camera in cameras])[sightings.camera][:, None]
    to_ball_mm = centers_mm[sightings.drop] - optical_mm
    distance_mm = np.linalg.norm(to_ball_mm, axis=1, keepdims=True)
    toward = (to_ball_mm / distance_mm)[:, None, :]
    cosine = (rays * toward).sum(axis=2)
    sine = np.maximum(np.linalg.norm(np.cross(rays, toward), axis=2), 1e-9)
    # unit vectors in the plane of ray and axis, perpendicular to the axis and to the ray
    off_axis = (rays - cosine[..., None] * toward) / sine[..., None]
    off_ray = (toward - cosine[..., None] * rays) / sine[..., None]
    expected = np.arcsin(np.clip(np.nan_to_num(sightings.radii_mm)[:, None] / distance_mm, 0, 0.99))
    by_center = (np.tan(expected)[..., None] * toward - off_axis) / distance_mm[..., None]
    return Misfit(
        residuals_px=focal_px * (np.arctan2(sine, cosine) - expected),
        by_center=focal_px[..., None] * by_center,
        by_ray=-focal_px[..., None] * off_ray,
    )


def view_offsets_px(sightings: Sightings, residuals_px: Floats) -> Floats:
    """Return for each view (V, 3) the observed minus the expected radius of the ball, and offset in u and in v.

    The offset is that between the axes of the observed and of the expected cone of rays.
    """
    design = np.stack(
        [np.ones_like(sightings.angles), np.cos(sightings.angles), np.sin(sightings.angles)], axis=2
    )
    weighted = design * sightings.weights[..., None]
    normal = np.einsum("vsi,vsj->vij", weighted, design)
    right = np.einsum("vsi,vs->vi", weighted, residuals_px)
    return np.linalg.solve(normal, right[..., None])[..., 0]
