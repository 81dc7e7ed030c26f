"""Bodies of known form that are no stones of ours, and their silhouettes without rendering an image."""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pipeline.carving import CarvingParameters, carve
from pipeline.meshing import ParticleMesh, mesh_hull
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.delineation import delineate
from pipeline.segmentation.local_threshold import trimap_of
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette, SilhouetteSet, ViewStatus
from pipeline.synthesis import pixel_coverage
from pipeline.synthesis.bodies import Body, body_from_mesh, cylinder
from pipeline.views.prepared import prepare_views

Array = NDArray[np.float64]

BLUR_PX = 0.8
COVERAGE_NOISE = 0.012
BODY, WALL = 40, 200
N_BUMPS = 300


def form(name: str, rng: np.random.Generator) -> Body:
    """A random body of a name in `FORMS`, 7 to 28 mm across."""
    match name:
        case "ellipsoid":
            return _radial(name, np.ones(len(_sphere().vertices)), rng.uniform(4, 13, size=3))
        case "rough ellipsoid":
            return _radial(name, _bumps(0.006, rng), rng.uniform(0.4, 1, size=3) * rng.uniform(5, 14))
        case "superellipsoid":
            directions, power = np.asarray(_sphere().vertices), rng.uniform(2.3, 8)
            radii = (np.abs(directions) ** power).sum(axis=1) ** (-1 / power)
            return _radial(name, radii, rng.uniform(5, 12, size=3))
        case "box":
            return body_from_mesh(name, _cut_up(trimesh.creation.box(extents=rng.uniform(6, 18, size=3))))
        case "cylinder":
            return cylinder(rng.uniform(6, 18), rng.uniform(6, 25))
        case "polyhedron":
            normals, distances = _planes(int(rng.integers(6, 30)), rng)
            planes = ConvexHull(normals / distances[:, None]).equations
            corners = -planes[:, :3] / planes[:, 3:] * rng.uniform(0.4, 1, size=3) * rng.uniform(5, 14)
            return body_from_mesh(name, _cut_up(trimesh.convex.convex_hull(corners)))
        case "rough polyhedron":
            normals, distances = _planes(18, rng)
            gauges = (np.asarray(_sphere().vertices) @ normals.T / distances).max(axis=1)
            radii = _bumps(0.008, rng) / gauges
            return _radial(name, radii, rng.uniform(0.4, 1, size=3) * rng.uniform(5, 14))
    raise ValueError(f"form must be one of {', '.join(FORMS)}, not {name!r}")


FORMS = (
    "ellipsoid", "rough ellipsoid", "superellipsoid", "box", "cylinder", "polyhedron", "rough polyhedron",
)  # fmt: skip


def silhouettes_of(mesh: trimesh.Trimesh, rig: RigCalibration, rng: np.random.Generator) -> SilhouetteSet:
    """Silhouettes of a closed mesh in the world frame, blurred and noisy like segmented images."""
    edges = pixel_coverage.mesh_edges(mesh.faces)
    return {camera.id: _silhouette(camera, mesh, edges, rng) for camera in rig.cameras}


def hull_of(silhouettes: SilhouetteSet, rig: RigCalibration) -> ParticleMesh:
    mesh = mesh_hull(carve(prepare_views(silhouettes, rig), CarvingParameters()))
    assert mesh is not None
    return mesh


def _silhouette(
    camera: CameraCalibration,
    mesh: trimesh.Trimesh,
    edges: pixel_coverage.MeshEdges,
    rng: np.random.Generator,
) -> Silhouette:
    pixels_uv, _ = camera.project(mesh.vertices)
    window = pixel_coverage.window_around(pixels_uv, MARGIN_PX + 4)
    towards_mm = camera.center_mm - mesh.triangles[:, 0]
    is_front = np.einsum("ij,ij->i", mesh.face_normals, towards_mm) > 0
    border_uv = pixels_uv[pixel_coverage.silhouette_edges(edges, is_front)]
    covered = cv2.GaussianBlur(
        pixel_coverage.coverage(border_uv[:, 0], border_uv[:, 1], window), (0, 0), BLUR_PX
    )
    covered = covered + COVERAGE_NOISE * rng.normal(size=covered.shape)
    image = np.rint(WALL + covered * (BODY - WALL)).astype(np.uint8)
    core = cv2.erode((covered > 0.5).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    possible = cv2.dilate((covered > 0.1).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    trimap = trimap_of(core[::2, ::2], possible[::2, ::2], np.zeros_like(core[::2, ::2]))
    found = delineate(image, np.full_like(image, WALL), trimap)
    assert found.edge is not None
    return Silhouette(
        camera=camera.id,
        status=ViewStatus.OK,
        image_size_px=camera.image_size_px,
        offset_uv=(window.left, window.top),
        labels=found.labels,
        outline_uv=found.edge.outline_uv + np.array([window.left, window.top]),
        distances=found.edge,
    )


def _sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=5)


def _radial(name: str, radii: Array, axes_mm: Array) -> Body:
    sphere = _sphere()
    points_mm = np.asarray(sphere.vertices) * radii[:, None] * axes_mm
    return body_from_mesh(name, trimesh.Trimesh(points_mm, sphere.faces, process=False))


def _planes(count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Normals and distances of random planes around the unit sphere's inside, and of a box around them."""
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (
        np.concatenate([normals, np.eye(3), -np.eye(3)]),
        np.concatenate([rng.uniform(0.65, 1.0, size=count), np.full(6, 1.1)]),
    )


def _bumps(relative_height: float, rng: np.random.Generator) -> Array:
    """Radii of a sphere with bumps and dimples of many widths: another roughness than that of our stones."""
    directions = np.asarray(_sphere().vertices)
    radii = np.ones(len(directions))
    for _ in range(N_BUMPS):
        center = rng.normal(size=3)
        along = directions @ (center / np.linalg.norm(center))
        height, width = relative_height * rng.normal(), rng.uniform(0.06, 0.3)
        radii *= 1 + height * np.exp((along - 1) / (width**2 / 2))
    return radii


def _cut_up(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    while mesh.edges_unique_length.max() > 2.0:
        mesh = mesh.subdivide()
    return mesh
