"""Training samples, composed without PyTorch: the network's input and the truth."""

from functools import cache

import numpy as np
import pytest

from pipeline.segmentation.network import MAX_RELATIVE
from pipeline.training.image_layers import (
    CANVAS_PX,
    VIEW_PX,
    BodyLayer,
    WallLayer,
    render_body,
    render_wall,
)
from pipeline.training.samples import NO_BACKGROUND_SHARE, Samples, TrainingSample, compose

N_SAMPLES = 150


@cache
def bodies() -> list[BodyLayer]:
    return [layer for number in range(3) for layer in render_body(5, number)]


@cache
def walls() -> list[WallLayer]:
    return [layer for number in range(2) for layer in render_wall(5, number)]


@cache
def samples() -> list[TrainingSample]:
    return list(Samples(bodies=bodies(), walls=walls(), seed=6, count=N_SAMPLES))


def test_layers_fill_their_canvas_and_are_drawn_from_the_seed() -> None:
    for layer in bodies():
        assert layer.coverage.shape == layer.light.shape == (CANVAS_PX, CANVAS_PX)
        assert layer.coverage.max() == 255
        assert layer.scale >= 1
        # in the middle of the canvas, so that the whole body stays in sight when the region moves
        assert not layer.coverage[0].any()
        assert layer.light[layer.coverage == 0].max() <= 1
    greys = [float(np.median(layer.grey)) for layer in walls()]
    assert 150 < np.median(greys) < 240
    last = render_body(5, 2)[-1]  # alone, as another process would render it
    assert np.array_equal(last.light, bodies()[-1].light)
    assert not np.array_equal(render_body(6, 2)[-1].light, last.light)


def test_samples_are_in_the_ranges_that_the_network_is_promised() -> None:
    for view, coverage in samples():
        assert view.shape == (2, VIEW_PX, VIEW_PX)
        assert coverage.shape == (VIEW_PX, VIEW_PX)
        assert view.dtype == coverage.dtype == np.float32
        assert np.isfinite(view).all()
        assert view.min() >= 0
        assert view.max() <= MAX_RELATIVE
        assert coverage.min() >= 0
        assert coverage.max() <= 1


def test_samples_show_all_that_is_to_be_learnt() -> None:
    without = np.mean([not sample.view[1].any() for sample in samples()])
    assert without == pytest.approx(NO_BACKGROUND_SHARE, abs=0.13)
    covered = np.array([sample.coverage.mean() for sample in samples()])
    assert (covered == 0).any()  # the empty rig
    assert (covered > 0.15).any()
    contrast = np.array(
        [
            np.median(view[0][coverage > 0.99]) - np.median(view[0][coverage == 0])
            for view, coverage in samples()
            if (coverage > 0.99).sum() > 50
        ]
    )
    assert contrast.min() < -0.7  # dark before the wall
    assert contrast.max() > 0.1  # brighter than the wall
    assert (np.abs(contrast) < 0.1).any()


def test_a_background_shows_what_is_behind_the_body() -> None:
    """Beside the bodies and without disturbances, both channels agree."""
    differences = [
        float(np.median(np.abs(view[0] - view[1])[coverage == 0]))
        for view, coverage in samples()
        if view[1].any() and (coverage == 0).any()
    ]
    assert np.median(differences) < 0.06


def test_the_same_random_numbers_give_the_same_sample() -> None:
    first, again = (compose(bodies(), walls(), np.random.default_rng(8)) for _ in range(2))
    assert np.array_equal(first.view, again.view)
    assert np.array_equal(first.coverage, again.coverage)
