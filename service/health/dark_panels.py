"""Which part of the wall has grown dark, by geometry: cameras beside one another see the same panel fail.

Every camera looks through the rig's centre at the wall behind. Fields of view do not overlap there, but a panel
is larger than one: its failing dims one camera and tilts the light of those beside it. What one camera alone sees
is in front of that camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration

TOUCHED = 0.05
"""A camera that lost so much of its light somewhere sees a part of the dark place."""
NEIGHBOURS_DEG = 75.0
"""Angle between the lines of sight of two cameras that may see one panel; the nearest ones are 50 degrees apart."""
SAMPLES = np.array([-2 / 3, 0.0, 2 / 3])
"""Where the light of a view is asked for, along u and v, from border (-1) to border (1)."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ViewLight:
    """Light on the wall that a camera sees, against the clean rig."""

    brightness: float
    gradient_uv: tuple[float, float]  # from border to border


@dataclass(frozen=True, slots=True, kw_only=True)
class DarkPlace:
    """A part of the wall, and who sees it."""

    cameras: tuple[CameraId, ...]  # darkest first
    loss: float  # greatest share of the light that is missing
    azimuth_deg: float
    elevation_deg: float


def dark_places(rig: RigCalibration, lights: Mapping[CameraId, ViewLight]) -> list[DarkPlace]:
    """Parts of the wall that have lost light, each with the cameras in whose sight it lies."""
    losses = {camera: 1 - _samples(light) for camera, light in lights.items()}
    touched = [camera for camera in rig.cameras if camera.id in losses and losses[camera.id].max() > TOUCHED]
    places = []
    while touched:
        group, touched = touched[:1], touched[1:]
        for member in group:  # grows while it is walked through
            beside = [other for other in touched if _are_neighbours(member, other)]
            group += beside
            touched = [other for other in touched if other not in beside]
        group.sort(key=lambda camera: -float(losses[camera.id].max()))
        weights = [np.maximum(losses[camera.id], 0) for camera in group]
        x, y, z = np.sum([w @ _on_wall(camera) for w, camera in zip(weights, group, strict=True)], axis=0)
        places.append(
            DarkPlace(
                cameras=tuple(camera.id for camera in group),
                loss=float(losses[group[0].id].max()),
                azimuth_deg=float(np.rad2deg(np.arctan2(y, x)) % 360),
                elevation_deg=float(np.rad2deg(np.arctan2(z, np.hypot(x, y)))),
            )
        )
    return places


def _samples(light: ViewLight) -> Array:
    """Light (9,) at places all over a view."""
    slope_u, slope_v = light.gradient_uv
    return (light.brightness * (1 + slope_v / 2 * SAMPLES[:, None] + slope_u / 2 * SAMPLES)).ravel()


def _on_wall(camera: CameraCalibration) -> Array:
    """Directions (9, 3) from the centre to the wall at the same places: it is a sphere through the cameras."""
    half_size = np.array(camera.image_size_px) / 2
    offsets = np.stack(np.meshgrid(SAMPLES, SAMPLES), axis=-1).reshape(-1, 2)
    rays = camera.rays(half_size * (1 + offsets) - 0.5)
    points = camera.center_mm - 2 * (rays @ camera.center_mm)[:, None] * rays
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _are_neighbours(one: CameraCalibration, other: CameraCalibration) -> bool:
    a, b = one.center_mm, other.center_mm
    return bool(a @ b > np.cos(np.deg2rad(NEIGHBOURS_DEG)) * np.linalg.norm(a) * np.linalg.norm(b))
