"""The most likely body between the largest and a smallest one that explain the silhouettes.

The surface passes through the corners of the inner body, and there its tangent planes are known. Between
corners the inner body has a face. Of a body with corners the face is the surface. Of a smooth one the
surface bulges: let h_i be the heights of the tangent planes of a face's corners above a point of the face,
and l_i its barycentric coordinates; for any quadratic surface the bulge is exactly sum(l_i h_i) / 2 (above
x, h_i is the bulge and a quadratic form of x - corner i; the weighted mean of these forms is the bulge
again). How smooth a place is, `smoothness` says; that share of the bulge is kept, of what the hull leaves.

The hull's vertices are moved along the rays from a common centre. On each ray the map increases strictly,
and it is continuous from ray to ray: it bends space without folding it, so that a closed mesh without
self-intersections stays one. What lies within the inner body, dents for instance, is left as it is.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import usable_views
from pipeline.compiled import compiled
from pipeline.estimate.smoothness import bulge_share, smoothness
from pipeline.estimate.surface import inner_surface
from pipeline.frames import CameraId
from pipeline.meshing import ParticleMesh
from pipeline.rig import RigCalibration
from pipeline.segmentation.silhouette import Silhouette

Array = NDArray[np.float64]

PULL = 0.999
"""Share of the way to the estimated surface: below 1, or the map would fold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyEstimate:
    """The estimate, and how far it is from the bodies on either side of it."""

    mesh: ParticleMesh
    volume_mm3: float
    hull_volume_mm3: float
    inner_volume_mm3: float  # of the hull when all its vertices are moved to the inner body
    smoothness: float  # mean over the hull's vertices: 0 of a body with corners, 1 of a smooth one
    fallback: str | None = None  # why the estimate is the hull itself

    @property
    def gap(self) -> float:
        """Share of the hull's volume that lies outside of the inner body, 0..1."""
        return 1 - self.inner_volume_mm3 / self.hull_volume_mm3


def estimate_body(
    hull: ParticleMesh, silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration
) -> BodyEstimate:
    """Move the surface of the visual hull to where the same silhouettes make the body's likeliest.

    When the outlines do not bound an inner body (too few views or seen edges, views at odds with each
    other) the estimate is the hull, and `fallback` says why.

    Raises
    ------
    ValueError
        A silhouette of a camera that the rig does not know.
    """
    center_mm = np.array([(column.min() + column.max()) / 2 for column in hull.vertices_mm.T])
    from_center_mm = hull.vertices_mm - center_mm
    hull_volume_mm3 = _volume_mm3(from_center_mm, hull.faces)
    inner = inner_surface(usable_views(silhouettes, rig), center_mm, from_center_mm)
    if isinstance(inner, str):
        return BodyEstimate(
            mesh=hull,
            volume_mm3=hull_volume_mm3,
            hull_volume_mm3=hull_volume_mm3,
            inner_volume_mm3=hull_volume_mm3,
            smoothness=0.0,
            fallback=inner,
        )
    radii_mm = np.linalg.norm(from_center_mm, axis=1)
    excess_mm = np.maximum(radii_mm - inner.radii_mm, 0)
    smooth = smoothness(inner.local_share, bulge_share(inner.half_heights_mm, excess_mm))
    bulge_mm = smooth * np.minimum(inner.half_heights_mm, excess_mm)
    moved_mm = (1 - PULL * (excess_mm - bulge_mm) / radii_mm)[:, None] * from_center_mm
    innermost_mm = (1 - excess_mm / radii_mm)[:, None] * from_center_mm
    return BodyEstimate(
        mesh=ParticleMesh(center_mm + moved_mm, hull.faces),
        volume_mm3=_volume_mm3(moved_mm, hull.faces),
        hull_volume_mm3=hull_volume_mm3,
        inner_volume_mm3=_volume_mm3(innermost_mm, hull.faces),
        smoothness=float(smooth.mean()),
    )


@compiled
def _volume_mm3(points_mm: Array, faces: NDArray[np.int64]) -> float:
    """Volume of a closed mesh around the origin: the tetrahedra of the origin and each face."""
    sixfold_mm3 = 0.0
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = points_mm[a, 0], points_mm[a, 1], points_mm[a, 2]
        bx, by, bz = points_mm[b, 0], points_mm[b, 1], points_mm[b, 2]
        cx, cy, cz = points_mm[c, 0], points_mm[c, 1], points_mm[c, 2]
        sixfold_mm3 += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return sixfold_mm3 / 6
