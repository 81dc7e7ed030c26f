"""How far the viewing rays along a silhouette's edge pass the body that the other views show.

A view's value at a point is the signed distance of the point's projection to the silhouette's edge, in mm at
the point's depth. The field of several views is the smallest of their values; with r votes overruled it is the
(r + 1)-th smallest. The clearance of a ray of view k is the highest value along it of the field of the others.

Views are asked one after the other, each for the samples of all rays that are left, so that the distances of
one view stay in the cache; and rows of samples are asked in loops without branches: a point at a time takes
ten times as long.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.carving.views import pixel_of
from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.segmentation.silhouette import MARGIN_PX

Array = NDArray[np.float64]
Sphere = tuple[Array, float]
"""Centre (3,) in the world frame and radius, mm."""

N_RAYS = 64
"""Rays a view, spread evenly over its outline."""
STEPS = (40, 9, 9)
"""Samples a ray within the sphere around the body, then around the highest of the last ones."""
ROUNDING_MM = 1e-3
HOPELESS_MM = -0.5
"""Samples that far outside are given up first; only where a ray has no better ones are they taken up again."""
PITCH_MM, HALF_MM = 2.0, 30.0
"""Of the grid in which the body is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """R rows of samples in the world frame, sample i of each at `starts_mm + i steps_mm`."""

    starts_mm: Array  # (R, 3)
    steps_mm: Array  # (R, 3)
    owners: NDArray[np.int64]  # (R,) index of the view that is not asked; -1: all are

    def some(self, which: NDArray[np.bool_]) -> "_Rows":
        return _Rows(
            starts_mm=self.starts_mm[which], steps_mm=self.steps_mm[which], owners=self.owners[which]
        )


def body_sphere(views: Sequence[View], overruled: int) -> Sphere | None:
    """A sphere around the body of all views, `overruled` votes against a point not counted; `None` without a body."""
    axis_mm = np.arange(-HALF_MM, HALF_MM + PITCH_MM / 2, PITCH_MM)
    grid_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm[:1], indexing="ij"), axis=-1).reshape(-1, 3)
    rows = _Rows(
        starts_mm=grid_mm,
        steps_mm=np.tile([0.0, 0.0, PITCH_MM], (len(grid_mm), 1)),
        owners=np.full(len(grid_mm), -1),
    )
    least_mm = np.full(len(grid_mm), -PITCH_MM * np.sqrt(3) / 2)
    row, sample = np.nonzero(_field_mm(views, rows, len(axis_mm), least_mm, overruled) > least_mm[0])
    if len(row) == 0:
        return None
    points_mm = np.column_stack([grid_mm[row, :2], axis_mm[sample]])
    low_mm, high_mm = points_mm.min(axis=0), points_mm.max(axis=0)
    return (low_mm + high_mm) / 2, float(np.linalg.norm(high_mm - low_mm) / 2 + PITCH_MM)


def clearances_px(
    views: Sequence[View], sphere: Sphere, overruled: int, settled_above_zero: Collection[CameraId] = ()
) -> list[Array]:
    """For each view the clearances (N_RAYS,) of rays along its outline, within a sphere around the body.

    The highest value along a ray is sought on ever shorter stretches: where the body touches the ray
    with a sharp corner the peak is narrow. Of the cameras in `settled_above_zero` only clearances below zero
    are of interest: a ray is left as it is when one of its values is not.
    """
    center_mm, radius_mm = sphere
    chosen_uv = [_spread(silhouette.outline_uv) for _, silhouette in views]
    owners = np.repeat(np.arange(len(views)), [len(chosen) for chosen in chosen_uv])
    eyes_mm = np.array([camera.center_mm for camera, _ in views])[owners]
    directions = np.concatenate([camera.rays(uv) for (camera, _), uv in zip(views, chosen_uv, strict=True)])
    enough_mm = np.array([0.0 if camera.id in settled_above_zero else np.inf for camera, _ in views])[owners]
    closest_mm = ((center_mm - eyes_mm) * directions).sum(axis=1)
    peak_mm, highest_mm = closest_mm.copy(), np.full(len(owners), -np.inf)
    open_ones, reach_mm = np.arange(len(owners)), radius_mm
    for steps in STEPS:
        pitch_mm = 2 * reach_mm / (steps - 1)
        start_mm = peak_mm[open_ones] - reach_mm
        rows = _Rows(
            starts_mm=eyes_mm[open_ones] + start_mm[:, None] * directions[open_ones],
            steps_mm=pitch_mm * directions[open_ones],
            owners=owners[open_ones],
        )
        best, highest_mm[open_ones] = _highest(views, rows, steps, highest_mm[open_ones], overruled)
        peak_mm[open_ones] = start_mm + best * pitch_mm
        open_ones = open_ones[highest_mm[open_ones] < enough_mm[open_ones]]
        reach_mm = pitch_mm
    focal_px = np.array([camera.focal_px for camera, _ in views])[owners]
    found_px = highest_mm * focal_px / np.maximum(closest_mm, 1.0)
    return [found_px[owners == view] for view in range(len(views))]


def _spread(outline_uv: Array) -> Array:
    """At most `N_RAYS` points, evenly spread over an outline (N, 2)."""
    n = len(outline_uv)
    return outline_uv[np.linspace(0, n, min(N_RAYS, n), endpoint=False).astype(int)]


