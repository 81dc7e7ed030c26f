"""The shifted surface, aligned point by point until its views show the same grey levels there.

Patches find the surface from afar, but of relief that is finer than they are half is lost, since they are flat. From
there on each point of the surface is compared with itself in the views that see it: how far the grey levels differ, and
how much a shift along the normal would change them, say how far the point is off (least squares as in Lucas and Kanade
1981, on the surface instead of an image; cf. Vu et al. 2012, "High accuracy and visibility-consistent dense multiview
stereo", IEEE TPAMI 34 (5)). Neighbours hold one another, as in a membrane.
"""

import cv2
import numpy as np

from pipeline.arrays import Directions, Faces, Floats, Indices32, Mask, PointsMM, Singles, Values
from pipeline.compiled import compiled
from pipeline.refinement.membrane import stretched
from pipeline.refinement.node_field import beyond_chance, facing, flat_gate, mean_curvatures, touch_weights
from pipeline.refinement.nodes import Nodes, interpolated, smoothed, spread_nodes, vertex_normals
from pipeline.refinement.passes import UNLIKE_SHARE
from pipeline.refinement.sightings import COARSE, PhotoViews, cosines_of, depth_maps, project_into, sightings

SPACING_MM = 0.23
"""Spacing of the points on a large stone: from 0.15 to 0.23 the error changes by 2 %, the time by half."""
SPREAD = 0.6
"""Standard deviation of the interpolation between points, in their spacing."""
N_ROUNDS = 2
"""Steps of all points: a third would gain 1 %."""
N_SWEEPS = 6
"""Sweeps of the membrane in each: most points are held by what they show themselves."""
MAP_STEP = 4
"""Step through the points for the depth maps, which are coarser."""
MOST_MM = 0.15
"""Greatest step: grey levels follow a straight line no further than their grain."""
BLUR_PX = 0.8
"""Sigma of the blur of the images, against noise; from 0.5 to 1.2 it makes no difference of 2 %."""
AROUND_PX, VECTOR_PX = 16, 32
"""Pixels around what a view shows for certain that points may reach as they move; and those computed side by side."""
BETWEEN_PIXELS = 1 / 6
"""Variance (px2) by which interpolation between pixels blurs on average."""
MOST_BELOW_MM = 0.03
"""Greatest difference between a place and what its blurred images show: at edges the second order is not enough."""
MAX_VIEWS = 5
"""Views that are compared: with four the error is 3 % larger, with eight it is 1 % smaller."""
WINDOW_ROUNDS = 3
"""Smoothings over neighbours which give the mean grey level around a point, and how much it varies there."""
WHOLE = 0.8
"""Share of the surroundings that a view must see: means of half of them differ from the others' by themselves.

At 0 all surfaces are found 0.007 mm too deep.
"""
LEAST_VARIANCE = 0.02
"""Least variance of a difference, relative to that of the surroundings: no point is certain."""
FULL_EVIDENCE = 2700.0
"""Evidence (1/mm2) that counts as full: that of a point known to 0.02 mm; a third or three times of it loses 2 %."""


def aligned(
    vertices_mm: PointsMM,
    faces: Faces,
    hull_mm: PointsMM,
    touches_mm: PointsMM,
    views: PhotoViews,
    scale: float,
) -> PointsMM:
    """Return the vertices (V, 3) of a closed surface, shifted along its normals to where its views agree.

    None moves further outward than to the hull's vertex (V, 3), nor further inward than it may outward: else of what
    chance does only the inward half would be left, near the hull. Where tangent rays touch, `touches_mm` (T, 3), all
    stay: silhouettes say more there. `scale` shrinks lengths for small stones.
    """
    normals = vertex_normals(vertices_mm, faces)
    order = np.random.default_rng(0).permutation(len(vertices_mm))  # always the same: no pattern, no chance
    nodes = spread_nodes(vertices_mm, normals, scale * SPACING_MM, order)
    touches = touch_weights(nodes.points_mm, touches_mm)
    gate = flat_gate(nodes, touches)
    smooth = smoothed(nodes, nodes.normals, 2)
    nodes = nodes._replace(normals=smooth / np.linalg.norm(smooth, axis=1)[:, None])
    shifts_mm = beyond_chance(_shifts(nodes, gate, touches**4, views), np.ones(len(smooth)), nodes)
    found = interpolated(
        vertices_mm,
        normals,
        nodes,
        np.column_stack([shifts_mm, nodes.normals]),
        np.ones(len(smooth)),
        SPREAD * nodes.spacing_mm,
    )
    along = found[:, 1:] / np.maximum(np.linalg.norm(found[:, 1:], axis=1), 1e-12)[:, None]
    room_mm = np.maximum(np.einsum("vk,vk->v", hull_mm - vertices_mm, along), 0)
    return np.asarray(vertices_mm + np.clip(found[:, 0], -room_mm, room_mm)[:, None] * along)


