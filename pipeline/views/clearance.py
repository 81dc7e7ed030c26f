"""The clearance of the viewing rays along a silhouette's edge from the body that the other views show.

The clearance of a ray of view k is the maximum along it of the distance field (`pipeline.views.distance_field`) of the
other views: below zero where the ray misses what they show.
"""

from collections.abc import Collection

import numpy as np

from pipeline.arrays import Floats, Indices, PointsMM, PointsUV, Values, Vector
from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.geometry.bounds import bounds
from pipeline.views.distance_field import (
    HALF_EDGE_MM,
    DistanceField,
    Lines,
    Rays,
    Refinements,
    maximum_mm,
    sample_mm,
)
from pipeline.views.prepared import PreparedViews

Sphere = tuple[Vector, float]
"""Centre in the world frame and radius, mm."""

MAX_RAYS = 64
"""Most rays a view, spread evenly over its outline."""
RAY_SPACING = 6
"""Points of an outline, about a pixel apart, from ray to ray of a small one: closer rays tell the same."""
REFINEMENTS: Refinements = ((40, 1), (9, 1), (9, 1))
"""Search within the sphere around the body."""
N_COLUMNS = 31
"""Samples along each edge of the grid in which the body is searched."""


def body_sphere(field: DistanceField) -> Sphere | None:
    """Return a sphere around the body that the field shows; `None` where it shows none."""
    pitch_mm = 2 * HALF_EDGE_MM / N_COLUMNS
    axis_mm = pitch_mm * (np.arange(N_COLUMNS) - (N_COLUMNS - 1) / 2)
    x_mm, y_mm = (axis.ravel() for axis in np.meshgrid(axis_mm, axis_mm))
    zeros, ones = np.zeros(len(x_mm)), np.ones(len(x_mm))
    columns = Rays(
        lines=np.array([x_mm, y_mm, zeros, zeros, zeros, ones], np.float32),
        owners=np.full(len(x_mm), -1),
        px_per_mm=ones,
    )
    values_mm = sample_mm(field, columns, -HALF_EDGE_MM * ones, HALF_EDGE_MM * ones, N_COLUMNS)
    sample, column = np.nonzero(values_mm > -pitch_mm * np.sqrt(3) / 2)
    if len(column) == 0:
        return None
    points_mm = np.column_stack([x_mm[column], y_mm[column], axis_mm[sample]])
    low_mm, high_mm = bounds(points_mm)
    return (low_mm + high_mm) / 2, float(np.linalg.norm(high_mm - low_mm) / 2 + pitch_mm)


def clearances_px(
    views: PreparedViews,
    field: DistanceField,
    sphere: Sphere,
    settled_above_zero: Collection[CameraId] = (),
) -> list[Values]:
    """Return for each view the clearances (R,) of rays along its outline, within a sphere around the body.

    `field` is that of the views. For cameras in `settled_above_zero` only clearances below zero are exact: a ray is
    not refined once a value on it is above.
    """
    center_mm, radius_mm = sphere
    rays = outline_rays(views, center_mm)
    enough_mm = np.array([0.0 if camera in settled_above_zero else np.inf for camera in views.camera_ids])
    reach_mm = np.full(len(rays.owners), radius_mm)
    found_mm = maximum_mm(field, rays, -reach_mm, reach_mm, REFINEMENTS, enough_mm[rays.owners])
    return split_by_view(found_mm * rays.px_per_mm, rays, len(views))


def split_by_view(values: Values, rays: Rays, n_views: int) -> list[Values]:
    """Split values (R,) of the rays into those of each view."""
    return np.split(values, np.searchsorted(rays.owners, np.arange(1, n_views)))


def outline_rays(views: PreparedViews, center_mm: Vector) -> Rays:
    """Return rays evenly spread over the views' outlines, as points where they pass `center_mm`."""
    cameras, outlines = views.cameras, views.outlines
    lengths = outlines.lengths
    counts = np.minimum(-(-lengths // RAY_SPACING), MAX_RAYS)
    owners = np.repeat(np.arange(len(views)), counts)
    number = np.arange(len(owners)) - (np.cumsum(counts) - counts)[owners]
    points_uv = outlines.points_uv[outlines.ends[owners] + number * lengths[owners] // counts[owners]]
    lines, px_per_mm = np.empty((6, len(owners)), np.float32), np.empty(len(owners))
    normalized = cameras.normalized_coordinates(points_uv, owners)
    _cast_rays(
        normalized, owners, cameras.R, cameras.centers_mm, center_mm, cameras.focals_px, lines, px_per_mm
    )
    return Rays(lines=lines, owners=owners, px_per_mm=px_per_mm)


@compiled
def _cast_rays(
    normalized: PointsUV,
    owners: Indices,
    R: Floats,
    centers_mm: PointsMM,
    passed_mm: Vector,
    focals_px: Values,
    lines: Lines,
    px_per_mm: Values,
) -> None:
    """Fill in `lines` and `px_per_mm` of rays with these normalized coordinates (N, 2) in their owners' cameras (V)."""
    for i in range(len(normalized)):
        at, x, y = owners[i], normalized[i, 0], normalized[i, 1]
        length = np.sqrt(x * x + y * y + 1)
        along_mm = 0.0
        for axis in range(3):
            direction = (x * R[at, 0, axis] + y * R[at, 1, axis] + R[at, 2, axis]) / length
            along_mm += direction * (passed_mm[axis] - centers_mm[at, axis])
            lines[3 + axis, i] = direction
        for axis in range(3):
            direction = (x * R[at, 0, axis] + y * R[at, 1, axis] + R[at, 2, axis]) / length
            lines[axis, i] = centers_mm[at, axis] + along_mm * direction
        px_per_mm[i] = focals_px[at] / max(along_mm, 1.0)
