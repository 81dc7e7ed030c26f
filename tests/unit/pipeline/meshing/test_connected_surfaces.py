"""Bodies of a mesh: the largest by area first, cavities with their body."""

import numpy as np
import trimesh

from pipeline.meshing.connected_surfaces import bodies_of

CUBE = trimesh.creation.box([10, 10, 10])
CRUMB = trimesh.creation.icosphere(subdivisions=3, radius=0.5)  # many faces, little area


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    return trimesh.Trimesh(vertices, faces, process=False)


def volumes_mm3(mesh: trimesh.Trimesh) -> list[float]:
    bodies = bodies_of(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64))
    return [round(trimesh.Trimesh(mesh.vertices, faces, process=False).volume, 1) for faces in bodies]


def moved(mesh: trimesh.Trimesh, x: float) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices + np.array([x, 0, 0]), mesh.faces, process=False)


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def test_the_body_of_most_area_is_first() -> None:
    half = trimesh.creation.box([5, 5, 5])
    assert volumes_mm3(CUBE) == [1000.0]
    assert volumes_mm3(together(moved(CRUMB, 30), CUBE, moved(half, 20))) == [1000.0, 125.0, 0.5]


def test_a_cavity_belongs_to_its_body_and_what_floats_in_it_does_not() -> None:
    hole = turned(trimesh.creation.box([5, 5, 5]))
    assert volumes_mm3(together(CUBE, hole)) == [875.0]
    assert volumes_mm3(turned(together(CUBE, hole))) == [-875.0]  # all look inward
    assert volumes_mm3(together(CUBE, hole, CRUMB)) == [875.0, 0.5]
    assert volumes_mm3(together(CUBE, moved(turned(CRUMB), 30))) == [1000.0, -0.5]
