"""What is left of prepared views without some of them is what preparing the others gives."""

from dataclasses import replace

import numpy as np
import pytest
from support.silhouettes import sphere_silhouettes

from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import SilhouetteSet, ViewStatus
from pipeline.views.prepared import PreparedViews, prepare_views

RIG = as_built(nominal_rig(), seed=6)


def seen() -> SilhouetteSet:
    """One view that is not usable, and one of which no edge was seen, in another order than the rig's."""
    silhouettes = sphere_silhouettes(RIG)
    c03, c05 = RIG.camera_ids[2], RIG.camera_ids[4]
    silhouettes[c03] = replace(silhouettes[c03], status=ViewStatus.CLIPPED)
    silhouettes[c05] = replace(silhouettes[c05], outline_uv=np.zeros((2, 2)))
    return dict(reversed(silhouettes.items()))


def assert_same(found: PreparedViews, expected: PreparedViews) -> None:
    assert found.camera_ids == expected.camera_ids
    for mine, theirs in zip(found.cameras, expected.cameras, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for mine, theirs in zip(found.outlines, expected.outlines, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_usable_views_come_in_the_rig_s_order() -> None:
    views = prepare_views(seen(), RIG)
    assert views.camera_ids == tuple(camera for camera in RIG.camera_ids if camera != RIG.camera_ids[2])
    assert [silhouette.camera for silhouette in views.silhouettes] == list(views.camera_ids)
    assert list(views.outlines.lengths[:4]) == [720, 720, 720, 2]


def test_views_without_some_are_those_of_the_others() -> None:
    silhouettes = seen()
    dropped = RIG.camera_ids[6:9]
    others = {camera: silhouette for camera, silhouette in silhouettes.items() if camera not in dropped}
    views = prepare_views(silhouettes, RIG)
    assert_same(views.without(dropped), prepare_views(others, RIG))
    assert views.without([RIG.camera_ids[2]]) is views


def test_views_with_an_outline_have_points_for_a_hull() -> None:
    views = prepare_views(seen(), RIG)
    outlined = views.with_outline()
    assert_same(outlined, views.without([RIG.camera_ids[4]]))
    assert outlined.with_outline() is outlined


def test_a_rig_without_the_camera_is_refused() -> None:
    with pytest.raises(ValueError, match=f"no camera {RIG.camera_ids[0]}"):
        prepare_views(seen(), RIG.subset(RIG.camera_ids[1:]))
    assert len(prepare_views({}, RIG)) == 0
