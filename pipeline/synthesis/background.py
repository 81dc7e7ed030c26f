"""The empty rig: the inside of its housing as each camera sees it, out of focus.

The cameras sit in a white spherical wall and look at its far side: panels with seams, screws and
vents as dark dots, the apertures of the other cameras and the holes at the poles through which the
stones enter and leave. All of it lies on one sphere in the world frame and is seen where the rig's
geometry puts it. In the nominal rig no aperture or hole is in a field of view.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from pipeline.arrays import Directions, FloatImage, Floats, PointsUV, Values
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.synthesis.thin_lens import ThinLens, disc_kernel
from pipeline.synthesis.wall_spots import Spots, many_spots, scattered_directions, spots_at

APERTURE_RADIUS_MM = 12.0
HOLE_RADIUS_MM = 40.0
SEAM_SPACING_DEG = 18.0
SEAM_WIDTH_MM = 2.0
SEAM_SOFTNESS_MM = 0.5
SEAM_DEPTH = 0.18
WALL_GREY = 205.0
"""Grey level of the plain wall at the nominal flash."""
DULL_WALL_GREY = 185.0
"""The same of the walls that are not of panels: with the lens's corners, 150 to 190."""
N_DOTS = 210  # about two in a field of view
DOT_RADIUS_MM = (1.2, 2.8)  # 12 to 29 px at the far side of the wall
DEFOCUS_PX = 8.0
"""Standard deviation of the far wall's blur at about F8, focused on the centre, where no lens is given."""
COARSE_PX = 4
"""Pixel step on which the wall is computed: it is blurred over more than that."""


class WallKind(StrEnum):
    """Look of the wall; apertures and holes are in each."""

    PANELS = "panels"  # seams, and about two small dark dots in a field of view
    BARE = "bare"  # nothing but apertures and holes
    SPOTTED = "spotted"  # about ten soft spots of 0.3 to 0.75 of its grey in a field of view, and seams
    ONE_SPOT = "one spot"  # bare, but for one spot behind the middle of each view


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wall:
    """The wall's discs and panels, in the world frame."""

    radius_mm: float
    disc_directions: Directions  # from the origin to dots, apertures and holes
    disc_radii_mm: Values
    disc_reflectances: Values  # relative to the wall
    panel_reflectances: Floats  # (parallels, meridians)
    seam_depth: float = SEAM_DEPTH
    spots: Spots | None = None
    grey: float = WALL_GREY  # where it is plain, at the nominal flash


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EmptyView:
    """The empty view of one camera at the nominal flash, before vignetting and glare of its lens."""

    radiance: FloatImage  # (H, W) grey levels, read-only
    gain: float  # of this camera and its light; scales bodies as well


def build_wall(rig: RigCalibration, rng: np.random.Generator, kind: WallKind = WallKind.PANELS) -> Wall:
    """Return a wall with random dots or spots and panels, and the apertures of the rig's cameras."""
    dots = scattered_directions(N_DOTS if kind is WallKind.PANELS else 0, rng)
    apertures = np.array([camera.center_mm for camera in rig.cameras])
    poles = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    distances_mm = np.linalg.norm(apertures, axis=1)
    n_panels = round(180 / SEAM_SPACING_DEG)
    radius_mm = float(distances_mm.mean())
    return Wall(
        radius_mm=radius_mm,
        disc_directions=np.concatenate([dots, apertures / distances_mm[:, None], poles]),
        disc_radii_mm=np.concatenate(
            [
                rng.uniform(*DOT_RADIUS_MM, size=len(dots)),
                np.full(len(apertures), APERTURE_RADIUS_MM),
                np.full(len(poles), HOLE_RADIUS_MM),
            ]
        ),
        disc_reflectances=np.concatenate(
            [
                rng.uniform(0.15, 0.45, size=len(dots)),
                np.full(len(apertures), 0.08),
                np.full(len(poles), 0.04),
            ]
        ),
        panel_reflectances=rng.normal(1.0, 0.012, size=(n_panels, 2 * n_panels)),
        seam_depth=SEAM_DEPTH if kind in (WallKind.PANELS, WallKind.SPOTTED) else 0.0,
        spots=_spots(kind, rig, radius_mm, rng),
        grey=WALL_GREY if kind is WallKind.PANELS else DULL_WALL_GREY,
    )


def _spots(kind: WallKind, rig: RigCalibration, radius_mm: float, rng: np.random.Generator) -> Spots | None:
    if kind is WallKind.SPOTTED:
        return many_spots(radius_mm, rng)
    if kind is WallKind.ONE_SPOT:
        middles = [wall_directions(camera, camera.K[:2, 2][None, :], radius_mm)[0] for camera in rig.cameras]
        return spots_at(np.array(middles))
    return None


def render_backgrounds(
    rig: RigCalibration, wall: Wall, rng: np.random.Generator, lens: ThinLens | None = None
) -> Mapping[CameraId, EmptyView]:
    """Return the empty view of every camera."""
    return {camera.id: _render_background(camera, wall, rng, lens) for camera in rig.cameras}


