"""Negative clearances of agreeing views against the clearances of a search everywhere, gaps in outlines or not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.forms import form, silhouettes_of

from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import SilhouetteSet
from pipeline.views import tangent_planes
from pipeline.views.agreeing_views import negative_clearances_px
from pipeline.views.clearance import body_sphere, clearances_px
from pipeline.views.distance_field import distance_field
from pipeline.views.epipolar_tangency import outline_hulls, outlines_of
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=8)


def seen(name: str, n_gaps: int) -> SilhouetteSet:
    """Silhouettes of a body; in the first `n_gaps` views its left end is behind something dark."""
    rng = np.random.default_rng(4)
    silhouettes: SilhouetteSet = silhouettes_of(form(name, rng).mesh, RIG, rng)
    for camera in RIG.camera_ids[:n_gaps]:
        outline_uv = silhouettes[camera].outline_uv
        u = outline_uv[:, 0]
        kept = np.roll(outline_uv, -int(u.argmin()), axis=0)
        is_seen = kept[:, 0] > u.min() + 0.2 * np.ptp(u)
        silhouettes[camera] = replace(silhouettes[camera], outline_uv=kept[is_seen])
    return silhouettes


@pytest.mark.parametrize(("name", "n_gaps"), [("polyhedron", 0), ("polyhedron", 5), ("rough polyhedron", 10)])
def test_they_are_the_clearances_below_zero(name: str, n_gaps: int) -> None:
    silhouettes = seen(name, n_gaps)
    views = prepare_views(silhouettes, RIG)
    field = distance_field(views, 0)
    sphere = body_sphere(field)
    assert sphere is not None
    expected_px = np.minimum(np.concatenate(clearances_px(views, field, sphere, RIG.camera_ids)), 0)
    hulls = outline_hulls(outlines_of(silhouettes), RIG)
    found_px = np.concatenate(negative_clearances_px(views, hulls))
    assert (found_px - expected_px).min() > -0.1
    assert np.median(found_px - expected_px) < 0.01  # where it is higher, a narrow peak was found
    assert found_px.max() <= 0


@examples(0.2)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.sampled_from([0.0, 0.5]))
def test_planes_leave_of_rays_what_they_leave_one_by_one(
    seed: int, n_planes: int, least_slope: float
) -> None:
    rng = np.random.default_rng(seed)
    planes, rays = (
        rng.normal(size=(n_planes, 4)).astype(np.float32),
        rng.normal(size=(6, 30)).astype(np.float32),
    )
    slopes = planes[:, :3].astype(float) @ rays[3:]
    ends_mm = (planes[:, 3:] - planes[:, :3].astype(float) @ rays[:3]) / slopes
    low_mm, high_mm = tangent_planes.clip_lines(planes[:, :3], planes[:, 3], rays, least_slope)
    lowest_mm = np.where(slopes < -least_slope, ends_mm, -np.inf).max(axis=0)
    highest_mm = np.where(slopes > least_slope, ends_mm, np.inf).min(axis=0)
    np.testing.assert_allclose(low_mm, lowest_mm, rtol=1e-2, atol=1e-3)
    np.testing.assert_allclose(high_mm, highest_mm, rtol=1e-2, atol=1e-3)
