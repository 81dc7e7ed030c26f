"""Walls with soft spots show the greys they are asked for, and sensors the noise."""

import numpy as np
import pytest
from support.synthetic_rigs import rig_of

from pipeline.arrays import FloatImage
from pipeline.rig.cameras import RigCalibration
from pipeline.synthesis.background import DULL_WALL_GREY, WallKind, build_wall, render_backgrounds
from pipeline.synthesis.exposure import QUIET_F2, expose
from pipeline.synthesis.wall_spots import GREYS, ONE_SPOT_GREY, many_spots, scattered_directions, spots_at


def relative_views(rig: RigCalibration, kind: WallKind, seed: int = 1) -> list[FloatImage]:
    """The empty views relative to those of the bare wall in the same light, smooth but for the spots."""
    views = []
    for wall_kind in (kind, WallKind.BARE):
        wall = build_wall(rig, np.random.default_rng(seed), wall_kind)
        empty = render_backgrounds(rig, wall, np.random.default_rng(2), QUIET_F2.lens)
        views.append([view.radiance for view in empty.values()])
    return [seen / bare for seen, bare in zip(*views, strict=True)]


def test_many_spots_are_in_a_field_of_view_as_dark_as_they_should_be() -> None:
    views = relative_views(rig_of("c02", "c06"), WallKind.SPOTTED)
    darkest = [float(view.min()) for view in views]
    assert min(darkest) > 0.6 * GREYS[0], "where spots overlap they are darker"
    for view in views:
        assert 0.1 < np.mean(view < 0.85) < 0.7
        assert np.mean((view > GREYS[0]) & (view < GREYS[1])) > 0.05
        slopes = np.hypot(*np.gradient(view))
        assert slopes.max() < 0.015, "their borders are as soft as 130 px of blur make them"


def test_one_spot_is_in_the_middle_of_each_view() -> None:
    for view in relative_views(rig_of("c02", "c11"), WallKind.ONE_SPOT):
        assert view[512, 640] == pytest.approx(ONE_SPOT_GREY, abs=0.03)
        assert view[:200].min() > 0.95
        assert view[:, :200].min() > 0.95


def test_dull_walls_are_of_150_to_190() -> None:
    rig = rig_of("c06")
    wall = build_wall(rig, np.random.default_rng(1), WallKind.BARE)
    assert wall.grey == DULL_WALL_GREY
    view = render_backgrounds(rig, wall, np.random.default_rng(2), QUIET_F2.lens)[rig.cameras[0].id].radiance
    assert 140 < view.min() < view.max() < 205


def test_the_darkest_spot_counts_where_they_overlap() -> None:
    direction = np.array([0.0, 0.6, 0.8])
    spots = many_spots(300.0, np.random.default_rng(1))
    directions = scattered_directions(20_000, np.random.default_rng(2))
    shares = spots.shares_at(directions, 300.0)
    assert shares.max() == 1
    assert shares.min() >= spots.shares.min()
    assert spots_at(direction[None]).shares_at(direction[None], 300.0) == pytest.approx(ONE_SPOT_GREY)


@pytest.mark.parametrize(("grey", "sigma"), [(12.0, 0.6), (150.0, 1.3)])
def test_the_quiet_sensor_has_the_noise_of_a_real_one(grey: float, sigma: float) -> None:
    image = expose(np.full((400, 400), grey, np.float32), QUIET_F2, np.random.default_rng(3))
    assert image.std() == pytest.approx(sigma, abs=0.05)
