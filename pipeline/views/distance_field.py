"""The signed-distance field of several views, and its maximum along rays.

A view's value at a point is the signed distance of the point's projection to the silhouette's edge, positive within,
in mm at the point's depth. The field of several views is the smallest of their values; with r votes overruled it is
the (r + 1)-th smallest.

Views are evaluated one after the other, so that the distances of one view stay in the cache; all but reading these
runs in vectors, over rays. A view whose values along a ray are all far above what matters is not evaluated there again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from pipeline.arrays import Indices, Singles, Values
from pipeline.compiled import compiled
from pipeline.rig.lens import region_lenses, region_pixel
from pipeline.segmentation.silhouette import FINE_PX, MARGIN_PX, Silhouette
from pipeline.views.interpolation import interpolate
from pipeline.views.prepared import PreparedViews

Lines = Annotated[Singles, "(6, R)"]
"""Lines in the world frame: a point in mm of each, then its unit direction."""
Refinements = Sequence[tuple[int, int]]
"""Samples a ray, and how many of them to either side of the highest the maximum is searched next."""

HALF_EDGE_MM = 31.0
"""Half the edge of the cube, around the rig's centre, that holds the body."""
MAX_SLOPE = 1.1
"""Largest change of a value on a mm of a ray: 1 on the optical axis."""
BLOCK = 128
"""Rays that are projected at a time."""
OWNER, LOW, HIGH, FIRST, PITCH, ENOUGH, FOUND = 6, 7, 8, 9, 10, 11, 12
"""Columns of `_Search.rays`, after their lines."""
SHIFT, LENS, FOCAL = 9, 12, 22
"""Columns of `DistanceField.cameras`, after the rotation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rays:
    """R viewing rays, or other lines."""

    lines: Lines
    owners: Indices  # (R,) index of the view whose ray it is, which is not evaluated; -1: all are
    px_per_mm: Values  # (R,) in the owner's image, around the line's point

    def subset(self, kept: Indices) -> "Rays":
        """Return the rays with these indices."""
        return Rays(
            lines=self.lines[:, kept],
            owners=self.owners[kept],
            px_per_mm=self.px_per_mm[kept],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DistanceField:
    """The field of V views, with `overruled` votes against a point not counted."""

    cameras: Singles  # (V, 23) rotation, shift in mm, `RegionLens`, focal length in px
    silhouettes: Sequence[Silhouette]  # V
    overruled: int


def distance_field(views: PreparedViews, overruled: int) -> DistanceField:
    """Return the field of the views with `overruled` votes against a point not counted."""
    cameras = views.cameras
    offsets_uv = [silhouette.offset_uv for silhouette in views.silhouettes]
    rows = np.column_stack(
        [
            cameras.R.reshape(-1, 9),
            cameras.t_mm,
            region_lenses(cameras.K, cameras.distortion, offsets_uv),
            cameras.focals_px,
        ]
    )
    return DistanceField(cameras=rows.astype(np.float32), silhouettes=views.silhouettes, overruled=overruled)


def maximum_mm(
    field: DistanceField,
    rays: Rays,
    low_mm: Values,
    high_mm: Values,
    refinements: Refinements,
    enough_mm: Values,
) -> Annotated[Singles, "(R,)"]:
    """Return the maximum (R,) of the field from `low_mm` to `high_mm` (R,) along each ray.

    It is searched on ever shorter stretches: where the body touches the ray with a sharp corner the peak is narrow.
    A ray with a value of `enough_mm` (R,) is not refined, and a view that has only such values on it is not evaluated
    again.
    """
    search = _begin(field, rays, low_mm, high_mm, enough_mm)
    for n_samples, reach in refinements:
        _narrow(_values_mm(field, search, n_samples), reach, search.rays)
    return search.rays[:, FOUND]


def sample_mm(
    field: DistanceField, rays: Rays, low_mm: Values, high_mm: Values, n_samples: int
) -> Annotated[Singles, "(S, R)"]:
    """Return the field (S, R) in the middle of S equal stretches from `low_mm` to `high_mm` (R,) of each ray."""
    search = _begin(field, rays, low_mm, high_mm, enough_mm=np.full(len(low_mm), np.inf))
    return _values_mm(field, search, n_samples)


class _Search(NamedTuple):
    """The stretches of R rays on which a maximum is searched."""

    rays: Singles
    """(R, 13) their lines and owners as in `Rays`, then, in mm along them, from LOW to HIGH, the FIRST sample and the
    PITCH of all; and values in mm: ENOUGH, above which the field is of no interest, and the highest FOUND."""
    pending: list[Indices]  # for each view, rays on which it is evaluated unless it owns them


def _begin(field: DistanceField, rays: Rays, low_mm: Values, high_mm: Values, enough_mm: Values) -> _Search:
    rows = np.empty((len(low_mm), 13), np.float32)
    rows[:, :OWNER], rows[:, OWNER], rows[:, FOUND] = rays.lines.T, rays.owners, -np.inf
    rows[:, LOW], rows[:, HIGH], rows[:, ENOUGH] = low_mm, high_mm, enough_mm
    return _Search(rows, list(np.tile(np.arange(len(low_mm)), (len(field.silhouettes), 1))))


def _values_mm(field: DistanceField, search: _Search, n_samples: int) -> Annotated[Singles, "(S, R)"]:
    """Return the field (S, R) in the middle of S equal stretches of each ray, in the views with rays pending.

    A ray on which a view can have no value below what is enough is `pending` for it no more.
    """
    rays, pending = search
    rays[:, PITCH] = (rays[:, HIGH] - rays[:, LOW]) / n_samples
    rays[:, FIRST] = rays[:, LOW] + rays[:, PITCH] / 2
    smallest_mm = np.full((field.overruled + 1, n_samples, len(rays)), np.inf, np.float32)
    for view, silhouette in enumerate(field.silhouettes):
        n_left = _lower(smallest_mm, rays, view, pending[view], field.cameras[view], silhouette.fine_px)
        pending[view] = pending[view][:n_left]
    return smallest_mm[-1]


@compiled
def _narrow(values_mm: Singles, reach: int, rays: Singles) -> None:
    """Enter the highest of the values (S, R), and the stretches that may have higher ones, into `_Search.rays`."""
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
    smallest_mm: Singles, rays: Singles, view: int, pending: Indices, camera: Singles, fine_px: Singles
) -> int:
    """Enter a view's values on its pending rays (A,) into the smallest so far (K, S, R), in ascending order.

    `camera` (23,) is its row of `DistanceField.cameras`. Returns how many rays stay pending: these are moved to the
    front.
    """
    n_ranks, n_samples = smallest_mm.shape[0], smallest_mm.shape[1]
    height, width = fine_px.shape
    flat_px, beyond_px, per_px = fine_px.reshape(-1), np.float32(-MARGIN_PX), np.float32(1 / FINE_PX)
    zero, last_u, last_v = np.float32(0), np.float32(FINE_PX * width - 1), np.float32(FINE_PX * height - 1)
    lens = (
        camera[LENS], camera[LENS + 1], camera[LENS + 2], camera[LENS + 3], camera[LENS + 4],
        camera[LENS + 5], camera[LENS + 6], camera[LENS + 7], camera[LENS + 8], camera[LENS + 9],
    )  # fmt: skip
    per_focal, max_per_pitch = np.float32(1) / camera[FOCAL], np.float32(MAX_SLOPE / 2)
    block, pixels = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32)
    samples_mm, steps_mm = np.empty((3, BLOCK), np.float32), np.empty((3, BLOCK), np.float32)
    seen, weights = np.empty((2, BLOCK), np.float32), np.empty((2, BLOCK), np.float32)
    values, least_mm = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    place = n_left = 0
    while place < len(pending):
        n = 0
        while n < BLOCK and place < len(pending):
            ray = np.uint64(pending[place])
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
                seen[0, i], seen[1, i] = region_pixel(lens, x / z, y / z)
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
            pending[n_left] = block[i]
            n_left += least_mm[i] < rays[ray, ENOUGH] + max_per_pitch * rays[ray, PITCH]
    return n_left
