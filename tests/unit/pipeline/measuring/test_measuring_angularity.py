"""Gradient angularity of outlines."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.extents import examples

from pipeline.measuring import gradient_angularity
from pipeline.measuring.angularity import MAX_ANGULARITY, N_POINTS, OVERSAMPLING, SMOOTHING_STEPS, STEP

ANGLE = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
CIRCLE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)]) * 100


def polygon(n: int) -> NDArray[np.float64]:
    angle = np.arange(n) * 2 * np.pi / n
    return np.column_stack([np.cos(angle), np.sin(angle)]) * 100


def test_circle_is_the_least_angular() -> None:
    # it turns by 3 x 2 degrees in three of 180 steps
    least = 180 * 6.0**2 / (180 / 3 - 1)
    assert gradient_angularity(CIRCLE) == pytest.approx(least, rel=1e-4)


def test_the_sharper_and_fewer_the_corners_the_more_angular() -> None:
    angularities = [gradient_angularity(polygon(n)) for n in (3, 4, 5, 6, 8, 12, 24)]
    assert angularities == sorted(angularities, reverse=True)
    assert angularities[1] > 10 * gradient_angularity(CIRCLE) > 0
    assert angularities[-1] > gradient_angularity(CIRCLE)


def test_rounding_the_corners_of_a_square_makes_it_less_angular() -> None:
    def rounded(radius: float) -> NDArray[np.float64]:
        quarter = np.arange(4) * np.pi / 2
        corners = (1 - radius) * np.sqrt(2) * np.exp(1j * (quarter + np.pi / 4))
        arcs = corners[:, None] + radius * np.exp(1j * (quarter[:, None] + np.linspace(0, np.pi / 2, 50)))
        return np.column_stack([arcs.ravel().real, arcs.ravel().imag])

    angularities = [gradient_angularity(rounded(radius)) for radius in (0.02, 0.1, 0.3, 0.6, 1.0)]
    assert angularities == sorted(angularities, reverse=True)


def test_a_rough_outline_is_more_angular_than_a_smooth_one() -> None:
    roughness = np.random.default_rng(0).normal(scale=0.01, size=(100, 1)).repeat(10, axis=0)
    assert gradient_angularity(CIRCLE * (1 + roughness)) > 1.5 * gradient_angularity(CIRCLE)


def test_pixel_stairs_hardly_count() -> None:
    steps = np.unique(np.round(CIRCLE * 0.6), axis=0)  # of a stone of 5.8 mm
    stairs = steps[np.argsort(np.arctan2(steps[:, 1], steps[:, 0]))]
    assert gradient_angularity(stairs) < 1.3 * gradient_angularity(CIRCLE)


@given(
    scale=st.floats(1e-3, 1e3),
    turn=st.floats(0, 2 * np.pi),
    shift=st.floats(-1e3, 1e3),
    start=st.integers(0, 500),
    backward=st.booleans(),
    n=st.integers(3, 9),
)
def test_size_pose_start_and_sense_do_not_matter(
    scale: float, turn: float, shift: float, start: int, backward: bool, n: int
) -> None:
    corners = polygon(n) * [1, 0.7]
    along = np.linspace(0, 1, 20, endpoint=False)[:, None]
    outline = np.concatenate(
        [a + (b - a) * along for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    )
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    moved = np.roll(outline @ rotation.T * scale + shift * scale, start, axis=0)[:: -1 if backward else 1]
    assert gradient_angularity(moved) == pytest.approx(gradient_angularity(outline), rel=5e-3)


def by_fourier(contour: NDArray[np.float64]) -> float:
    outline = contour @ [1, 1j]
    closed = np.append(outline, outline[0])
    arc = np.append(0.0, np.cumsum(np.abs(np.diff(closed))))
    n = N_POINTS * OVERSAMPLING
    even = np.interp(np.arange(n) * arc[-1] / n, arc, closed)
    frequency = np.fft.fftfreq(n) * 2 * np.pi
    smooth = np.exp(-((frequency * SMOOTHING_STEPS * OVERSAMPLING) ** 2) / 2)
    tangents = np.fft.ifft(1j * frequency * smooth * np.fft.fft(even))
    turns_deg = np.rad2deg(np.angle(np.roll(tangents, -STEP * OVERSAMPLING) * tangents.conj()))
    return min(float(np.sum(turns_deg**2)) / OVERSAMPLING / (N_POINTS / STEP - 1), MAX_ANGULARITY)


@examples(0.5)
@given(n=st.integers(3, 1000), roughness=st.floats(0, 0.05), seed=st.integers(0, 2**32 - 1))
def test_the_same_by_fourier_transforms(n: int, roughness: float, seed: int) -> None:
    outline = polygon(n) * (1 + roughness * np.random.default_rng(seed).normal(size=(n, 1)))
    assert gradient_angularity(outline) == pytest.approx(by_fourier(outline), rel=1e-6)


def test_a_star_reaches_the_end_of_the_scale() -> None:
    radius = np.where(np.arange(20) % 2, 1.0, 0.4)[:, None]
    assert gradient_angularity(radius * polygon(20)) == 10_000


def test_a_closing_point_or_a_repeated_one_changes_nothing() -> None:
    square = polygon(4)
    repeated = np.concatenate([square, square[-1:], square[:1]])
    assert gradient_angularity(repeated) == pytest.approx(gradient_angularity(square), rel=1e-9)


@pytest.mark.parametrize(
    "contour", [np.zeros((0, 2)), np.zeros((9, 2)), np.eye(2), np.zeros((4, 3)), [[np.nan, 0]] * 4]
)
def test_no_outline(contour: NDArray[np.float64]) -> None:
    with pytest.raises(ValueError, match="contour"):
        gradient_angularity(contour)
