"""Shifts between the nodes: outward within the hull, where more than chance says so."""

import numpy as np
from unit.pipeline.refinement.test_nodes import ball, nodes_of

from pipeline.arrays import PointsMM, Values
from pipeline.refinement.shift_field import INWARD_MM, OUTWARD_MM, Field, vertex_shifts
from pipeline.uncertainty import PixelSupport

BALL = ball()
NODES = nodes_of(BALL)
NORMALS = np.asarray(BALL.vertices) / 5.0
EVERYWHERE = np.ones(len(NODES.points_mm))


def shifts(inward_mm: Values, room_mm: PointsMM) -> PointsMM:
    field = Field(
        nodes=NODES,
        shifts_mm=inward_mm,
        weights=EVERYWHERE,
        sure=EVERYWHERE,
        peaked=EVERYWHERE,
        support=PixelSupport(share=1.0, blank_share=0.0),
    )
    return vertex_shifts(field, np.asarray(BALL.vertices), NORMALS, room_mm)


def along_normals(shifts_mm: PointsMM) -> Values:
    return np.asarray(np.einsum("vk,vk->v", shifts_mm, NORMALS))


def test_what_stands_out_everywhere_is_reached_along_the_normal_though_the_way_to_the_hull_is_oblique():
    across = np.cross(NORMALS, [0.0, 0.6, 0.8])
    outward_mm = along_normals(shifts(-0.2 * EVERYWHERE, NORMALS + across))
    np.testing.assert_allclose(outward_mm, 0.2, rtol=0.1)


def test_nothing_leaves_the_hull():
    room_mm = 0.1 * NORMALS
    np.testing.assert_allclose(shifts(-0.5 * EVERYWHERE, room_mm), room_mm)


def test_a_single_node_that_stands_out_is_chance_one_that_lies_deep_is_not():
    lone = np.zeros(len(EVERYWHERE))
    lone[0] = 1.5 * OUTWARD_MM
    deepest_mm = -along_normals(shifts(lone, NORMALS)).min()
    highest_mm = along_normals(shifts(-lone, NORMALS)).max()
    assert deepest_mm > 0.05
    assert highest_mm < 0.5 * deepest_mm


def test_small_shifts_inward_are_chance_too_and_dents_keep_their_depth():
    for times, share in ((0.1, 0.01), (1, 0.5), (5, 0.96), (50, 1.0)):
        inward_mm = times * INWARD_MM * EVERYWHERE
        found_mm = -along_normals(shifts(inward_mm, NORMALS))
        np.testing.assert_allclose(found_mm, share * inward_mm[0], rtol=0.03)
