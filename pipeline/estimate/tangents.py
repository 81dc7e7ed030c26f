"""The tangent planes of the body that its outlines give, and the viewing rays that touch it.

The line that touches a silhouette's outline from outside, and the camera's centre, span a plane that touches the body;
the viewing ray through the point of contact touches the body itself. Where on the ray, the other views' planes bound:
the body is on their inner side, so the ray touches on the segment they leave of it. Near *frontier points*, where the
tangent planes of two views coincide, next to nothing is left, and at a corner that several views see the segments
shrink to the corner.

Lengths are relative to a point near the body, so that single precision holds micrometres.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Directions, Flags, Floats, Indices, PointsMM, PointsUV, Values, Vector
from pipeline.compiled import compiled
from pipeline.views.outline_hull import is_edge_seen
from pipeline.views.prepared import PreparedViews
from pipeline.views.sharp_corners import sharpened
from pipeline.views.tangent_planes import clip_lines

N_ANGLES = 60
"""Tangents an outline: one every 6 degrees."""
OUTWARDS = np.array(
    [np.cos(2 * np.pi / N_ANGLES * np.arange(N_ANGLES)), np.sin(2 * np.pi / N_ANGLES * np.arange(N_ANGLES))]
)
"""The directions (2, N_ANGLES) of the image that the tangents' normals have in it."""
SLACK_MM = 0.004
"""Distance by which planes are moved outwards before they cut rays: a tenth of a pixel. Planes that nearly contain
a ray would otherwise cut it anywhere, by the noise of the outlines."""
LEAST_SLOPE = 0.002
"""Sine of the angle between a ray and a plane below which the plane does not end the ray: along a face that two views
see nearly edge-on a hundredth of a millimetre between their planes would move that end by 5 mm and more."""
SEEN_POINTS = 10
"""Points to either side of the one that touches at which the edge must have been seen: closer to a gap it may be the
noise of the outline that has the tangent touch there, and not beyond."""
MAX_OVERLAP_MM = 0.3
"""A ray on which the planes pass each other by more misses the body: its view contradicts others."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tangents:
    """N tangent planes of all views, with the rays on which they touch; points are relative to the centre given.

    The body satisfies `normals @ x <= offsets_mm`, and touches its plane on `points_mm + t directions`
    at some t from `low_mm` to `high_mm`.
    """

    normals: Directions  # (N, 3) outwards
    offsets_mm: Values  # (N,)
    points_mm: PointsMM  # (N, 3) on the ray
    directions: Directions  # (N, 3) away from the camera
    low_mm: Values  # (N,)
    high_mm: Values  # (N,)
    owners: Indices  # (N,) index of the view, in order
    is_seen: Flags  # (N,) whether the edge was seen there: else they are of all that may be body

    @property
    def lengths_mm(self) -> Values:
        """Lengths (N,) of the segments."""
        return self.high_mm - self.low_mm


def find_tangents(views: PreparedViews, center_mm: Vector) -> Tangents:
    """Find the tangents at `N_ANGLES` angles of every view's outline; every view has one.

    Those beside a gap in the outline, and rays that miss the body, are left out.
    """
    cameras, borders = views.cameras, views.borders
    reach, farthest = np.full((len(views), N_ANGLES), -np.inf), np.empty((len(views), N_ANGLES), np.int64)
    _find_farthest(borders.points_uv, borders.ends, OUTWARDS, reach, farthest)
    is_known = is_edge_seen(borders, farthest, SEEN_POINTS)
    owners = np.repeat(np.arange(len(views)), N_ANGLES)
    sigmas_px = np.array([silhouette.edge_sigma_px or 0.0 for silhouette in views.silhouettes])
    corners_uv = sharpened(borders, sigmas_px, farthest)
    normalized = cameras.normalized_coordinates(corners_uv.reshape(-1, 2), owners)
    # distortion bends a plane so little that each tangent's point is among these
    heights = OUTWARDS.T @ normalized.reshape(-1, N_ANGLES, 2).transpose(0, 2, 1)
    best = heights.argmax(axis=2).ravel() + N_ANGLES * owners
    rays, planes = np.ones((2, len(views), N_ANGLES, 3))
    rays[:, :, :2] = normalized[best].reshape(-1, N_ANGLES, 2)
    planes[:, :, :2], planes[:, :, 2] = OUTWARDS.T, -heights.max(axis=2)
    is_known = is_known.ravel()[best].reshape(-1, N_ANGLES)
    R, centers_mm = cameras.R, cameras.centers_mm - center_mm
    normals, directions = (_unit((vectors @ R)[is_known]) for vectors in (planes, rays))
    centers_mm = np.repeat(centers_mm, is_known.sum(axis=1), axis=0)
    offsets_mm = (normals * centers_mm).sum(axis=1)
    points_mm = centers_mm - (directions * centers_mm).sum(axis=1, keepdims=True) * directions
    low_mm, high_mm = segments_mm(normals, offsets_mm, points_mm, directions)
    touching = np.isfinite(high_mm - low_mm) & (high_mm - low_mm > -MAX_OVERLAP_MM)
    tangents = Tangents(
        normals=normals[touching],
        offsets_mm=offsets_mm[touching],
        points_mm=points_mm[touching],
        directions=directions[touching],
        low_mm=low_mm[touching],
        high_mm=high_mm[touching],
        owners=np.repeat(np.arange(len(views)), is_known.sum(axis=1))[touching],
        is_seen=_is_seen(views)[farthest.ravel()[best][is_known.ravel()]][touching],
    )
    _settle(
        tangents.normals,
        tangents.offsets_mm,
        tangents.points_mm,
        tangents.directions,
        tangents.low_mm,
        tangents.high_mm,
    )
    return tangents


def _is_seen(views: PreparedViews) -> Flags:
    """Mark the points (N,) of the views' stacked borders that are on an edge which was seen, and not beside a gap."""
    flags = [np.zeros(0, np.bool_)]
    for seen in views.silhouettes:
        border, outline = (
            np.ascontiguousarray(each).view(complex)[:, 0] for each in (seen.reach_uv, seen.outline_uv)
        )
        is_on: Flags = np.ones(len(border), np.bool_)
        if len(outline) < len(border):
            around = np.isin(border, outline).take(
                np.arange(-SEEN_POINTS, len(border) + SEEN_POINTS), mode="wrap"
            )
            is_on = np.asarray(
                np.lib.stride_tricks.sliding_window_view(around, 2 * SEEN_POINTS + 1).all(axis=1)
            )
        flags.append(is_on)
    return np.concatenate(flags)