def _shifts(nodes: Nodes, gate: Values, anchors: Values, views: PhotoViews) -> Values:
    """Return the shifts (K,) outward of all nodes."""
    seen_by, weights = sightings(
        views,
        depth_maps(views, np.ascontiguousarray(nodes.points_mm[::MAP_STEP])),
        nodes.points_mm,
        facing(nodes.points_mm, nodes),
        nodes.spacing_mm / 2,
        MAX_VIEWS,
    )
    shifts_mm = np.zeros(len(nodes.points_mm))
    evidence, pulls = np.zeros((2, len(shifts_mm)))
    below_mm = gate * _below(nodes, seen_by, weights, views)  # not where the surface is sharp, not curved
    for number in range(N_ROUNDS):
        points_mm = nodes.points_mm + (shifts_mm - below_mm)[:, None] * nodes.normals
        greys, slopes = _looked(views, points_mm, nodes.normals, seen_by)
        if number == 0:
            shares, means, variances, alone = _surroundings(greys, nodes, views.noise)
        else:  # means of the round before would hold each point where it was; the rest stays
            means = _means_around(greys, shares, nodes)
        _compare(greys, slopes, seen_by, weights, shares, means, variances, alone, evidence, pulls)
        wanted_mm = shifts_mm - pulls / np.maximum(evidence, 1e-9)
        found_mm = stretched(wanted_mm, gate * evidence / FULL_EVIDENCE, anchors, nodes, N_SWEEPS)
        shifts_mm += np.clip(found_mm - shifts_mm, -MOST_MM, MOST_MM)
    return shifts_mm


def _below(nodes: Nodes, seen_by: Indices32, weights: Singles, views: PhotoViews) -> Values:
    """Return the depth (K,) below each point at which its blurred images show it, where the surface is curved.

    A pixel of an image with blur sigma shows the mean of a neighbourhood, which on a convex surface lies below its
    middle: by sigma^2 times the mean curvature, and more the more the surface is turned away from the view. To second
    order, with the same curvature in all directions: sigma^2 H (1 + tan(angle)^2 / 2).
    """
    depths_mm = views.R[:, 2] @ nodes.points_mm.mean(axis=0) + views.t_mm[:, 2]
    blurs_mm2 = (views.blur_px**2 + BLUR_PX**2 + BETWEEN_PIXELS) * (depths_mm / views.lenses[:, 0]) ** 2
    is_seen, cosines = seen_by >= 0, cosines_of(weights)
    lengths_mm2 = is_seen * blurs_mm2[seen_by] * (1 + 1 / np.where(is_seen, cosines, 1) ** 2) / 2
    means_mm2 = lengths_mm2.sum(axis=1) / np.maximum(is_seen.sum(axis=1), 1)
    curvatures = smoothed(nodes, mean_curvatures(nodes), WINDOW_ROUNDS)
    return np.clip(means_mm2 * curvatures, -MOST_BELOW_MM, MOST_BELOW_MM)


def _surroundings(greys: Singles, nodes: Nodes, noise: Singles) -> tuple[Singles, Singles, Singles, Singles]:
    """Return the share (K, V) of each node's surroundings that a view sees, their mean grey level, and two variances.

    The first is that of the grey levels there, with noise; the second that of the noise alone: of the blurred pixels,
    and by what no two views share.
    """
    shares = smoothed(nodes, (greys >= 0).astype(np.float32), WINDOW_ROUNDS)
    means, squares = (_means_around(each, shares, nodes) for each in (greys, greys * abs(greys)))
    unlike = np.float32(UNLIKE_SHARE) * means
    alone = np.float32(1 / (4 * np.pi * BLUR_PX**2)) * (noise[:, 0] + noise[:, 1] * means) + unlike * unlike
    return shares, means, np.maximum(squares - means * means, 0) + alone, alone


def _means_around(values: Singles, shares: Singles, nodes: Nodes) -> Singles:
    """Return the means (K, V) of what each view sees around a node: values below 0 are not seen."""
    seen: Singles = np.where(values >= 0, values, np.float32(0))
    least: Singles = np.maximum(shares, np.float32(1e-6))
    return smoothed(nodes, seen, WINDOW_ROUNDS) / least


