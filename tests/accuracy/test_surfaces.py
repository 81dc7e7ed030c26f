"""The refined body on every kind of surface; `surfaces.py` prints more, and which goals are not reached yet."""

from collections.abc import Iterator
from statistics import fmean

import pytest
from accuracy.surfaces import (
    MAX_CHANGE_MM,
    MAX_CHANGE_PERCENT,
    STONES,
    TEXTURES,
    Compared,
    compared,
    errors_table,
    mean_mm,
    plan_of,
    volume_percent,
)
from research.accuracy import run_accuracy_bench
from rich.console import Console

from pipeline.synthesis.bodies import SurfaceKind
from pipeline.synthesis.exposure import LensPreset

PLAN = plan_of(seed=41, count=1, lens=LensPreset.F8, rigs=("true",))

pytestmark = [pytest.mark.night, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def found(request: pytest.FixtureRequest) -> Iterator[list[Compared]]:
    result = run_accuracy_bench(PLAN)
    assert [trial for trial in result.trials if trial.failure] == []
    found = compared(PLAN, result)
    capture = request.config.pluginmanager.getplugin("capturemanager")
    with capture.global_and_fixture_disabled():
        Console(width=150).print("\n", errors_table(found, "lens f8, seed 41"))
    yield found


@pytest.mark.parametrize("surface", TEXTURES)
def test_stones_of_every_texture_are_nearer_to_the_truth_than_their_estimates(
    found: list[Compared], surface: SurfaceKind
) -> None:
    stones = [each for each in found if each.body in STONES and each.surface is surface]
    assert len(stones) == len(STONES)
    for each in stones:  # some have dents deeper than are searched
        assert mean_mm(each.photo) < 0.8 * mean_mm(each.estimate)
        assert abs(volume_percent(each.photo)) < max(0.6, 0.6 * abs(volume_percent(each.estimate)))
    assert fmean(mean_mm(each.photo) for each in stones) < 0.6 * fmean(
        mean_mm(each.estimate) for each in stones
    )


def test_bodies_without_texture_stay_as_estimated(found: list[Compared]) -> None:
    plain = [each for each in found if each.surface is SurfaceKind.PLAIN]
    assert len(plain) == 8
    for each in plain:
        assert abs(each.change_mm) <= MAX_CHANGE_MM
        assert abs(each.change_percent) <= MAX_CHANGE_PERCENT


@pytest.mark.parametrize("body", ["textured cube", "textured cylinder"])
def test_textured_standards_are_on_average_as_near_as_their_estimates(
    found: list[Compared], body: str
) -> None:
    poses = [each for each in found if each.body == body]
    assert len(poses) == len(TEXTURES)
    for each in poses:
        assert each.change_mm < 0.003
        assert abs(volume_percent(each.photo)) < 0.6
