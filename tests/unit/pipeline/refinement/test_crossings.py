"""Triangles that cross: found where they do, nowhere else, and smoothed away."""

import numpy as np
import trimesh

from pipeline.refinement.crossings import crossing_vertices, without_crossings


def ball(subdivisions: int = 4) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=5.0)


def test_a_closed_surface_without_crossings_has_none():
    for mesh in (
        ball(),
        trimesh.creation.box((3, 4, 5)).subdivide().subdivide(),
        trimesh.creation.torus(5, 2),
    ):
        assert not crossing_vertices(np.asarray(mesh.vertices), np.asarray(mesh.faces)).any()


def test_two_bodies_that_overlap_cross_where_their_surfaces_meet():
    both = trimesh.util.concatenate([ball(3), ball(3).apply_translation((6.0, 0.1, 0.2))])
    found = crossing_vertices(np.asarray(both.vertices), np.asarray(both.faces))
    assert found.any()
    assert abs(both.vertices[found][:, 0] - 3.0).max() < 2.0  # around the circle in which they meet, half way


def test_a_fold_is_smoothed_until_nothing_crosses():
    mesh = ball()
    vertices_mm = np.array(mesh.vertices)
    top = vertices_mm[:, 2].argmax()
    near = np.linalg.norm(vertices_mm - vertices_mm[top], axis=1) < 0.8
    vertices_mm[near] -= (0.0, 0.0, 10.2)  # through the other side
    assert crossing_vertices(vertices_mm, np.asarray(mesh.faces)).any()
    mended = without_crossings(vertices_mm, np.asarray(mesh.faces))
    assert mended is not None
    assert not crossing_vertices(mended, np.asarray(mesh.faces)).any()
    far = abs(vertices_mm[:, 2]) < 2
    np.testing.assert_array_equal(mended[far], vertices_mm[far])


def test_only_pairs_with_a_new_vertex_are_compared_where_these_are_given():
    both = trimesh.util.concatenate([ball(3), ball(3).apply_translation((6.0, 0.1, 0.2))])
    vertices_mm, faces = np.asarray(both.vertices), np.asarray(both.faces)
    found = crossing_vertices(vertices_mm, faces)
    nothing = np.zeros(len(vertices_mm), np.bool_)
    assert not crossing_vertices(vertices_mm, faces, nothing).any()
    np.testing.assert_array_equal(crossing_vertices(vertices_mm, faces, found), found)
