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

Where an edge was not seen no tangent is known: the estimate goes on between what was seen on either side, where
the hull swells. With discs of up to half the body's width unknown in any number of views it stayed about as near
to the truth as with all edges seen, and nearer than the hull; nothing was cut off by more than 0.3 mm.
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
    inner = inner_surface(usable_views(silhouettes, rig), center_mm, from_center_mm)
    if isinstance(inner, str):
        hull_volume_mm3, *_ = _volumes_mm3(from_center_mm, hull.faces, np.ones((len(from_center_mm), 2)))
        return BodyEstimate(
            mesh=hull,
            volume_mm3=hull_volume_mm3,
            hull_volume_mm3=hull_volume_mm3,
            inner_volume_mm3=hull_volume_mm3,
            smoothness=0.0,
            fallback=inner,
        )
    radii_mm = np.sqrt(np.einsum("ij,ij->i", from_center_mm, from_center_mm))
    excess_mm = np.maximum(radii_mm - inner.radii_mm, 0)
    smooth = smoothness(inner.local_share, bulge_share(inner.half_heights_mm, excess_mm))
    bulge_mm = smooth * np.minimum(inner.half_heights_mm, excess_mm)
    shares = 1 - np.column_stack([PULL * (excess_mm - bulge_mm), excess_mm]) / radii_mm[:, None]
    hull_volume_mm3, volume_mm3, inner_volume_mm3 = _volumes_mm3(from_center_mm, hull.faces, shares)
    return BodyEstimate(
        mesh=ParticleMesh(center_mm + shares[:, :1] * from_center_mm, hull.faces),
        volume_mm3=volume_mm3,
        hull_volume_mm3=hull_volume_mm3,
        inner_volume_mm3=inner_volume_mm3,
        smoothness=float(smooth.mean()),
    )


@compiled
def _volumes_mm3(points_mm: Array, faces: NDArray[np.int64], shares: Array) -> tuple[float, float, float]:
    """Volumes of three closed meshes around the origin: of points (N, 3), and of `shares[:, 0]` and `[:, 1]` of them.

    Each is that of the tetrahedra of the origin and every face.
    """
    whole = first = second = 0.0
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = points_mm[a, 0], points_mm[a, 1], points_mm[a, 2]
        bx, by, bz = points_mm[b, 0], points_mm[b, 1], points_mm[b, 2]
        cx, cy, cz = points_mm[c, 0], points_mm[c, 1], points_mm[c, 2]
        sixfold_mm3 = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        whole += sixfold_mm3
        first += sixfold_mm3 * shares[a, 0] * shares[b, 0] * shares[c, 0]
        second += sixfold_mm3 * shares[a, 1] * shares[b, 1] * shares[c, 1]
    return whole / 6, first / 6, second / 6
