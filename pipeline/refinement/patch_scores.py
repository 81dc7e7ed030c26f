"""Photo-consistency: how alike the views show a patch of the surface, if it lies so deep below a node.

Patches are flat and slanted as the surface is. Their grey levels in two views are compared by the zero-mean normalized
cross-correlation (ZNCC); noise in its denominator keeps patches without texture near zero.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Directions, Floats, Indices32, PointsMM, Singles, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.refinement.passes import N_SAMPLES, NOISE_LEFT, UNLIKE_SHARE, Pass
from pipeline.refinement.sightings import PhotoViews, four_pixels, project_into


def patch_samples(n_samples: int) -> tuple[Values, Values]:
    """Return weight and place (n,) of the samples along an edge of a patch, in half edges from its middle."""
    steps = np.linspace(-1, 1, n_samples)
    return np.exp(-(steps**2)), steps


class Patches(NamedTuple):
    """Square patches of the surface around K nodes, and the views that see each."""

    points_mm: PointsMM  # their centres
    inward: Directions
    axes: Annotated[Floats, "(K, 2, 3)"]  # unit vectors that span them
    half_mm: float  # of their edge
    seen_by: Indices32  # (K, V) numbers of views, -1 beyond the last
    weights: Singles  # (K, V) of these


def patch_scores(
    views: PhotoViews, patches: Patches, depths_mm: Values, each: Pass
) -> Annotated[Singles, "(K, L)"]:
    """Return the score of each patch at each depth along `inward` in a pass: mean ZNCC over pairs of views, 0 to 1.

    Patches without any texture, which are alike as far as one can tell, score `even_score`.
    """
    gains, steps = patch_samples(N_SAMPLES)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = np.outer(gains, gains).ravel()
    unlike2 = np.full((len(views.noise), 1), UNLIKE_SHARE**2)
    noise2 = np.concatenate([NOISE_LEFT[each.scale] * views.noise, unlike2], axis=1)
    scores = np.zeros((len(patches.points_mm), len(depths_mm)), np.float32)
    _score(
        views.regions,
        views.halves,
        views.lenses,
        views.R,
        views.t_mm,
        each.scale,
        patches.points_mm,
        patches.inward,
        patches.axes,
        patches.seen_by,
        patches.weights,
        depths_mm,
        (patches.half_mm * offsets).astype(np.float32),
        (weights / weights.sum()).astype(np.float32),
        noise2.astype(np.float32),
        np.float32(each.even_score),
        scores,
    )
    return scores


@compiled
def _score(
    regions: NDArray[np.uint8],
    halves: Annotated[Indices32, "(V, H / 2, W / 2)"],
    lenses: Floats,
    R: Floats,
    t_mm: PointsMM,
    scale: float,
    points_mm: PointsMM,
    inward: Directions,
    axes: Floats,
    seen_by: Indices32,
    weights: Singles,
    depths_mm: Values,
    offsets_mm: Singles,
    gains: Singles,
    noise2: Singles,
    even_score: np.float32,
    scores: Singles,
) -> None:
    most, n_samples, n_depths = seen_by.shape[1], len(offsets_mm), len(depths_mm)
    is_half = scale != 1
    height, width = halves.shape[1:] if is_half else regions.shape[1:]
    pixels, fours = regions.reshape(len(regions), -1), halves.reshape(len(halves), -1)
    greys = np.empty((most, n_samples, n_depths), np.float32)
    room = _Room(
        np.empty(n_samples * n_depths, np.int32),
        np.empty((2, n_samples * n_depths), np.float32),
        np.empty(n_samples * n_depths, np.int32),
    )
    noises2, inverse_sd = np.empty((2, most, n_depths), np.float32)
    at_u, at_v = np.empty(n_depths, np.float32), np.empty(n_depths, np.float32)
    sums = np.empty(n_depths, np.float32)
    is_used = np.empty(most, np.bool_)
    shift = (1 - scale) / 2  # centres of pixels are on integers in both sizes
    low_mm, high_mm = depths_mm[0], depths_mm[-1]
    middle_mm = (low_mm + high_mm) / 2
    span = max((high_mm - low_mm) / 2, 1e-9)
    corner = offsets_mm[n_samples - 1, 0]
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        dx, dy, dz = inward[i, 0], inward[i, 1], inward[i, 2]
        mx, my, mz = x + middle_mm * dx, y + middle_mm * dy, z + middle_mm * dz
        n_used = 0
        for k in range(most):
            is_used[k] = False
        for k in range(most):
            view = seen_by[i, k]
            if view < 0:
                break
            lens, turn, move = lenses[view], R[view], t_mm[view]
            u1, v1, _ = project_into(lens, turn, move, mx, my, mz)
            u0, v0, _ = project_into(lens, turn, move, x + low_mm * dx, y + low_mm * dy, z + low_mm * dz)
            u2, v2, _ = project_into(lens, turn, move, x + high_mm * dx, y + high_mm * dy, z + high_mm * dz)
            pa, qa, _ = project_into(
                lens, turn, move, mx + axes[i, 0, 0], my + axes[i, 0, 1], mz + axes[i, 0, 2]
            )
            pb, qb, _ = project_into(
                lens, turn, move, mx + axes[i, 1, 0], my + axes[i, 1, 1], mz + axes[i, 1, 2]
            )
            ua, va = np.float32(scale * (pa - u1)), np.float32(scale * (qa - v1))
            ub, vb = np.float32(scale * (pb - u1)), np.float32(scale * (qb - v1))
            reach_u = np.float32(1.5) + (abs(ua) + abs(ub)) * corner
            reach_v = np.float32(1.5) + (abs(va) + abs(vb)) * corner
            low_u = low_v = np.float32(1e9)
            high_u = high_v = np.float32(-1e9)
            for depth in range(n_depths):
                s = (depths_mm[depth] - middle_mm) / span
                at_u[depth] = scale * (u1 + s * (u2 - u0) / 2 + s * s * (u0 + u2 - 2 * u1) / 2) - shift
                at_v[depth] = scale * (v1 + s * (v2 - v0) / 2 + s * s * (v0 + v2 - 2 * v1) / 2) - shift
                low_u, high_u = min(low_u, at_u[depth]), max(high_u, at_u[depth])
                low_v, high_v = min(low_v, at_v[depth]), max(high_v, at_v[depth])
            if (
                low_u < reach_u
                or low_v < reach_v
                or high_u > width - 1 - reach_u
                or high_v > height - 1 - reach_v
            ):
                continue
            is_used[k] = True
            n_used += 1
            _place(width, at_u, at_v, (ua, va, ub, vb), offsets_mm, room)
            if is_half:
                _gather(fours[view], room)
            else:
                _gather_whole(pixels[view], width, room)
            _mix(room, greys[k].reshape(-1))
            _normalize(greys[k], gains, noise2[view], sums, noises2[k], inverse_sd[k])
        if n_used < 2:
            continue
        total_weight = np.float32(0)
        for k in range(most):
            for m in range(k):
                if not (is_used[k] and is_used[m]):
                    continue
                weight = weights[i, k] * weights[i, m]
                total_weight += weight
                one, other = greys[k], greys[m]
                for depth in range(n_depths):
                    sums[depth] = even_score * np.sqrt(noises2[k, depth] * noises2[m, depth])
                for q in range(n_samples):
                    gain = gains[q]
                    for depth in range(n_depths):
                        sums[depth] += gain * one[q, depth] * other[q, depth]
                for depth in range(n_depths):
                    alike = sums[depth] * inverse_sd[k, depth] * inverse_sd[m, depth]
                    scores[i, depth] += weight * max(alike, np.float32(0))
        for depth in range(n_depths):
            scores[i, depth] /= total_weight


class _Room(NamedTuple):
    """Where samples are, and what is read there, for all depths of a patch in a view."""

    places: Indices32  # of the pixel to the upper left
    parts: Singles  # right of it and below it
    corners: Indices32  # grey levels of four pixels, eight bits each


# what computes goes side by side, so what reads pixels one by one is a loop of its own


@compiled_within
def _place(
    width: int,
    at_u: Singles,
    at_v: Singles,
    axes_px: tuple[np.float32, np.float32, np.float32, np.float32],
    offsets_mm: Singles,
    room: _Room,
) -> None:
    """Fill in where the samples of a patch are."""
    n_depths = len(at_u)
    places, rights, belows = room.places, room.parts[0], room.parts[1]
    ua, va, ub, vb = axes_px
    for q in range(len(offsets_mm)):
        du = ua * offsets_mm[q, 0] + ub * offsets_mm[q, 1]
        dv = va * offsets_mm[q, 0] + vb * offsets_mm[q, 1]
        for depth in range(n_depths):
            u, v = at_u[depth] + du, at_v[depth] + dv
            column, row = np.int32(u), np.int32(v)
            at = q * n_depths + depth
            rights[at], belows[at] = u - np.float32(column), v - np.float32(row)
            places[at] = row * np.int32(width) + column


@compiled_within
def _gather(fours: Indices32, room: _Room) -> None:
    """Read the four pixels of each sample, which lie together."""
    places, corners = room.places, room.corners
    for at in range(len(places)):
        corners[at] = fours[np.uint32(places[at])]


@compiled_within
def _gather_whole(pixels: NDArray[np.uint8], width: int, room: _Room) -> None:
    """Read the four pixels of each sample from a whole image."""
    places, corners = room.places, room.corners
    for at in range(len(places)):
        place = np.uint32(places[at])
        below = place + np.uint32(width)
        right, diagonal = place + np.uint32(1), below + np.uint32(1)
        corners[at] = four_pixels(pixels[place], pixels[right], pixels[below], pixels[diagonal])


@compiled_within
def _mix(room: _Room, greys: Singles) -> None:
    """Fill in the grey levels of the samples, bilinear."""
    rights, belows, corners = room.parts[0], room.parts[1], room.corners
    for at in range(len(greys)):
        four = corners[at]
        left, right = np.float32(_pixel(four, 0)), np.float32(_pixel(four, 8))
        above = left + (right - left) * rights[at]
        left, right = np.float32(_pixel(four, 16)), np.float32(_pixel(four, 24))
        below = left + (right - left) * rights[at]
        greys[at] = above + (below - above) * belows[at]


@compiled_within
def _pixel(four: np.int32, bits: int) -> np.int32:
    """Return one of four pixels: as many bits wide as what is computed with it."""
    return np.int32((four >> np.int32(bits)) & np.int32(255))


@compiled_within
def _normalize(
    greys: Singles, gains: Singles, noise2: Singles, sums: Singles, noises2: Singles, inverse_sd: Singles
) -> None:
    """Take the mean from the grey levels (samples, depths); fill in its noise and the inverse of their deviation."""
    n_samples, n_depths = greys.shape
    sums[:] = 0
    for q in range(n_samples):
        gain = gains[q]
        for depth in range(n_depths):
            sums[depth] += gain * greys[q, depth]
    for depth in range(n_depths):
        noises2[depth] = noise2[0] + sums[depth] * (noise2[1] + noise2[2] * sums[depth])
        inverse_sd[depth] = noises2[depth]
    for q in range(n_samples):
        gain = gains[q]
        for depth in range(n_depths):
            greys[q, depth] -= sums[depth]
            inverse_sd[depth] += gain * greys[q, depth] * greys[q, depth]
    for depth in range(n_depths):
        inverse_sd[depth] = np.float32(1) / np.sqrt(inverse_sd[depth])
