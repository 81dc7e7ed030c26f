"""The best any silhouette method can do: the exact visual hull of a known body, and distances to it.

No voxels, no images and nothing of the pipeline's carving: a body's silhouette in a camera is a cone of
rays from the camera's centre, whatever lens and sensor draw it (distortion moves pixels, not rays). So
the hull is the intersection of the cones around the body from the camera centres alone.
"""

import numpy as np
import scipy.spatial
import trimesh
from numpy.typing import NDArray

from pipeline.rig import RigCalibration

Array = NDArray[np.float64]

N_ANGLES = 8192
"""Angles of an outline; a corner of a silhouette is met within 0.4 thousandths of its radius."""
MAX_EDGE_SHARE = 0.05
"""Longest edge of the triangles that are searched, relative to the extent of the true surface."""


def exact_hull_mesh(
    body: trimesh.Trimesh, center_mm: Array, rig: RigCalibration, subdivisions: int = 6
) -> trimesh.Trimesh:
    """Visual hull, in the world frame, of a closed body seen by all cameras of the rig.

    The body must be star-shaped about `center_mm` (3,): then its silhouettes and its hull are, and the
    hull's radius along each of 10 * 4^subdivisions + 2 directions is the least of the cones' radii.
    """
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    directions = np.asarray(sphere.vertices)
    radii_mm = np.min(
        [cone_radii_mm(body, center_mm, camera.center_mm, directions) for camera in rig.cameras], axis=0
    )
    if not np.isfinite(radii_mm).all():
        raise ValueError("the cameras leave the hull open")
    return trimesh.Trimesh(center_mm + radii_mm[:, None] * directions, sphere.faces, process=False)


def cone_radii_mm(body: trimesh.Trimesh, center_mm: Array, camera_mm: Array, directions: Array) -> Array:
    """Distances (N,) from the centre along unit directions (N, 3) to the cone of the body's silhouette.

    In the plane at distance 1 normal to the line from the camera to the centre, `center + r u` lies at
    the polar angle of u and the radius r sin(psi) / (d + r cos(psi)), psi between u and the line.
    """
    axis = center_mm - camera_mm
    distance_mm = np.linalg.norm(axis)
    axis = axis / distance_mm
    right, down = np.linalg.svd(axis[None])[2][1:]
    rho = polar_outline(_plane(_silhouette_edges(body, camera_mm) - camera_mm, axis, right, down))

    along, x, y = directions @ axis, directions @ right, directions @ down
    angle = np.mod(np.arctan2(y, x), 2 * np.pi)
    limit = np.interp(angle, np.arange(N_ANGLES + 1) * (2 * np.pi / N_ANGLES), np.append(rho, rho[0]))
    opening = np.hypot(x, y) - limit * along
    with np.errstate(divide="ignore"):
        return np.where(opening > 0, limit * distance_mm / opening, np.inf)


def _silhouette_edges(body: trimesh.Trimesh, camera_mm: Array) -> Array:
    """End points (E, 2, 3) of the edges between a face that looks at the camera and one that does not."""
    towards = np.einsum("ij,ij->i", body.face_normals, camera_mm - body.triangles_center) > 0
    first, second = body.face_adjacency.T
    return np.asarray(body.vertices[body.face_adjacency_edges[towards[first] != towards[second]]])


def _plane(points: Array, axis: Array, right: Array, down: Array) -> Array:
    """Coordinates (..., 2) in the plane at distance 1 of points (..., 3) relative to the camera."""
    return np.stack([points @ right, points @ down], axis=-1) / (points @ axis)[..., None]


def polar_outline(segments: Array) -> Array:
    """Greatest radius at which segments (E, 2, 2) meet the ray at each of `N_ANGLES` angles from 0."""
    a, b = segments[:, 0], segments[:, 1]
    turn = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    a, b = np.where(turn[:, None] < 0, b, a), np.where(turn[:, None] < 0, a, b)  # all turn to the left
    step = 2 * np.pi / N_ANGLES
    start = np.arctan2(a[:, 1], a[:, 0])
    sweep = np.mod(np.arctan2(b[:, 1], b[:, 0]) - start, 2 * np.pi)
    first = np.ceil(start / step).astype(int)
    n_met = np.maximum(np.floor((start + sweep) / step).astype(int) - first + 1, 0)

    edge = np.repeat(np.arange(len(a)), n_met)
    position = np.arange(n_met.sum()) - np.repeat(np.cumsum(n_met) - n_met, n_met)
    index = first[edge] + position
    angle = index * step
    side = (b - a)[edge]
    across = np.cos(angle) * side[:, 1] - np.sin(angle) * side[:, 0]
    met = across > 0
    outline = np.zeros(N_ANGLES)
    np.maximum.at(outline, index[met] % N_ANGLES, np.abs(turn)[edge][met] / across[met])
    if not (outline > 0).all():
        raise ValueError("the centre lies outside the silhouette")
    return outline


