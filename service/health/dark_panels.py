"""Locate the parts of the wall that have become dark: neighbouring cameras see the same light panel fail.

Every camera looks through the rig's centre at the wall behind. Fields of view do not overlap there, but a panel
is larger than one: its failure dims one camera and tilts the light of its neighbours. A loss of light that only one
camera sees is caused by that camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Directions, Values
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration

MIN_LOSS = 0.05
"""Share of its light that a camera must have lost somewhere to see a part of a dark place."""
NEIGHBOURS_DEG = 75.0
"""Largest angle between the lines of sight of two cameras that see one panel; the nearest ones are 50 degrees apart."""
SAMPLES = np.array([-2 / 3, 0.0, 2 / 3])
"""Positions at which the light of a view is sampled, along u and v, from border (-1) to border (1)."""


@dataclass(frozen=True, slots=True)
class ViewLight:
    """Light on the wall that a camera sees, relative to the clean rig."""

    brightness: float
    gradient_uv: tuple[float, float]  # from border to border


@dataclass(frozen=True, slots=True, kw_only=True)
class DarkPlace:
    """A part of the wall that has become dark, and the cameras that see it."""

    cameras: tuple[CameraId, ...]  # darkest first
    loss: float  # greatest share of the light that is missing
    azimuth_deg: float
    elevation_deg: float


def dark_places(rig: RigCalibration, lights: Mapping[CameraId, ViewLight]) -> list[DarkPlace]:
    """Return the parts of the wall that have lost light, one for each group of neighbouring darkened cameras."""
    losses = {camera: 1 - _samples(light) for camera, light in lights.items()}
    darkened = [
        camera for camera in rig.cameras if camera.id in losses and losses[camera.id].max() > MIN_LOSS
    ]
    places = []
    while darkened:
        group, darkened = darkened[:1], darkened[1:]
        for member in group:  # which grows during the iteration
            neighbours = [other for other in darkened if _are_neighbours(member, other)]
            group += neighbours
            darkened = [other for other in darkened if other not in neighbours]
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


def _samples(light: ViewLight) -> Values:
    """Return the light (9,) at the sampled positions of a view."""
    slope_u, slope_v = light.gradient_uv
    return (light.brightness * (1 + slope_v / 2 * SAMPLES[:, None] + slope_u / 2 * SAMPLES)).ravel()


def _on_wall(camera: CameraCalibration) -> Directions:
    """Return the directions (9, 3) from the centre to the wall, a sphere through the cameras, at these positions."""
    half_size = np.array(camera.image_size_px) / 2
    offsets = np.stack(np.meshgrid(SAMPLES, SAMPLES), axis=-1).reshape(-1, 2)
    rays = camera.rays(half_size * (1 + offsets) - 0.5)
    points = camera.center_mm - 2 * (rays @ camera.center_mm)[:, None] * rays
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _are_neighbours(one: CameraCalibration, other: CameraCalibration) -> bool:
    a, b = one.center_mm, other.center_mm
    return bool(a @ b > np.cos(np.deg2rad(NEIGHBOURS_DEG)) * np.linalg.norm(a) * np.linalg.norm(b))
