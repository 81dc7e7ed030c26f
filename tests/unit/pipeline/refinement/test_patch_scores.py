"""Scores of patches over pairs of views, of which some see something else."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.refinement.node_field import tangent_axes
from pipeline.refinement.passes import PASSES
from pipeline.refinement.patch_scores import Patches, patch_scores
from pipeline.refinement.refine import made_up_ball
from pipeline.refinement.sightings import PhotoViews, photo_views

N_VIEWS = 5


def views(n_strange: int) -> PhotoViews:
    """Return one view five times, some of them with another noise."""
    ball, frames, prepared = made_up_ball()
    seen = photo_views(frames, prepared, ball.vertices_mm)
    regions = np.repeat(seen.regions[:1], N_VIEWS, axis=0)
    regions[:n_strange] = np.random.default_rng(1).integers(0, 255, regions[:n_strange].shape)
    own = {name: np.repeat(getattr(seen, name)[:1], N_VIEWS, axis=0) for name in ("lenses", "R", "t_mm")}
    return seen._replace(regions=regions, **own)


def test_pairs_of_views_that_show_something_else_lessen_the_score():
    assert 0.3 < score(views(n_strange=2)) < 0.5  # three of ten pairs are alike
    assert score(views(n_strange=0)) > 0.95


def test_patches_without_texture_are_alike_as_far_as_one_can_tell():
    seen = views(n_strange=0)
    even = seen._replace(regions=np.full_like(seen.regions, 60))
    assert score(even) == pytest.approx(0.0, abs=1e-6)
    assert score(even, even_score=0.5) == pytest.approx(0.5)


def score(seen: PhotoViews, even_score: float = 0.0) -> float:
    inward = -seen.R[:1, 2]  # towards the camera
    chosen, weights = np.arange(N_VIEWS, dtype=np.int32)[None], np.ones((1, N_VIEWS), np.float32)
    patches = Patches(np.zeros((1, 3)), inward, tangent_axes(inward), 0.35, chosen, weights)
    return float(patch_scores(seen, patches, np.zeros(8), replace(PASSES[-1], even_score=even_score))[0, 0])