def surface_distance(
    mesh: trimesh.Trimesh,
    truth: trimesh.Trimesh,
    n_samples: int,
    rng: np.random.Generator,
    *,
    align: bool = False,
) -> tuple[float, float, float]:
    """Mean absolute, greatest absolute and mean signed distance in mm of a mesh's surface to the true one.

    Over area-uniform samples of `mesh`; positive outside `truth`. With `align` the samples are first
    moved rigidly onto the true surface, as a comparison of clouds without a common frame would.
    """
    points = _samples(mesh, n_samples, rng)
    surface = _Surface(truth)
    for _ in range(8 if align else 0):
        nearest, normals, _ = surface.nearest(points)
        middle = points.mean(axis=0)
        rows = np.hstack([np.cross(points - middle, normals), normals])
        gap = np.einsum("ij,ij->i", nearest - points, normals)
        move = np.linalg.lstsq(rows, gap, rcond=1e-6)[0]
        turn = scipy.spatial.transform.Rotation.from_rotvec(move[:3])
        points = turn.apply(points - middle) + middle + move[3:]
    signed_mm = surface.nearest(points)[2]
    return float(np.abs(signed_mm).mean()), float(np.abs(signed_mm).max()), float(signed_mm.mean())


def _samples(mesh: trimesh.Trimesh, n: int, rng: np.random.Generator) -> Array:
    """Points (n, 3), evenly distributed over the surface."""
    faces = rng.choice(len(mesh.faces), size=n, p=mesh.area_faces / mesh.area_faces.sum())
    a, b = np.sort(rng.uniform(size=(2, n)), axis=0)
    weights = np.stack([a, b - a, 1 - b], axis=1)
    return np.einsum("ni,nij->nj", weights, np.asarray(mesh.triangles)[faces])


class _Surface:
    """A mesh's triangles, cut small, with a tree of their centres."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        longest_mm = MAX_EDGE_SHARE * float(np.max(mesh.extents))
        triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
        done: list[tuple[Array, Array]] = []
        while len(triangles):
            sides = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
            long = sides.max(axis=1) > longest_mm
            done.append((triangles[~long], normals[~long]))
            # halve the longest side: a to b, with c opposite
            k = sides[long].argmax(axis=1)
            a, b, c = (triangles[long][np.arange(len(k)), (k + i) % 3] for i in range(3))
            middle = (a + b) / 2
            triangles = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
            normals = np.concatenate([normals[long], normals[long]])
        self.triangles = np.concatenate([part[0] for part in done])
        self.normals = np.concatenate([part[1] for part in done])
        centers = self.triangles.mean(axis=1)
        self.reach_mm = np.linalg.norm(self.triangles - centers[:, None], axis=2).max(axis=1)
        self.tree = scipy.spatial.cKDTree(centers)

    def nearest(self, points: Array) -> tuple[Array, Array, Array]:
        """Nearest points (N, 3) of the surface, normals (N, 3) there, signed distances (N,); exact."""
        _, first = self.tree.query(points)
        bound_mm = np.linalg.norm(
            points - trimesh.triangles.closest_point(self.triangles[first], points), axis=1
        )
        # no other triangle can be nearer, whatever its form
        lists = self.tree.query_ball_point(points, bound_mm + self.reach_mm.max() + 1e-9)
        triangle = np.concatenate(lists).astype(int)
        point = np.repeat(np.arange(len(points)), [len(entry) for entry in lists])
        apart_mm = np.linalg.norm(points[point] - self.tree.data[triangle], axis=1)
        possible = apart_mm <= bound_mm[point] + self.reach_mm[triangle] + 1e-9
        triangle, point = triangle[possible], point[possible]

        feet = trimesh.triangles.closest_point(self.triangles[triangle], points[point])
        gaps = points[point] - feet
        distance_mm = np.linalg.norm(gaps, axis=1)
        height_mm = np.einsum("ij,ij->i", gaps, self.normals[triangle])
        # on a shared edge or corner the face that looks most at the point knows its side
        best = np.lexsort((-np.abs(height_mm), np.round(distance_mm, 9), point))
        best = best[np.unique(point[best], return_index=True)[1]]
        return feet[best], self.normals[triangle[best]], np.copysign(distance_mm, height_mm)[best]
