"""Ball drops without images: outlines of balls as an exact rig would see them, with noise."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.drops import BallDrop, BallView
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.depth_blur import expected_sigma_px

Array = NDArray[np.float64]

N_OUTLINE_POINTS = 120


def sphere_outline_uv(
    camera: CameraCalibration, center_mm: Array, diameter_mm: float, n_points: int = N_OUTLINE_POINTS
) -> Array:
    """Pixels (N, 2) of the circle in which the cone of viewing rays touches a sphere at `center_mm` (3,)."""
    away_mm = center_mm - camera.center_mm
    distance_mm = float(np.linalg.norm(away_mm))
    axis, radius_mm = away_mm / distance_mm, diameter_mm / 2
    right = np.cross(axis, camera.R[1])
    right /= np.linalg.norm(right)
    angle = np.linspace(0, 2 * np.pi, n_points, endpoint=False)[:, None]
    circle = np.cos(angle) * right + np.sin(angle) * np.cross(axis, right)
    sine = radius_mm / distance_mm
    points_mm = center_mm - sine * radius_mm * axis + radius_mm * np.sqrt(1 - sine**2) * circle
    return camera.project(points_mm)[0]


def ball_view(outline_uv: Array) -> BallView:
    """The view of a ball with this outline (N, 2), evenly spread in angle."""
    center_uv = outline_uv.mean(axis=0)
    # mean semi-axis of a nearly round ellipse seen at even angles
    radii_px = np.linalg.norm(outline_uv - center_uv, axis=1)
    return BallView(
        outline_uv=outline_uv,
        center_uv=center_uv,
        radius_px=float(radii_px.mean()),
        rms_px=float(radii_px.std()),
    )


def drop(
    name: str,
    rig: RigCalibration,
    center_mm: Sequence[float] | Array,
    diameter_mm: float = 10.0,
    *,
    entered_mm: float | None = None,
    noise_px: float = 0.0,
    edge_offset_px: float = 0.0,
    width_noise: float = 0.02,
    fall_ns: int | None = None,
    rng: np.random.Generator | None = None,
) -> BallDrop:
    """The drop of a ball as `rig` sees it; a ball that is not whole in a view is refused there as clipped.

    `noise_px` is the standard deviation of each outline point in u and v, `edge_offset_px` how much too far out
    all of them are; the operator entered `entered_mm`, by default the true diameter. A camera with a lens shows the
    width of the ball's edge, with a relative error of `width_noise` (sd).
    """
    rng = rng or np.random.default_rng(0)
    views: dict[CameraId, BallView] = {}
    refused: dict[CameraId, str] = {}
    for camera in rig.cameras:
        exact_uv = sphere_outline_uv(camera, np.asarray(center_mm, dtype=float), diameter_mm)
        outward = exact_uv - exact_uv.mean(axis=0)
        outward /= np.linalg.norm(outward, axis=1, keepdims=True)
        seen_uv = exact_uv + edge_offset_px * outward + noise_px * rng.normal(size=exact_uv.shape)
        if (seen_uv < 0).any() or (seen_uv > np.array(camera.image_size_px) - 1).any():
            refused[camera.id] = "clipped"
        else:
            views[camera.id] = ball_view(seen_uv)
            limb_mm = np.asarray(center_mm) + (diameter_mm / 2) ** 2 / 300**2 * camera.center_mm
            sigmas_px = expected_sigma_px(camera, camera.project(limb_mm[None])[1])
            if sigmas_px is not None:
                sigma_px = float(sigmas_px[0] * np.exp(width_noise * rng.normal()))
                views[camera.id] = replace(views[camera.id], edge_sigma_px=sigma_px)
    return BallDrop(
        name=name,
        diameter_mm=diameter_mm if entered_mm is None else entered_mm,
        views=views,
        refused=refused,
        fall_ns=fall_ns,
    )


def drops_across(
    rig: RigCalibration,
    count: int,
    *,
    first: int = 1,
    seed: int = 0,
    spread_mm: Sequence[float] = (9.0, 9.0, 9.0),
    diameter_mm: float = 10.0,
    entered_mm: float | None = None,
    noise_px: float = 0.1,
    edge_offset_px: float = 0.0,
) -> list[BallDrop]:
    """Drops evenly distributed within `spread_mm` of the centre along each axis, named from `first` on."""
    rng = np.random.default_rng(seed)
    return [
        drop(
            f"{number:06d}-ball",
            rig,
            np.array(spread_mm) * rng.uniform(-1, 1, size=3),
            diameter_mm,
            entered_mm=entered_mm,
            noise_px=noise_px,
            edge_offset_px=edge_offset_px,
            rng=rng,
        )
        for number in range(first, first + count)
    ]


def with_views_of(ball: BallDrop, other_names: Mapping[CameraId, CameraId]) -> BallDrop:
    """The drop as it looks when the images of some cameras carry the names of others."""
    return replace(
        ball,
        views={other_names.get(camera, camera): view for camera, view in ball.views.items()},
        refused={other_names.get(camera, camera): reason for camera, reason in ball.refused.items()},
    )


def without_views(ball: BallDrop, cameras: Sequence[CameraId], reason: str = "empty") -> BallDrop:
    """The drop without these views."""
    return replace(
        ball,
        views={camera: view for camera, view in ball.views.items() if camera not in cameras},
        refused={**ball.refused, **dict.fromkeys(cameras, reason)},
    )
