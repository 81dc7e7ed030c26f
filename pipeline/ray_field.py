"""The field that several views make, and the highest it gets along rays.

A view's value at a point is the signed distance of the point's projection to the silhouette's edge, in mm at
the point's depth. The field of several views is the smallest of their values; with r votes overruled it is the
(r + 1)-th smallest.

Views are asked one after the other, so that the distances of one view stay in the cache; all but reading these
runs in vectors, over rays. A view that is far from denying any of a ray is not asked about it again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.carving.interpolation import interpolate
from pipeline.carving.views import Lens, Pinholes, lens_of, pinholes_of, pixel_of
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

Steps = Sequence[tuple[int, int]]
"""Samples a ray, and how many to either side of the highest the peak is looked for next."""
HALF_MM = 31.0
"""Half the edge of the cube that holds the body."""
MAX_SLOPE = 1.1
"""Most that a value changes on a mm of a ray: 1 on the optical axis."""
BLOCK = 128
"""Rays that are projected at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rays:
    """R viewing rays, or other lines: points `points_mm + t directions` in the world frame."""

    points_mm: Single  # (3, R)
    directions: Single  # (3, R) unit
    owners: Indices  # (R,) index of the view whose ray it is, which is not asked; -1: all are
    px_per_mm: Array  # (R,) in the owner's image, around `points_mm`

    def some(self, which: Indices) -> "Rays":
        return Rays(
            points_mm=self.points_mm[:, which],
            directions=self.directions[:, which],
            owners=self.owners[which],
            px_per_mm=self.px_per_mm[which],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """All views, so that they can be asked."""

    pinholes: Pinholes
    silhouettes: Sequence[Silhouette]
    overruled: int


def field_of(views: Sequence[View], overruled: int) -> Field:
    """The field of the views with `overruled` votes against a point not counted."""
    silhouettes = [silhouette for _, silhouette in views]
    return Field(pinholes=pinholes_of(views, 2 * HALF_MM), silhouettes=silhouettes, overruled=overruled)


def highest_mm(
    field: Field, rays: Rays, low_mm: Array, high_mm: Array, steps: Steps, enough_mm: Array
) -> Array:
    """The highest value (R,) of the field from `low_mm` to `high_mm` (R,) on each ray.

    It is sought on ever shorter stretches: where the body touches the ray with a sharp corner the peak is narrow.
    A ray with a value that is enough (R,) is left as it is, and a view that has only such values is not asked again.
    """
    search = _begin(field, rays, low_mm, high_mm, enough_mm)
    found_mm = np.full(len(low_mm), -np.inf)
    for n_samples, reach in steps:
        _narrow(_values_mm(field, search, n_samples), reach, search, found_mm)
    return found_mm


def sampled_mm(field: Field, rays: Rays, low_mm: Array, high_mm: Array, n_samples: int) -> Single:
    """The field (S, R) from `low_mm` to `high_mm` (R,) on each ray, in the middle of equal parts."""
    search = _begin(field, rays, low_mm, high_mm, enough_mm=np.full(len(low_mm), np.inf))
    return _values_mm(field, search, n_samples)


class _Search(NamedTuple):
    """Where a peak is looked for on R rays."""

    lines: Single  # (V, 6, R) the rays' points and directions in the cameras' frames
    is_asked: Flags  # (V, R) views about rays
    low_mm: Array  # (R,) from here on the ray
    high_mm: Array  # (R,) to here
    enough_mm: Array  # (R,) value above which the field is of no interest


def _begin(field: Field, rays: Rays, low_mm: Array, high_mm: Array, enough_mm: Array) -> _Search:
    R, t_mm = field.pinholes.R, field.pinholes.t_mm
    return _Search(
        lines=np.concatenate([R @ rays.points_mm + t_mm[:, :, None], R @ rays.directions], axis=1),
        is_asked=np.arange(len(field.silhouettes))[:, None] != rays.owners,
        low_mm=low_mm.copy(),
        high_mm=high_mm.copy(),
        enough_mm=enough_mm,
    )


def _values_mm(field: Field, search: _Search, n_samples: int) -> Single:
    """The field (S, R) in the middle of equal parts of each stretch, in the views that are asked.

    Views that can have no value below `enough_mm` are struck off `is_asked`.
    """
    smallest_mm = np.full((field.overruled + 1, n_samples, len(search.low_mm)), np.inf, np.float32)
    for view, silhouette in enumerate(field.silhouettes):
        _lower(smallest_mm, search, field.pinholes, view, silhouette.distance_px)
    return smallest_mm[-1]


@compiled
def _narrow(values_mm: Single, reach: int, search: _Search, found_mm: Array) -> None:
    """Enter the highest values (S, R), and where there may be higher ones; nobody is asked where one is enough."""
    low_mm, high_mm = search.low_mm, search.high_mm
    n_samples = len(values_mm)
    for ray in range(len(found_mm)):
        if found_mm[ray] >= search.enough_mm[ray]:
            continue
        best = 0
        for sample in range(n_samples):
            if values_mm[sample, ray] > values_mm[best, ray]:
                best = sample
        found_mm[ray] = max(found_mm[ray], values_mm[best, ray])
        if found_mm[ray] >= search.enough_mm[ray]:
            search.is_asked[:, ray] = False
        pitch_mm = (high_mm[ray] - low_mm[ray]) / n_samples
        peak_mm = low_mm[ray] + (best + 0.5) * pitch_mm
        low_mm[ray] = max(peak_mm - reach * pitch_mm, low_mm[ray])
        high_mm[ray] = min(peak_mm + reach * pitch_mm, high_mm[ray])


@compiled
def _lower(smallest_mm: Single, search: _Search, pinholes: Pinholes, view: int, distance_px: Single) -> None:
    """Enter a view's values into the smallest so far (K, S, R), in order, on rays about which it is asked."""
    n_ranks, n_samples, n_rays = smallest_mm.shape
    height, width = distance_px.shape
    flat_px, beyond_px = distance_px.reshape(-1), np.float32(-MARGIN_PX)
    zero, last_u, last_v = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    lens, focal_px = lens_of(pinholes, view), pinholes.focals_px[view]
    rays = np.empty(BLOCK, np.int64)
    samples_mm, steps_mm = np.zeros((3, BLOCK), np.float32), np.zeros((3, BLOCK), np.float32)
    seen = np.empty((2, BLOCK), np.float32)
    values, least_mm = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    pixels, weights = np.empty(BLOCK, np.int32), np.empty((2, BLOCK), np.float32)
    ray = 0
    while ray < n_rays:
        n = 0
        while n < BLOCK and ray < n_rays:
            rays[n] = ray
            n += search.is_asked[view, ray]
            ray += 1
        _start(search, view, n_samples, rays[:n], samples_mm, steps_mm)
        least_mm[:] = np.inf
        for sample in range(n_samples):
            _project(samples_mm, lens, seen)
            interpolate(flat_px, height, width, np.float32(1), seen, n, pixels, weights, values)
            for i in range(n):  # not min and max, here and below: these are not put into vectors
                u, v = seen[0, i], seen[1, i]
                is_within = (u >= zero) & (u <= last_u) & (v >= zero) & (v <= last_v)
                value_mm = (values[i] if is_within else beyond_px) * samples_mm[2, i] / focal_px
                values[i] = value_mm
                least_mm[i] = value_mm if value_mm < least_mm[i] else least_mm[i]
            for rank in range(n_ranks):
                for i in range(n):
                    at = np.uint64(rays[i])
                    value, known = values[i], smallest_mm[rank, sample, at]
                    smallest_mm[rank, sample, at] = value if value < known else known
                    values[i] = known if value < known else value
            samples_mm += steps_mm
        for i in range(n):
            at = rays[i]
            to_next_mm = (search.high_mm[at] - search.low_mm[at]) / (2 * n_samples)
            search.is_asked[view, at] = least_mm[i] < search.enough_mm[at] + MAX_SLOPE * to_next_mm


@compiled
def _start(
    search: _Search, view: int, n_samples: int, rays: Indices, samples_mm: Single, steps_mm: Single
) -> None:
    """Enter the first samples of some rays (N,), and the steps to the next ones, (3, N) in the camera's frame."""
    lines, low_mm, high_mm = search.lines, search.low_mm, search.high_mm
    for i in range(len(rays)):
        ray = np.uint64(rays[i])
        pitch_mm = np.float32((high_mm[ray] - low_mm[ray]) / n_samples)
        first_mm = np.float32(low_mm[ray]) + np.float32(0.5) * pitch_mm
        for axis in range(3):
            samples_mm[axis, i] = lines[view, axis, ray] + first_mm * lines[view, 3 + axis, ray]
            steps_mm[axis, i] = pitch_mm * lines[view, 3 + axis, ray]


@compiled
def _project(points_mm: Single, lens: Lens, seen: Single) -> None:
    """Region pixels u, v (2, N) of points (3, N) in the camera's frame."""
    for i in range(seen.shape[1]):
        slope_x, slope_y = points_mm[0, i] / points_mm[2, i], points_mm[1, i] / points_mm[2, i]
        seen[0, i], seen[1, i] = pixel_of(lens, slope_x, slope_y)
