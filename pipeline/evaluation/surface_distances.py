"""Distances between a measured and a true surface, in both directions.

Distances are exact, from points spread evenly over one surface to the triangles of the other. Those from measured to
true say how wrong the measured surface is; those from true to measured also find what it lacks.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pipeline.arrays import Floats, PointsMM, Values

N_SAMPLES = 2_000
"""Points on each surface; spread evenly, they give a mean of distances about 0.1 mm within 1 um."""
MAX_EDGE_SHARE = 0.05
"""Longest edge of the triangles that are searched, relative to the extent of the surface."""
ROUNDING_MM = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceDistances:
    """Distances in mm between a measured and a true surface; positive where the measured one lies outside."""

    mean_mm: float  # measured to true, absolute
    max_mm: float
    signed_mm: float  # measured to true, mean
    back_mean_mm: float  # true to measured, absolute
    back_max_mm: float


def surface_distances(
    measured: trimesh.Trimesh, truth: "Surface", rng: np.random.Generator, n_samples: int = N_SAMPLES
) -> SurfaceDistances:
    """Return the distances at `n_samples` points spread evenly over each surface; the greatest also at all vertices."""
    surface = Surface(measured)
    there_mm = truth.signed_distances_mm(even_samples(measured, n_samples, rng))
    back_mm = surface.signed_distances_mm(even_samples(truth.mesh, n_samples, rng))
    return SurfaceDistances(
        mean_mm=float(np.abs(there_mm).mean()),
        max_mm=max(float(np.abs(there_mm).max()), truth.greatest_distance_mm(measured.vertices)),
        signed_mm=float(there_mm.mean()),
        back_mean_mm=float(np.abs(back_mm).mean()),
        back_max_mm=max(float(np.abs(back_mm).max()), surface.greatest_distance_mm(truth.mesh.vertices)),
    )


def even_samples(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> PointsMM:
    """Return points (n, 3), evenly distributed over the surface: one for each n-th of its area, face after face."""
    area_mm2 = np.cumsum(mesh.area_faces)
    faces = np.searchsorted(area_mm2, (np.arange(n) + rng.uniform()) / n * area_mm2[-1])
    a, b = np.sort(rng.uniform(size=(2, n)), axis=0)
    weights = np.stack([a, b - a, 1 - b], axis=1)
    return np.einsum("ni,nij->nj", weights, np.asarray(mesh.triangles)[faces])


class Surface:
    """A closed mesh that answers distance queries: its triangles, subdivided, and a k-d tree of their centres."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        longest_mm = MAX_EDGE_SHARE * float(np.max(mesh.extents))
        triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
        done: list[tuple[Floats, Floats]] = []
        while len(triangles):
            sides_mm = _lengths(np.roll(triangles, -1, axis=1) - triangles)
            long = sides_mm.max(axis=1) > longest_mm
            done.append((triangles[~long], normals[~long]))
            # halve the longest side: a to b, with c opposite
            k = sides_mm[long].argmax(axis=1)
            a, b, c = (triangles[long][np.arange(len(k)), (k + i) % 3] for i in range(3))
            middle = (a + b) / 2
            triangles = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
            normals = np.concatenate([normals[long], normals[long]])
        self._triangles = np.concatenate([part[0] for part in done])
        self._normals = np.concatenate([part[1] for part in done])
        centers_mm = self._triangles.mean(axis=1)
        self._reach_mm = _lengths(self._triangles - centers_mm[:, None]).max(axis=1)
        self._tree = cKDTree(centers_mm, compact_nodes=False, balanced_tree=False)

    def signed_distances_mm(self, points_mm: PointsMM) -> Values:
        """Return the exact distances (N,) of points (N, 3) to the surface, positive outside."""
        _, first = self._tree.query(points_mm)
        nearest_mm = trimesh.triangles.closest_point(self._triangles[first], points_mm)
        bound_mm = _lengths(points_mm - nearest_mm) + ROUNDING_MM
        # no triangle whose centre is further away can be nearer, whatever its form
        lists = self._tree.query_ball_point(points_mm, bound_mm + self._reach_mm.max())
        triangle = np.concatenate(lists).astype(int)
        point = np.repeat(np.arange(len(points_mm)), [len(entry) for entry in lists])
        apart_mm = _lengths(points_mm[point] - self._tree.data[triangle])
        possible = apart_mm <= bound_mm[point] + self._reach_mm[triangle]
        triangle, point = triangle[possible], point[possible]

        nearest_mm = trimesh.triangles.closest_point(self._triangles[triangle], points_mm[point])
        gaps_mm = points_mm[point] - nearest_mm
        distance_mm = _lengths(gaps_mm)
        height_mm = np.einsum("ij,ij->i", gaps_mm, self._normals[triangle])
        # on a shared edge or corner the face that most faces the point decides on its side
        best = np.lexsort((-np.abs(height_mm), np.round(distance_mm, 9), point))
        best = best[np.unique(point[best], return_index=True)[1]]
        return np.copysign(distance_mm, height_mm)[best]

    def greatest_distance_mm(self, points_mm: PointsMM) -> float:
        """Return the exact greatest distance of any of the points (N, 3) to the surface."""
        apart_mm, first = self._tree.query(points_mm)
        # the distance is at most that to a centre, and less than it by the triangle's reach at most
        may_be_greatest = apart_mm >= apart_mm.max() - self._reach_mm.max()
        points_mm, first = points_mm[may_be_greatest], first[may_be_greatest]
        nearest_mm = trimesh.triangles.closest_point(self._triangles[first], points_mm)
        at_most_mm = _lengths(points_mm - nearest_mm)
        reached_mm = np.abs(self.signed_distances_mm(points_mm[[at_most_mm.argmax()]]))[0]
        points_mm = points_mm[at_most_mm >= reached_mm - ROUNDING_MM]
        return float(np.abs(self.signed_distances_mm(points_mm)).max())


def _lengths(vectors: Floats) -> Floats:
    """Return the lengths of vectors along the last axis; several times as fast as numpy's general norm."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))
