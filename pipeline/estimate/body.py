"""The most likely body between the largest and a smallest one that explain the silhouettes.

The surface passes through the corners of the inner body, and there its tangent planes are known. Between
corners the inner body has a face. On a body with corners the face is the surface. On a smooth one the
surface bulges: let h_i be the heights of the tangent planes of a face's corners above a point of the face,
and l_i its barycentric coordinates; for any quadratic surface the bulge is exactly sum(l_i h_i) / 2 (above
x, h_i is the bulge and a quadratic form of x - corner i; the weighted mean of these forms is the bulge
again). The share of the bulge that is kept, of what the hull leaves, is how smooth the body is there (`smoothness`).

The hull's vertices are moved along the rays from a common centre. On each ray the map increases strictly,
and it is continuous from ray to ray: it bends space without folding it, so that a closed mesh without
self-intersections stays one. What lies within the inner body, dents for instance, is left as it is.

Where an edge was not seen, tangents are those of all that may be body: the estimate may be too large there, and cuts
nothing off. Of silhouettes that do not say what may be body, those tangents are left out, and the estimate goes on
between what was seen on either side.
"""

from dataclasses import dataclass, field

import numpy as np

from pipeline.arrays import Faces, Flags, PointsMM, Values, Vector
from pipeline.compiled import compiled
from pipeline.estimate.smoothness import bulge_share, smoothness
from pipeline.estimate.surface import InnerSurface, inner_surface
from pipeline.geometry.bounds import bounds
from pipeline.geometry.icosphere import icosphere
from pipeline.meshing import ParticleMesh
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import RADIUS_MM, ball_silhouettes
from pipeline.views.prepared import PreparedViews, prepare_views

PULL = 0.999
"""Share of the way to the estimated surface that points are moved: below 1, or the map would fold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyEstimate:
    """The estimated body, with volume and area of the hull that it is within."""

    mesh: ParticleMesh
    volume_mm3: float
    hull_volume_mm3: float
    hull_area_mm2: float
    corners_mm: PointsMM = field(default_factory=lambda: np.empty((0, 3)))
    """Points (C, 3) where tangent rays touch the body; marching cubes cuts those at its corners."""
    is_seen: Flags = field(default_factory=lambda: np.empty(0, np.bool_))
    """Whether an edge was seen there (C,): else the body may be anywhere below."""
    fallback: str | None = None  # why the estimate is the hull itself


def estimate_body(hull: ParticleMesh, views: PreparedViews) -> BodyEstimate:
    """Move the surface of the visual hull to where the silhouettes that carved it make the body's likeliest.

    When the outlines do not bound an inner body (too few views or seen edges, views that contradict each
    other) the estimate is the hull, and `fallback` says why.
    """
    low_mm, high_mm = bounds(hull.vertices_mm)
    center_mm = (low_mm + high_mm) / 2
    inner = inner_surface(views, center_mm, hull.vertices_mm)
    if isinstance(inner, str):
        unmoved = np.ones(len(hull.vertices_mm))
        volume_mm3, area_mm2, _ = _integrals(hull.vertices_mm, hull.faces, center_mm, unmoved)
        return BodyEstimate(
            mesh=hull,
            volume_mm3=volume_mm3,
            hull_volume_mm3=volume_mm3,
            hull_area_mm2=area_mm2,
            fallback=inner,
        )
    bulge = bulge_share(inner.half_heights, inner.radii)
    vertices_mm, shares = np.empty(hull.vertices_mm.shape), np.empty(len(hull.vertices_mm))
    _pull(hull.vertices_mm, center_mm, inner, bulge, shares, vertices_mm)
    hull_volume_mm3, hull_area_mm2, volume_mm3 = _integrals(hull.vertices_mm, hull.faces, center_mm, shares)
    return BodyEstimate(
        mesh=ParticleMesh(vertices_mm, hull.faces),
        volume_mm3=volume_mm3,
        hull_volume_mm3=hull_volume_mm3,
        hull_area_mm2=hull_area_mm2,
        corners_mm=inner.corners_mm,
        is_seen=inner.is_seen,
    )


def warm_up() -> BodyEstimate:
    """Estimate a made-up ball, which compiles all that the first stone would wait for."""
    rig = nominal_rig()
    directions, faces = icosphere(subdivisions=2)
    hull = ParticleMesh(RADIUS_MM * directions, faces)
    return estimate_body(hull, prepare_views(ball_silhouettes(rig), rig))


@compiled
def _pull(
    points_mm: PointsMM,
    center_mm: Vector,
    inner: InnerSurface,
    bulge: float,
    shares: Values,
    moved_mm: PointsMM,
) -> None:
    """Pull points (N, 3) towards the centre, to the estimated surface: to `shares` (N,) of the way from there."""
    for i in range(len(points_mm)):
        excess = max(1 - inner.radii[i], 0.0)
        kept = smoothness(inner.local_share[i], bulge) * min(inner.half_heights[i], excess)
        shares[i] = 1 - PULL * (excess - kept)
        for k in range(3):
            moved_mm[i, k] = center_mm[k] + shares[i] * (points_mm[i, k] - center_mm[k])


@compiled
def _integrals(
    points_mm: PointsMM, faces: Faces, center_mm: Vector, shares: Values
) -> tuple[float, float, float]:
    """Return volume and area of a closed mesh, and its volume with its points at `shares` of their way from the centre.

    Volumes are those of the tetrahedra of the centre and every face.
    """
    whole = area = pulled = 0.0
    x, y, z = center_mm[0], center_mm[1], center_mm[2]
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = points_mm[a, 0] - x, points_mm[a, 1] - y, points_mm[a, 2] - z
        bx, by, bz = points_mm[b, 0] - x, points_mm[b, 1] - y, points_mm[b, 2] - z
        cx, cy, cz = points_mm[c, 0] - x, points_mm[c, 1] - y, points_mm[c, 2] - z
        nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
        nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        area += np.sqrt(nx * nx + ny * ny + nz * nz)
        sixfold_mm3 = ax * nx + ay * ny + az * nz
        whole += sixfold_mm3
        pulled += sixfold_mm3 * shares[a] * shares[b] * shares[c]
    return whole / 6, area / 2, pulled / 6
