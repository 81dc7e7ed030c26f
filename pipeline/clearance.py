"""How far the viewing rays along a silhouette's edge pass the body that the other views show.

The clearance of a ray of view k is the highest value along it of the field (`pipeline.ray_field`) of the others.
"""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.ray_field import HALF_MM, Rays, Steps, field_of, highest_mm, sampled_mm

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Sphere = tuple[Array, float]
"""Centre (3,) in the world frame and radius, mm."""

N_RAYS = 64
"""Rays a view, spread evenly over its outline."""
STEPS: Steps = ((40, 1), (9, 1), (9, 1))
"""Within the sphere around the body."""
N_COLUMNS = 31
"""Of the grid in which the body is looked for: so many samples along each edge of a cube."""


def body_sphere(views: Sequence[View], overruled: int) -> Sphere | None:
    """A sphere around the body of all views, `overruled` votes against a point not counted; `None` without a body."""
    pitch_mm = 2 * HALF_MM / N_COLUMNS
    axis_mm = pitch_mm * (np.arange(N_COLUMNS) - (N_COLUMNS - 1) / 2)
    x_mm, y_mm = (axis.ravel() for axis in np.meshgrid(axis_mm, axis_mm))
    zeros, ones = np.zeros(len(x_mm)), np.ones(len(x_mm))
    columns = Rays(
        points_mm=np.array([x_mm, y_mm, zeros], np.float32),
        directions=np.array([zeros, zeros, ones], np.float32),
        owners=np.full(len(x_mm), -1),
        px_per_mm=ones,
    )
    values_mm = sampled_mm(field_of(views, overruled), columns, -HALF_MM * ones, HALF_MM * ones, N_COLUMNS)
    sample, column = np.nonzero(values_mm > -pitch_mm * np.sqrt(3) / 2)
    if len(column) == 0:
        return None
    points_mm = np.column_stack([x_mm[column], y_mm[column], axis_mm[sample]])
    low_mm, high_mm = points_mm.min(axis=0), points_mm.max(axis=0)
    return (low_mm + high_mm) / 2, float(np.linalg.norm(high_mm - low_mm) / 2 + pitch_mm)


def clearances_px(
    views: Sequence[View], sphere: Sphere, overruled: int, settled_above_zero: Collection[CameraId] = ()
) -> list[Array]:
    """For each view the clearances (N_RAYS,) of rays along its outline, within a sphere around the body.

    Of the cameras in `settled_above_zero` only clearances below zero are of interest: a ray is left as it is when
    one of its values is not.
    """
    center_mm, radius_mm = sphere
    rays = outline_rays(views, center_mm)
    enough_mm = np.array([0.0 if camera.id in settled_above_zero else np.inf for camera, _ in views])
    reach_mm, field = np.full(len(rays.owners), radius_mm), field_of(views, overruled)
    found_mm = highest_mm(field, rays, -reach_mm, reach_mm, STEPS, enough_mm[rays.owners])
    return of_views(found_mm * rays.px_per_mm, rays, views)


def of_views(values: Array, rays: Rays, views: Sequence[View]) -> list[Array]:
    """The values (R,) of each view's rays."""
    return np.split(values, np.searchsorted(rays.owners, np.arange(1, len(views))))


def outline_rays(views: Sequence[View], center_mm: Array) -> Rays:
    """At most `N_RAYS` rays a view, evenly spread over its outline, as points where they pass `center_mm`."""
    counts = [min(N_RAYS, len(silhouette.outline_uv)) for _, silhouette in views]
    total = sum(counts)
    points_mm, directions = np.empty((2, 3, total), np.float32)
    px_per_mm, first = np.empty(total), 0
    for (camera, silhouette), count in zip(views, counts, strict=True):
        outline_uv, last = silhouette.outline_uv, first + count
        flat = camera.flat_rays(outline_uv[np.arange(count) * len(outline_uv) // max(count, 1)])
        eye_mm = camera.center_mm
        _cast(
            flat, camera.R, eye_mm, center_mm - eye_mm, camera.focal_px,
            points_mm[:, first:last], directions[:, first:last], px_per_mm[first:last],
        )  # fmt: skip
        first = last
    owners = np.repeat(np.arange(len(views)), counts)
    return Rays(points_mm=points_mm, directions=directions, owners=owners, px_per_mm=px_per_mm)


@compiled
def _cast(
    flat: Array,
    R: Array,
    eye_mm: Array,
    to_center_mm: Array,
    focal_px: float,
    points_mm: Single,
    directions: Single,
    px_per_mm: Array,
) -> None:
    """Enter `points_mm`, `directions` and `px_per_mm` of the rays (N, 2) of one camera."""
    for i in range(len(flat)):
        length = np.sqrt(flat[i, 0] * flat[i, 0] + flat[i, 1] * flat[i, 1] + 1)
        along_mm = 0.0
        for axis in range(3):
            direction = (flat[i, 0] * R[0, axis] + flat[i, 1] * R[1, axis] + R[2, axis]) / length
            along_mm += direction * to_center_mm[axis]
            directions[axis, i] = direction
        for axis in range(3):
            direction = (flat[i, 0] * R[0, axis] + flat[i, 1] * R[1, axis] + R[2, axis]) / length
            points_mm[axis, i] = eye_mm[axis] + along_mm * direction
        px_per_mm[i] = focal_px / max(along_mm, 1.0)
