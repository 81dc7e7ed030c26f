"""Nodes: evenly spread, linked to those nearby on the same side, and interpolated between."""

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from pipeline.refinement.nodes import (
    Nodes,
    interpolated,
    of_nodes,
    smoothed,
    spread_nodes,
    vertex_normals,
)

SPACING_MM = 0.8


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=5, radius=5.0)


def nodes_of(mesh: trimesh.Trimesh) -> Nodes:
    normals = vertex_normals(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    return spread_nodes(np.array(mesh.vertices), normals, SPACING_MM, order)


def test_no_two_nodes_are_nearer_than_the_spacing_and_no_place_is_farther_from_one():
    mesh, nodes = ball(), nodes_of(ball())
    assert pdist(nodes.points_mm).min() >= SPACING_MM
    assert cKDTree(nodes.points_mm).query(mesh.vertices)[0].max() < SPACING_MM
    np.testing.assert_allclose(nodes.normals, nodes.points_mm / 5.0, atol=0.01)


def test_neighbours_are_the_nearest_ones():
    nodes = nodes_of(ball())
    distances_mm, nearest = cKDTree(nodes.points_mm).query(nodes.points_mm, 9)
    within = distances_mm[:, 1:] < 2 * SPACING_MM
    for own, expected, is_near in zip(nodes.neighbours, nearest[:, 1:], within, strict=True):
        assert set(own[own >= 0]) == set(expected[is_near])


def test_the_two_sides_of_a_thin_plate_are_not_neighbours():
    plate = trimesh.creation.box((8, 8, 0.3))
    for _ in range(6):
        plate = plate.subdivide()
    nodes = nodes_of(plate)
    upper = nodes.normals[:, 2] > 0.9
    lower = nodes.normals[:, 2] < -0.9
    assert upper.sum() > 50 < lower.sum()
    for own in nodes.neighbours[upper]:
        assert not lower[own[own >= 0]].any()


def test_a_node_knows_that_a_face_ends_beside_it_in_a_sharp_convex_edge():
    cube = trimesh.creation.box((8, 8, 8))
    for _ in range(6):
        cube = cube.subdivide()
    nodes = nodes_of(cube)
    # of the two coordinates along its face, the larger: how near the edge is
    along = np.sort(np.abs(nodes.points_mm), axis=1)[:, 1]
    is_on_one_face = np.abs(nodes.normals).max(axis=1) > 0.99
    assert not nodes.at_edge[along < 4 - 1.5 * SPACING_MM].any()
    assert nodes.at_edge[is_on_one_face & (along > 4 - 0.4 * SPACING_MM)].mean() > 0.8
    hollow = trimesh.Trimesh(cube.vertices, cube.faces[:, ::-1])  # its edges are concave
    assert not nodes_of(hollow).at_edge.any()
    plate = trimesh.creation.box((8, 8, 0.3))
    for _ in range(6):
        plate = plate.subdivide()
    on_plate = nodes_of(plate)
    assert not on_plate.at_edge[np.abs(on_plate.points_mm[:, :2]).max(axis=1) < 2.5].any()


def test_a_constant_is_interpolated_and_smoothed_to_itself():
    mesh, nodes = ball(), nodes_of(ball())
    ones = np.ones((len(nodes.points_mm), 2))
    np.testing.assert_allclose(smoothed(nodes, ones, 3), 1.0)
    normals = vertex_normals(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    weights = np.random.default_rng(1).uniform(0.1, 1, len(ones))
    found = interpolated(np.array(mesh.vertices), normals, nodes, ones, weights, 0.6 * SPACING_MM)
    np.testing.assert_allclose(found, 1.0)


def test_one_value_a_node_is_smoothed_as_a_column_of_several():
    nodes = nodes_of(ball())
    is_kept = np.random.default_rng(1).random(len(nodes.points_mm)) < 0.7
    nodes = of_nodes(nodes, is_kept)  # with gaps among the neighbours
    values = np.random.default_rng(2).normal(size=len(nodes.points_mm))
    np.testing.assert_array_equal(smoothed(nodes, values, 7), smoothed(nodes, values[:, None], 7)[:, 0])