def _looked(
    views: PhotoViews, points_mm: PointsMM, normals: Directions, seen_by: Indices32
) -> tuple[Singles, Singles]:
    """Return the grey level (K, V) of each point in each view, -1 where it is not seen, and its change per mm outward.

    One view is blurred after the other, as far as it shows the stone: all of them blurred are larger than the caches.
    """
    kernel = cv2.getGaussianKernel(5, BLUR_PX)
    greys = np.full((len(points_mm), len(views.regions)), -1, np.float32)
    slopes = np.zeros_like(greys)
    for view, (region, is_inner) in enumerate(zip(views.regions, views.is_inner, strict=True)):
        rows, columns = _window(is_inner, region.shape)
        image = np.asarray(cv2.sepFilter2D(region[rows, columns], cv2.CV_32F, kernel, kernel), np.float32)
        corner = (columns.start, rows.start)
        camera = (views.lenses[view], views.R[view], views.t_mm[view])
        _look(
            image,
            corner,
            *camera,
            points_mm,
            normals,
            seen_by,
            view,
            greys[:, view],
            slopes[:, view],
        )
    return greys, slopes


def _window(is_inner: Mask, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of a region of this size (H, W) in which a view shows points that it sees."""
    window = []
    for flags, n_pixels in zip((is_inner.any(axis=1), is_inner.any(axis=0)), size, strict=True):
        at = np.flatnonzero(flags) if flags.any() else np.zeros(1, np.int64)
        first, last = COARSE * int(at[0]) - AROUND_PX, COARSE * int(at[-1] + 1) + AROUND_PX
        # rounded: where a vector instruction ends, pixels are rounded as in the whole image
        window.append(
            slice(max(first // VECTOR_PX * VECTOR_PX, 0), min(-(-last // VECTOR_PX) * VECTOR_PX, n_pixels))
        )
    return window[0], window[1]


@compiled
def _look(
    image: Singles,
    corner: tuple[int, int],
    lens: Values,
    R: Floats,
    t: Values,
    points_mm: PointsMM,
    normals: Directions,
    seen_by: Indices32,
    view: int,
    greys: Singles,
    slopes: Singles,
) -> None:
    """Fill in what one view shows of the points (K,) that it sees.

    For the change the lens is taken for ideal: distortion makes it wrong by a percent at most.
    """
    height, width = image.shape
    for i in range(len(points_mm)):
        is_seen = False
        for place in range(seen_by.shape[1]):
            is_seen |= seen_by[i, place] == view
        if not is_seen:
            continue
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        u, v, depth = project_into(lens, R, t, x, y, z)
        column, row = int(u), int(v)
        right, below = u - column, v - row
        column, row = column - corner[0], row - corner[1]
        if column < 0 or row < 0 or column > width - 2 or row > height - 2:
            continue
        away = (R[2, 0] * nx + R[2, 1] * ny + R[2, 2] * nz) / depth
        right_mm = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        down_mm = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        u_per_mm = lens[0] * (R[0, 0] * nx + R[0, 1] * ny + R[0, 2] * nz - right_mm * away) / depth
        v_per_mm = lens[3] * (R[1, 0] * nx + R[1, 1] * ny + R[1, 2] * nz - down_mm * away) / depth
        a, b, c, d = (
            image[row, column],
            image[row, column + 1],
            image[row + 1, column],
            image[row + 1, column + 1],
        )
        top, bottom = a + right * (b - a), c + right * (d - c)
        du, dv = (1 - below) * (b - a) + below * (d - c), bottom - top
        greys[i] = top + below * (bottom - top)
        slopes[i] = du * u_per_mm + dv * v_per_mm


@compiled
def _compare(
    greys: Singles,
    slopes: Singles,
    seen_by: Indices32,
    weights: Singles,
    shares: Singles,
    means: Singles,
    variances: Singles,
    noise: Singles,
    evidence: Values,
    pulls: Values,
) -> None:
    """Fill in the normal equation of each point's shift: how its views differ from their mean, and how their slopes do.

    Grey levels count relative to their surroundings in the same view: less the mean, over the deviation.
    """
    most = seen_by.shape[1]
    levels, rises, trusts = np.empty(most), np.empty(most), np.empty(most)
    for i in range(len(greys)):
        evidence[i] = pulls[i] = 0.0
        n, total, level, rise = 0, 0.0, 0.0, 0.0
        for place in range(most):
            view = seen_by[i, place]
            if view < 0:
                break
            whole = (shares[i, view] - WHOLE) / (1 - WHOLE)
            if greys[i, view] < 0 or whole <= 0:
                continue
            deviation, left = np.sqrt(variances[i, view]), noise[i, view] / variances[i, view]
            levels[n] = (greys[i, view] - means[i, view]) / deviation
            rises[n] = slopes[i, view] / deviation
            trusts[n] = weights[i, place] ** 2 * min(whole, 1.0) / (left + LEAST_VARIANCE)
            total += trusts[n]
            level += trusts[n] * levels[n]
            rise += trusts[n] * rises[n]
            n += 1
        if n < 2:
            continue
        for k in range(n):
            apart, steep = levels[k] - level / total, rises[k] - rise / total
            evidence[i] += trusts[k] * steep * steep
            pulls[i] += trusts[k] * steep * apart
