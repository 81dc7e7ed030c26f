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
from pipeline.carving.views import lenses_of, pixel_of
from pipeline.compiled import compiled
from pipeline.rig.camera_arrays import CameraArrays
from pipeline.segmentation.silhouette import FINE_PX, MARGIN_PX, Silhouette

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]

Steps = Sequence[tuple[int, int]]
"""Samples a ray, and how many to either side of the highest the peak is looked for next."""
HALF_MM = 31.0
"""Half the edge of the cube that holds the body."""
MAX_SLOPE = 1.1
"""Most that a value changes on a mm of a ray: 1 on the optical axis."""
BLOCK = 128
"""Rays that are projected at a time."""
OWNER, LOW, HIGH, FIRST, PITCH, ENOUGH, FOUND = 6, 7, 8, 9, 10, 11, 12
"""Columns of `_Search.rays`, after their lines."""
SHIFT, LENS, FOCAL = 9, 12, 22
"""Columns of `Field.cameras`, after the rotation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rays:
    """R viewing rays, or other lines: points of each and unit directions in the world frame."""

    lines: Single  # (6, R) points, then unit directions
    owners: Indices  # (R,) index of the view whose ray it is, which is not asked; -1: all are
    px_per_mm: Array  # (R,) in the owner's image, around its point

    def some(self, which: Indices) -> "Rays":
        return Rays(
            lines=self.lines[:, which],
            owners=self.owners[which],
            px_per_mm=self.px_per_mm[which],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Field:
    """All views, so that they can be asked."""

    cameras: Single  # (V, 23) rotation, shift in mm, lens as in `Pinholes.lenses`, focal length in px
    silhouettes: Sequence[Silhouette]
    overruled: int


def field_of(views: Sequence[View], cameras: CameraArrays, overruled: int) -> Field:
    """The field of the views with `overruled` votes against a point not counted."""
    silhouettes = [silhouette for _, silhouette in views]
    rows = np.column_stack(
        [
            cameras.R.reshape(-1, 9),
            cameras.t_mm,
            lenses_of(cameras.K, cameras.distortion, silhouettes),
            cameras.focals_px,
        ]
    )
    return Field(cameras=rows.astype(np.float32), silhouettes=silhouettes, overruled=overruled)


def highest_mm(
    field: Field, rays: Rays, low_mm: Array, high_mm: Array, steps: Steps, enough_mm: Array
) -> Single:
    """The highest value (R,) of the field from `low_mm` to `high_mm` (R,) on each ray.

    It is sought on ever shorter stretches: where the body touches the ray with a sharp corner the peak is narrow.
    A ray with a value that is enough (R,) is left as it is, and a view that has only such values is not asked again.
    """
    search = _begin(field, rays, low_mm, high_mm, enough_mm)
    for n_samples, reach in steps:
        _narrow(_values_mm(field, search, n_samples), reach, search.rays)
    return search.rays[:, FOUND]


def sampled_mm(field: Field, rays: Rays, low_mm: Array, high_mm: Array, n_samples: int) -> Single:
    """The field (S, R) from `low_mm` to `high_mm` (R,) on each ray, in the middle of equal parts."""
    search = _begin(field, rays, low_mm, high_mm, enough_mm=np.full(len(low_mm), np.inf))
    return _values_mm(field, search, n_samples)


class _Search(NamedTuple):
    """Where a peak is looked for on R rays."""

    rays: Single
    """(R, 13) their lines and owners as in `Rays`, then, in mm along them, from LOW to HIGH, the FIRST sample and the
    PITCH of all; and values in mm: ENOUGH, above which the field is of no interest, and the highest FOUND."""
    asked: list[Indices]  # of each view, rays about which it is asked, if it does not own them


def _begin(field: Field, rays: Rays, low_mm: Array, high_mm: Array, enough_mm: Array) -> _Search:
    of_rays = np.empty((len(low_mm), 13), np.float32)
    of_rays[:, :OWNER], of_rays[:, OWNER], of_rays[:, FOUND] = rays.lines.T, rays.owners, -np.inf
    of_rays[:, LOW], of_rays[:, HIGH], of_rays[:, ENOUGH] = low_mm, high_mm, enough_mm
    return _Search(of_rays, list(np.tile(np.arange(len(low_mm)), (len(field.silhouettes), 1))))


def _values_mm(field: Field, search: _Search, n_samples: int) -> Single:
    """The field (S, R) in the middle of equal parts of each stretch, in the views that are asked.

    Views that can have no value below what is enough are not `asked` again.
    """
    rays, asked = search
    rays[:, PITCH] = (rays[:, HIGH] - rays[:, LOW]) / n_samples
    rays[:, FIRST] = rays[:, LOW] + rays[:, PITCH] / 2
    smallest_mm = np.full((field.overruled + 1, n_samples, len(rays)), np.inf, np.float32)
    for view, silhouette in enumerate(field.silhouettes):
        n_left = _lower(smallest_mm, rays, view, asked[view], field.cameras[view], silhouette.fine_px)
        asked[view] = asked[view][:n_left]
    return smallest_mm[-1]


@compiled
def _narrow(values_mm: Single, reach: int, rays: Single) -> None:
    """Enter the highest values (S, R), and where there may be higher ones, into `_Search.rays`."""
    for ray in range(len(rays)):
        if rays[ray, FOUND] >= rays[ray, ENOUGH]:
            continue
        best = 0
        for sample in range(len(values_mm)):
            if values_mm[sample, ray] > values_mm[best, ray]:
                best = sample
        rays[ray, FOUND] = max(rays[ray, FOUND], values_mm[best, ray])
        peak_mm, reach_mm = rays[ray, FIRST] + best * rays[ray, PITCH], reach * rays[ray, PITCH]
        rays[ray, LOW] = max(peak_mm - reach_mm, rays[ray, LOW])
        rays[ray, HIGH] = min(peak_mm + reach_mm, rays[ray, HIGH])


@compiled
def _lower(
    smallest_mm: Single, rays: Single, view: int, asked: Indices, camera: Single, fine_px: Single
) -> int:
    """Enter a view's values into the smallest so far (K, S, R), in order, on rays (A,) about which it is asked.

    `camera` (23,) is its row of `Field.cameras`. Returns about how many rays it is to be asked again: these are
    moved to the front.
    """
    n_ranks, n_samples = smallest_mm.shape[0], smallest_mm.shape[1]
    height, width = fine_px.shape
    flat_px, beyond_px, per_px = fine_px.reshape(-1), np.float32(-MARGIN_PX), np.float32(1 / FINE_PX)
    zero, last_u, last_v = np.float32(0), np.float32(FINE_PX * width - 1), np.float32(FINE_PX * height - 1)
    lens = (
        camera[LENS], camera[LENS + 1], camera[LENS + 2], camera[LENS + 3], camera[LENS + 4],
        camera[LENS + 5], camera[LENS + 6], camera[LENS + 7], camera[LENS + 8], camera[LENS + 9],
    )  # fmt: skip
    per_focal, most_per_pitch = np.float32(1) / camera[FOCAL], np.float32(MAX_SLOPE / 2)
    block, pixels = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
    samples_mm, steps_mm = np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
    seen, weights = np.empty((2, BLOCK), np.float32), np.empty((2, BLOCK), np.float32)
    values, least_mm = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    place = n_left = 0
    while place < len(asked):
        n = 0
        while n < BLOCK and place < len(asked):
            ray = np.uint64(asked[place])
            block[n] = ray
            n += (rays[ray, FOUND] < rays[ray, ENOUGH]) & (rays[ray, OWNER] != view)
            place += 1
        for i in range(n):
            ray = np.uint64(block[i])
            least_mm[i] = np.inf
            for axis in range(3):
                x, y, z = camera[3 * axis], camera[3 * axis + 1], camera[3 * axis + 2]
                along = x * rays[ray, 3] + y * rays[ray, 4] + z * rays[ray, 5]
                point_mm = x * rays[ray, 0] + y * rays[ray, 1] + z * rays[ray, 2] + camera[SHIFT + axis]
                samples_mm[axis, i] = point_mm + rays[ray, FIRST] * along
                steps_mm[axis, i] = rays[ray, PITCH] * along
        for sample in range(n_samples):
            for i in range(n):
                x, y, z = samples_mm[0, i], samples_mm[1, i], samples_mm[2, i]
                seen[0, i], seen[1, i] = pixel_of(lens, x / z, y / z)
            interpolate(flat_px, height, width, per_px, seen, n, pixels, weights, values)
            for i in range(n):  # not min and max, here and below: these are not put into vectors
                u, v = seen[0, i], seen[1, i]
                is_within = (u >= zero) & (u <= last_u) & (v >= zero) & (v <= last_v)
                value_mm = (values[i] if is_within else beyond_px) * samples_mm[2, i] * per_focal
                values[i] = value_mm
                least_mm[i] = value_mm if value_mm < least_mm[i] else least_mm[i]
                for axis in range(3):
                    samples_mm[axis, i] += steps_mm[axis, i]
            for rank in range(n_ranks):
                for i in range(n):
                    ray = np.uint64(block[i])
                    value, known = values[i], smallest_mm[rank, sample, ray]
                    smallest_mm[rank, sample, ray] = value if value < known else known
                    values[i] = known if value < known else value
        for i in range(n):
            ray = np.uint64(block[i])
            asked[n_left] = block[i]
            n_left += least_mm[i] < rays[ray, ENOUGH] + most_per_pitch * rays[ray, PITCH]
    return n_left
