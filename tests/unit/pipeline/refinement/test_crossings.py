"""Triangles that cross: found where they do, nowhere else, and smoothed away."""

import numpy as np
import pytest
import trimesh

from pipeline.refinement import crossings
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


def test_what_no_smoothing_untangles_goes_back_there_and_nowhere_else(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(crossings, "N_SMOOTHED", 0)
    mesh = ball(5)
    hull_mm, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
    rng, vertices_mm = np.random.default_rng(1), np.array(mesh.vertices)
    near = np.linalg.norm(vertices_mm - vertices_mm[vertices_mm[:, 2].argmax()], axis=1) < 2.0
    vertices_mm[near] += rng.normal(0, 1.0, (np.count_nonzero(near), 3))
    folded_mm = hull_mm - np.outer(np.linalg.norm(hull_mm - hull_mm[0], axis=1) < 0.5, (0.0, 0.0, 10.2))
    for before_mm in ((hull_mm,), (folded_mm, hull_mm)):  # an estimate that crosses itself is repaired first
        mended = without_crossings(vertices_mm, faces, before_mm)
        assert mended is not None
        assert not crossing_vertices(mended, faces).any()
        far = hull_mm[:, 2] < 0
        np.testing.assert_array_equal(mended[far], vertices_mm[far])
    assert without_crossings(vertices_mm, faces) is None


def test_only_pairs_with_a_new_vertex_are_compared_where_these_are_given():
    both = trimesh.util.concatenate([ball(3), ball(3).apply_translation((6.0, 0.1, 0.2))])
    vertices_mm, faces = np.asarray(both.vertices), np.asarray(both.faces)
    found = crossing_vertices(vertices_mm, faces)
    nothing = np.zeros(len(vertices_mm), np.bool_)
    assert not crossing_vertices(vertices_mm, faces, nothing).any()
    np.testing.assert_array_equal(crossing_vertices(vertices_mm, faces, found), found)
