"""How far the viewing rays along a silhouette's edge pass the body that the other views show.

The clearance of a ray of view k is the highest value along it of the field (`pipeline.views.ray_field`) of the others.
"""

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.geometry.bounds import bounds
from pipeline.rig.camera_arrays import CameraArrays, arrays_of
from pipeline.views.outline_hull import stacked
from pipeline.views.ray_field import HALF_MM, Rays, Steps, field_of, highest_mm, sampled_mm

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]
Sphere = tuple[Array, float]
"""Centre (3,) in the world frame and radius, mm."""

N_RAYS = 64
"""Most rays a view, spread evenly over its outline."""
APART = 6
"""Points of an outline, about a pixel apart, from ray to ray of a small one: closer rays tell the same."""
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
        lines=np.array([x_mm, y_mm, zeros, zeros, zeros, ones], np.float32),
        owners=np.full(len(x_mm), -1),
        px_per_mm=ones,
    )
    field = field_of(views, arrays_of([camera for camera, _ in views]), overruled)
    values_mm = sampled_mm(field, columns, -HALF_MM * ones, HALF_MM * ones, N_COLUMNS)
    sample, column = np.nonzero(values_mm > -pitch_mm * np.sqrt(3) / 2)
    if len(column) == 0:
        return None
    points_mm = np.column_stack([x_mm[column], y_mm[column], axis_mm[sample]])
    low_mm, high_mm = bounds(points_mm)
    return (low_mm + high_mm) / 2, float(np.linalg.norm(high_mm - low_mm) / 2 + pitch_mm)


def clearances_px(
    views: Sequence[View], sphere: Sphere, overruled: int, settled_above_zero: Collection[CameraId] = ()
) -> list[Array]:
    """For each view the clearances (N_RAYS,) of rays along its outline, within a sphere around the body.

    Of the cameras in `settled_above_zero` only clearances below zero are of interest: a ray is left as it is when
    one of its values is not.
    """
    center_mm, radius_mm = sphere
    cameras = arrays_of([camera for camera, _ in views])
    rays = outline_rays(views, cameras, center_mm)
    enough_mm = np.array([0.0 if camera.id in settled_above_zero else np.inf for camera, _ in views])
    reach_mm, field = np.full(len(rays.owners), radius_mm), field_of(views, cameras, overruled)
    found_mm = highest_mm(field, rays, -reach_mm, reach_mm, STEPS, enough_mm[rays.owners])
    return of_views(found_mm * rays.px_per_mm, rays, views)


def of_views(values: Array, rays: Rays, views: Sequence[View]) -> list[Array]:
    """The values (R,) of each view's rays."""
    return np.split(values, np.searchsorted(rays.owners, np.arange(1, len(views))))


def outline_rays(views: Sequence[View], cameras: CameraArrays, center_mm: Array) -> Rays:
    """Rays evenly spread over the views' outlines, as points where they pass `center_mm`."""
    outlines = stacked([silhouette.outline_uv for _, silhouette in views])
    lengths = np.diff(outlines.ends)
    counts = np.minimum(-(-lengths // APART), N_RAYS)
    owners = np.repeat(np.arange(len(views)), counts)
    number = np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]
    points_uv = outlines.points_uv[outlines.ends[owners] + number * lengths[owners] // counts[owners]]
    lines, px_per_mm = np.empty((6, len(owners)), np.float32), np.empty(len(owners))
    flat = cameras.flat_rays(points_uv, owners)
    _cast(flat, owners, cameras.R, cameras.centers_mm, center_mm, cameras.focals_px, lines, px_per_mm)
    return Rays(lines=lines, owners=owners, px_per_mm=px_per_mm)


@compiled
def _cast(
    flat: Array,
    owners: Indices,
    R: Array,
    eyes_mm: Array,
    center_mm: Array,
    focals_px: Array,
    lines: Single,
    px_per_mm: Array,
) -> None:
    """Enter `lines` and `px_per_mm` of the rays (N, 2) of cameras, by their indices (N,)."""
    for i in range(len(flat)):
        at, x, y = owners[i], flat[i, 0], flat[i, 1]
        length = np.sqrt(x * x + y * y + 1)
        along_mm = 0.0
        for axis in range(3):
            direction = (x * R[at, 0, axis] + y * R[at, 1, axis] + R[at, 2, axis]) / length
            along_mm += direction * (center_mm[axis] - eyes_mm[at, axis])
            lines[3 + axis, i] = direction
        for axis in range(3):
            direction = (x * R[at, 0, axis] + y * R[at, 1, axis] + R[at, 2, axis]) / length
            lines[axis, i] = eyes_mm[at, axis] + along_mm * direction
        px_per_mm[i] = focals_px[at] / max(along_mm, 1.0)
