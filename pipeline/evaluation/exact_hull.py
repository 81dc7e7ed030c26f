"""The exact visual hull of a known body: the best that any silhouette method can do.

It needs no voxels, no images and nothing of the pipeline's carving: a body's silhouette in a camera is a cone of
rays from the camera's centre, whatever lens and sensor draw it (distortion moves pixels, not rays). So
the hull is the intersection of the cones around the body from the camera centres alone.
"""

import numpy as np
import scipy.optimize
import trimesh

from pipeline.arrays import Directions, Floats, Values, Vector
from pipeline.rig.cameras import RigCalibration

N_ANGLES = 8192
"""Angles of an outline; a corner of a silhouette is met within 0.4 thousandths of its radius."""


def star_center_mm(body: trimesh.Trimesh) -> Vector | None:
    """Return the point deepest in the kernel of a closed surface, `None` if it is not star-shaped.

    The kernel is what sees the whole surface from within, behind the planes of all faces: a linear programme finds
    the point deepest behind them.
    """
    normals = np.asarray(body.face_normals)
    offsets_mm = np.einsum("ij,ij->i", normals, body.triangles[:, 0])
    found = scipy.optimize.linprog(
        [0, 0, 0, -1],
        A_ub=np.column_stack([normals, np.ones(len(normals))]),
        b_ub=offsets_mm,
        bounds=[(None, None)] * 3 + [(0, None)],
    )
    return np.asarray(found.x[:3]) if found.success and found.x[3] > 0 else None


def exact_hull_mesh(
    body: trimesh.Trimesh, center_mm: Vector, rig: RigCalibration, subdivisions: int = 6
) -> trimesh.Trimesh:
    """Return the visual hull, in the world frame, of a closed body seen by all cameras of the rig.

    The body must be star-shaped about `center_mm`: then its silhouettes and its hull are, and the
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


def cone_radii_mm(
    body: trimesh.Trimesh, center_mm: Vector, camera_mm: Vector, directions: Directions
) -> Values:
    """Return the distances (N,) from the centre along directions (N, 3) to the cone of the body's silhouette.

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


def _silhouette_edges(body: trimesh.Trimesh, camera_mm: Vector) -> Floats:
    """Return the end points (E, 2, 3) of the edges between a face that faces the camera and one that does not."""
    towards = np.einsum("ij,ij->i", body.face_normals, camera_mm - body.triangles_center) > 0
    first, second = body.face_adjacency.T
    return np.asarray(body.vertices[body.face_adjacency_edges[towards[first] != towards[second]]])


def _plane(points: Floats, axis: Vector, right: Vector, down: Vector) -> Floats:
    """Return the coordinates (..., 2), in the plane at distance 1, of points (..., 3) relative to the camera."""
    return np.stack([points @ right, points @ down], axis=-1) / (points @ axis)[..., None]


def polar_outline(segments: Floats) -> Values:
    """Return the greatest radius at which segments (E, 2, 2) meet the ray at each of `N_ANGLES` angles from 0.

    Raises
    ------
    ValueError
        The segments do not enclose the origin.
    """
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