@compiled
def _settle(
    normals: Directions,
    offsets_mm: Values,
    points_mm: PointsMM,
    directions: Directions,
    low_mm: Values,
    high_mm: Values,
) -> None:
    """Move rays of which the planes leave nothing, so that they touch below all planes: towards the centre.

    Outlines are rounded where the body has a corner, and more in one view than in another. Then a ray misses what the
    others leave of the body, and half-way between the planes that pass each other it is beside the body.
    """
    for ray in range(len(points_mm)):
        if not high_mm[ray] < low_mm[ray]:
            continue
        t_mm = (low_mm[ray] + high_mm[ray]) / 2
        x = points_mm[ray, 0] + t_mm * directions[ray, 0]
        y = points_mm[ray, 1] + t_mm * directions[ray, 1]
        z = points_mm[ray, 2] + t_mm * directions[ray, 2]
        share = 1.0
        for plane in range(len(normals)):
            height_mm = x * normals[plane, 0] + y * normals[plane, 1] + z * normals[plane, 2]
            reach_mm = offsets_mm[plane] + SLACK_MM
            if height_mm * share > reach_mm > 0:
                share = reach_mm / height_mm
        points_mm[ray, 0], points_mm[ray, 1], points_mm[ray, 2] = share * x, share * y, share * z
        low_mm[ray] = high_mm[ray] = 0.0


@compiled
def _find_farthest(
    points: PointsUV, ends: Indices, outwards: Floats, reach: Floats, farthest: Indices
) -> None:
    """Find the farthest point (V, A) of each outline in each direction (2, A), and its distance along it (V, A).

    In vectors, as the directions are last.
    """
    for view in range(len(reach)):
        for point in range(ends[view], ends[view + 1]):
            u, v = points[point, 0], points[point, 1]
            for angle in range(reach.shape[1]):
                height = u * outwards[0, angle] + v * outwards[1, angle]
                is_farther = height > reach[view, angle]
                reach[view, angle] = height if is_farther else reach[view, angle]
                farthest[view, angle] = point if is_farther else farthest[view, angle]


def _unit(vectors: Floats) -> Directions:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True)))


def segments_mm(
    normals: Directions, offsets_mm: Values, points_mm: PointsMM, directions: Directions
) -> tuple[Values, Values]:
    """Return the ends (N,), (N,) of what all planes leave of each ray; infinite where no plane ends it."""
    low_mm, high_mm = clip_lines(
        normals, offsets_mm + SLACK_MM, np.concatenate([points_mm, directions], axis=1).T, LEAST_SLOPE
    )
    return low_mm, high_mm
