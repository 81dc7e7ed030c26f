import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.fall import (
    GRAVITY_MM_S2,
    Fall,
    blur_px,
    extent_is_plausible,
    fall_time_ms,
    longest_exposure_us,
    pulse_width_ns,
    speed_mm_s,
    vertical_extent_mm,
)

HEIGHTS_MM = st.floats(0.1, 2000)
SPEEDS_MM_S = st.floats(0, 5000)


def test_the_rigs_own_numbers() -> None:
    speed = speed_mm_s(300)
    assert fall_time_ms(300) == pytest.approx(247.35, abs=0.005)
    assert speed == pytest.approx(2426, abs=0.5)
    assert longest_exposure_us(1, speed_mm_s=speed, pixel_mm=0.048) == pytest.approx(19.8, abs=0.05)
    assert blur_px(1000, speed_mm_s=speed, pixel_mm=0.048) == pytest.approx(50, abs=1)  # 1 ms of skew
    assert fall_time_ms(45, speed_at_gate_mm_s=speed_mm_s(300 - 22.5)) == pytest.approx(18.6, abs=0.1)


def test_a_stone_of_15_mm_closes_the_beam_for_55_ms() -> None:
    assert pulse_width_ns(15) == pytest.approx(55.3e6, abs=0.05e6)
    assert vertical_extent_mm(55_309_571) == pytest.approx(15, abs=1e-5)


@given(HEIGHTS_MM, SPEEDS_MM_S)
def test_delay_and_speed_follow_the_law_of_falling(height_mm: float, speed_at_gate: float) -> None:
    t_s = fall_time_ms(height_mm, speed_at_gate) / 1e3
    assert speed_at_gate * t_s + GRAVITY_MM_S2 * t_s**2 / 2 == pytest.approx(height_mm)
    assert speed_mm_s(height_mm, speed_at_gate) == pytest.approx(speed_at_gate + GRAVITY_MM_S2 * t_s)


@given(HEIGHTS_MM, SPEEDS_MM_S, st.floats(-0.05, 0.3))
def test_another_stone_is_above_by_what_it_has_not_fallen_yet(
    height_mm: float, speed_at_gate: float, later_s: float
) -> None:
    fall = Fall(height_mm=height_mm, speed_at_gate_mm_s=speed_at_gate)
    above_mm = fall.height_above_mm(round(later_s * 1e9))
    left_s = fall_time_ms(height_mm, speed_at_gate) / 1e3 - later_s
    if left_s > 0:
        assert fall_time_ms(height_mm - above_mm, speed_at_gate) / 1e3 == pytest.approx(left_s, abs=1e-6)
    else:
        assert above_mm == height_mm  # still at the beam
    assert above_mm <= height_mm
    assert (above_mm > 0) == (round(later_s * 1e9) > 0) or abs(above_mm) < 1e-3


def test_stones_20_ms_apart_are_47_mm_apart_at_the_centre() -> None:
    assert Fall().height_above_mm(20_000_000) == pytest.approx(46.6, abs=0.05)
    assert Fall().height_above_mm(-20_000_000) == pytest.approx(-50.5, abs=0.05)
    assert Fall(speed_at_gate_mm_s=1400).height_above_mm(20_000_000) == pytest.approx(54.1, abs=0.05)


@given(st.floats(0.5, 100), SPEEDS_MM_S)
def test_extent_and_width_are_inverse(extent_mm: float, speed_at_gate: float) -> None:
    width_ns = pulse_width_ns(extent_mm, speed_at_gate)
    assert vertical_extent_mm(width_ns, speed_at_gate) == pytest.approx(extent_mm, rel=1e-4)
    assert extent_is_plausible(vertical_extent_mm(width_ns, speed_at_gate), (extent_mm, extent_mm))


@given(st.floats(0, 10), st.floats(0.01, 1), st.floats(1, 5000))
def test_the_longest_exposure_blurs_as_much_as_allowed(blur: float, pixel_mm: float, speed: float) -> None:
    exposure_us = longest_exposure_us(blur, speed_mm_s=speed, pixel_mm=pixel_mm)
    assert blur_px(exposure_us, speed_mm_s=speed, pixel_mm=pixel_mm) == pytest.approx(blur)


@pytest.mark.parametrize(("diameter_mm", "late_ms"), [(4, 0.47), (15, 0.13), (40, 0.05)])
def test_drag_is_as_small_as_stated(diameter_mm: float, late_ms: float) -> None:
    a_per_v2 = 0.75 * 0.45 * (1.2 / 2650) / (diameter_mm / 1000)  # of a sphere, 1/m
    speed, height, t, step = 0.0, 0.0, 0.0, 1e-5
    while height < 0.3:
        speed += (GRAVITY_MM_S2 / 1000 - a_per_v2 * speed**2) * step
        height += speed * step
        t += step
    assert t * 1e3 - fall_time_ms(300) == pytest.approx(late_ms, abs=0.03)


@pytest.mark.parametrize(
    ("extent_mm", "measured_mm", "is_plausible"),
    [
        (15, (12, 20), True),
        (22.9, (12, 20), True),  # 20 + 1 + 10 % of what the gate says
        (23.5, (12, 20), False),  # two stones in a row, measured as one of them
        (10.1, (12, 20), True),
        (9.5, (12, 20), False),  # another, smaller stone closed the beam
        (0, (4, 5), False),
    ],
)
def test_an_extent_is_plausible_within_the_bodys_own(
    extent_mm: float, measured_mm: tuple[float, float], is_plausible: bool
) -> None:
    assert extent_is_plausible(extent_mm, measured_mm) is is_plausible


def test_what_makes_no_sense_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="height_mm must not be negative, not -1"):
        fall_time_ms(-1)
    with pytest.raises(ValueError, match="pixel_mm must be positive, not 0"):
        blur_px(1, speed_mm_s=1, pixel_mm=0)
    with pytest.raises(ValueError, match="pulse_width_ns must not be negative"):
        vertical_extent_mm(-1)
