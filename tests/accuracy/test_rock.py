"""Real rock before spotted and bare walls: no tunnels, no lost dents, and black stones as large as they are."""

import pytest
from accuracy.constants import OBJECTS
from accuracy.rock import rows_of
from support.rock_tables import Row
from support.rocks import CASES

from pipeline.refinement import search

pytestmark = pytest.mark.full


def row(name: str, seed: int) -> Row:
    (measured,) = rows_of(seed, name, ("true",), "auto", None)
    return measured


def test_constants_are_tried_on_objects_that_there_are() -> None:
    assert set(OBJECTS.split(";")) <= CASES.keys()


def test_a_sphere_before_a_spot_as_grey_as_its_grains_has_no_tunnel() -> None:
    """It had one of 6 mm: two views took patches of its texture for the wall behind."""
    sphere = row("sphere", 5)
    assert sphere.photo is not None
    assert sphere.photo.largest_mm < 0.3
    assert sphere.bitten_px < 100
    assert sphere.volume_percent == pytest.approx(0, abs=0.1)
    assert sphere.word == "good"


def test_a_black_stone_shows_its_texture_in_the_noise_that_it_has() -> None:
    """With one noise for all greys it stayed as estimated, 10 % too large, and was called good."""
    basalt = row("basalt 18, bare wall", 3)
    assert basalt.photo is not None
    assert basalt.support is not None
    assert basalt.support > 0.5
    assert basalt.photo.mean_mm < 0.04
    assert basalt.volume_percent == pytest.approx(0, abs=0.6)


def test_dents_are_searched_again_where_patches_look_unlike(monkeypatch: pytest.MonkeyPatch) -> None:
    again = row("granite, bare wall", 1)
    monkeypatch.setattr(search, "UNLIKE", 0.0)
    once = row("granite, bare wall", 1)
    assert again.photo is not None
    assert once.photo is not None
    assert again.photo.far_percent < 0.8 * once.photo.far_percent
    assert again.photo.mean_mm < 0.04