def _highest(
    views: Sequence[View], rows: _Rows, n_samples: int, known_mm: Array, overruled: int
) -> tuple[NDArray[np.int64], Array]:
    """Which sample (R,) of each row is highest in the field, and its value; no lower than is known (R,) of the row."""
    above_mm = np.where(np.isneginf(known_mm), HOPELESS_MM, known_mm - ROUNDING_MM)
    field_mm = _field_mm(views, rows, n_samples, above_mm, overruled)
    hopeless = np.asarray(np.isneginf(field_mm).all(axis=1))
    if hopeless.any():
        nothing_mm = np.full(hopeless.sum(), -np.inf)
        field_mm[hopeless] = _field_mm(views, rows.some(hopeless), n_samples, nothing_mm, overruled)
    best = field_mm.argmax(axis=1)
    return best, field_mm[np.arange(len(best)), best]


def _field_mm(views: Sequence[View], rows: _Rows, n_samples: int, above_mm: Array, overruled: int) -> Array:
    """The field (R, S) of the views that do not own the row; minus infinity where it is not above `above_mm` (R,)."""
    smallest_mm = np.full((len(rows.owners), overruled + 1, n_samples), np.inf)
    left = np.tile([0, n_samples], (len(rows.owners), 1))
    for index, (camera, silhouette) in enumerate(views):
        K, offset_uv = camera.K, silhouette.offset_uv
        _ask(
            camera.R,
            camera.t_mm,
            (K[0, 0], K[0, 1], K[0, 2] - offset_uv[0], K[1, 1], K[1, 2] - offset_uv[1], *camera.distortion),
            camera.focal_px,
            silhouette.distance_px,
            rows.starts_mm,
            rows.steps_mm,
            rows.owners == index,
            above_mm,
            smallest_mm,
            left,
        )
    return _left_of(smallest_mm, left)


@compiled
def _ask(
    R: Array,
    t_mm: Array,
    lens: tuple[float, ...],
    focal_px: float,
    image: NDArray[np.float32],
    starts_mm: Array,
    steps_mm: Array,
    is_own: NDArray[np.bool_],
    above_mm: Array,
    smallest_mm: Array,
    left: NDArray[np.int64],
) -> None:
    """Enter one view's values into the smallest so far (R, overruled + 1, S).

    Only samples from `left[row, 0]` to before `left[row, 1]` are asked, and what is no longer above `above_mm`
    (R,) at either end is left out.
    """
    height, width = image.shape
    n_ranks, n_samples = smallest_mm.shape[1:]
    u, v, mm_per_px, values_mm = np.empty((4, n_samples))
    for row in range(len(starts_mm)):
        first, last = left[row, 0], left[row, 1]
        if is_own[row] or first == last:
            continue
        x0, y0, z0 = _turned(R, starts_mm[row, 0], starts_mm[row, 1], starts_mm[row, 2])
        x0, y0, z0 = x0 + t_mm[0], y0 + t_mm[1], z0 + t_mm[2]
        dx, dy, dz = _turned(R, steps_mm[row, 0], steps_mm[row, 1], steps_mm[row, 2])
        for sample in range(first, last):
            depth_mm = z0 + sample * dz
            x, y = (x0 + sample * dx) / depth_mm, (y0 + sample * dy) / depth_mm
            u[sample], v[sample] = pixel_of(lens, x, y)
            mm_per_px[sample] = depth_mm / focal_px
        for sample in range(first, last):
            is_seen = (u[sample] >= 0) & (u[sample] < width - 1) & (v[sample] >= 0) & (v[sample] < height - 1)
            column = np.uint64(u[sample] if is_seen else 0.0)
            line = np.uint64(v[sample] if is_seen else 0.0)
            right, down = u[sample] - column, v[sample] - line
            next_column, next_line = column + np.uint64(1), line + np.uint64(1)
            upper = (1 - right) * image[line, column] + right * image[line, next_column]
            lower = (1 - right) * image[next_line, column] + right * image[next_line, next_column]
            value_px = (1 - down) * upper + down * lower if is_seen else -MARGIN_PX
            values_mm[sample] = value_px * mm_per_px[sample]
        for rank in range(n_ranks):
            for sample in range(first, last):
                known_mm, value_mm = smallest_mm[row, rank, sample], values_mm[sample]
                smallest_mm[row, rank, sample] = min(known_mm, value_mm)
                values_mm[sample] = max(known_mm, value_mm)
        while first < last and smallest_mm[row, -1, first] <= above_mm[row]:
            first += 1
        while first < last and smallest_mm[row, -1, last - 1] <= above_mm[row]:
            last -= 1
        left[row, 0], left[row, 1] = first, last


@compiled
def _turned(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


def _left_of(smallest_mm: Array, left: NDArray[np.int64]) -> Array:
    """The values (R, S) of the highest rank within `left` (R, 2), minus infinity elsewhere."""
    sample = np.arange(smallest_mm.shape[2])
    is_left = (sample >= left[:, :1]) & (sample < left[:, 1:])
    return np.where(is_left, smallest_mm[:, -1], -np.inf)