def _render_background(
    camera: CameraCalibration, wall: Wall, rng: np.random.Generator, lens: ThinLens | None
) -> EmptyView:
    width, height = camera.image_size_px
    kernel = None if lens is None else disc_kernel(_wall_disc_px(camera, wall, lens) / COARSE_PX)
    # cells of margin, so that the blur does not reach the border
    margin = 2 if kernel is None else 2 + len(kernel) // 2
    u = (np.arange(-margin, -(-width // COARSE_PX) + margin) + 0.5) * COARSE_PX - 0.5
    v = (np.arange(-margin, -(-height // COARSE_PX) + margin) + 0.5) * COARSE_PX - 0.5
    grid_uv = np.stack(np.meshgrid(u, v), axis=-1)
    reflectance = _reflectance(wall_directions(camera, grid_uv.reshape(-1, 2), wall.radius_mm), wall)
    coarse = reflectance.reshape(len(v), len(u)).astype(np.float32)
    if kernel is None:
        blurred = cv2.GaussianBlur(coarse, (0, 0), DEFOCUS_PX / COARSE_PX)
    else:
        blurred = cv2.filter2D(coarse, -1, kernel)
    fine = cv2.resize(blurred, None, fx=COARSE_PX, fy=COARSE_PX, interpolation=cv2.INTER_CUBIC)
    fine = fine[margin * COARSE_PX :, margin * COARSE_PX :][:height, :width]

    gain = float(np.clip(rng.normal(1.0, 0.03), 0.93, 1.07))
    x = np.linspace(-1, 1, width)[None, :]
    y = np.linspace(-1, 1, height)[:, None]
    tilt_x, tilt_y = rng.normal(0, 0.03, size=2)
    vignetting = rng.uniform(0.04, 0.08)
    light = wall.grey * gain * (1 + tilt_x * x + tilt_y * y - vignetting * (x**2 + y**2))
    radiance = np.asarray(fine * light, dtype=np.float32)
    radiance.setflags(write=False)
    return EmptyView(radiance=radiance, gain=gain)


def _wall_disc_px(camera: CameraCalibration, wall: Wall, lens: ThinLens) -> float:
    """Return the diameter of the wall's blur disc in the middle of the image; it is nearly the same all over it."""
    middle_uv = camera.K[:2, 2][None, :]
    point_mm = wall.radius_mm * wall_directions(camera, middle_uv, wall.radius_mm)
    return float(lens.disc_px(camera.project(point_mm)[1], camera.focal_px)[0])


def wall_directions(camera: CameraCalibration, pixels_uv: PointsUV, radius_mm: float) -> Directions:
    """Return the directions (N, 3) from the origin to where the rays of pixels (N, 2) meet the far side of the wall."""
    center, rays = camera.center_mm, camera.rays(pixels_uv)
    # |c + s d| = r, the larger s
    half = rays @ center
    distances = -half + np.sqrt(np.maximum(half**2 - center @ center + radius_mm**2, 0))
    points = center + distances[:, None] * rays
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _reflectance(directions: Directions, wall: Wall) -> Values:
    """Return the reflectance (N,) of the wall in directions (N, 3) from the origin."""
    elevation_deg = np.rad2deg(np.arcsin(np.clip(directions[:, 2], -1, 1))) + 90
    azimuth_deg = np.rad2deg(np.arctan2(directions[:, 1], directions[:, 0])) % 360
    rows, columns = elevation_deg / SEAM_SPACING_DEG, azimuth_deg / SEAM_SPACING_DEG
    n_rows, n_columns = wall.panel_reflectances.shape
    result = wall.panel_reflectances[
        np.minimum(rows.astype(int), n_rows - 1), np.minimum(columns.astype(int), n_columns - 1)
    ]
    mm_per_spacing = np.deg2rad(SEAM_SPACING_DEG) * wall.radius_mm
    parallel_mm = mm_per_spacing * np.cos(np.deg2rad(elevation_deg - 90))
    to_seam_mm = np.minimum(
        np.abs(rows - np.round(rows)) * mm_per_spacing, np.abs(columns - np.round(columns)) * parallel_mm
    )
    # a soft border of a cell's size, so that the coarse grid does not show as steps
    depth = np.clip((SEAM_WIDTH_MM / 2 - to_seam_mm) / SEAM_SOFTNESS_MM + 0.5, 0, 1)
    result = result * (1 - wall.seam_depth * depth)
    middle = directions.mean(axis=0)
    middle /= np.linalg.norm(middle)
    field = np.arccos((directions @ middle).min())
    disc_angles = wall.disc_radii_mm / wall.radius_mm
    in_field = np.arccos(np.clip(wall.disc_directions @ middle, -1, 1)) < field + disc_angles
    for i in np.flatnonzero(in_field):
        is_on_disc = directions @ wall.disc_directions[i] > np.cos(disc_angles[i])
        result[is_on_disc] = wall.disc_reflectances[i]
    if wall.spots is not None:
        result = result * wall.spots.shares_at(directions, wall.radius_mm)
    return np.asarray(result)
