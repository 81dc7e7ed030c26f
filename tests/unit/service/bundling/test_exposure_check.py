import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bundling.exposure_check import LARGEST_ID_STEP, ExposureCheck, MatchedFrame, id_step


@pytest.mark.parametrize(
    ("earlier", "later", "step"),
    [
        (5, 6, 1),
        (5, 9, 4),
        (65535, 1, 1),
        (65534, 3, 4),
        (2**64 - 1, 1, 1),
        (70_000, 1, None),
        (9, 9, None),
        (9, 8, None),
        (1, 40_000, None),
    ],
)
def test_id_steps(earlier: int, later: int, step: int | None) -> None:
    assert id_step(earlier, later) == step


@given(start=st.integers(0, 0xFFFE), n=st.integers(1, LARGEST_ID_STEP))
def test_16_bit_ids_wrap_without_zero(start: int, n: int) -> None:
    assert id_step(start + 1, (start + n) % 0xFFFF + 1) == n


@given(
    gaps_s=st.lists(st.floats(0.25, 10_000), min_size=1, max_size=10),
    drift=st.floats(-1e-4, 1e-4),
    epoch_ns=st.integers(1, 10**18),
)
def test_a_healthy_clock_is_always_believed(gaps_s: list[float], drift: float, epoch_ns: int) -> None:
    check = ExposureCheck(100_000_000)
    at_ns = 10**12
    assert check.belongs(MatchedFrame(epoch_ns, 1, at_ns, ordinal=0))
    for gap_s in gaps_s:
        gap_ns = round(gap_s * 1e9)
        at_ns += gap_ns
        epoch_ns += round(gap_ns * (1 + drift))
        assert check.belongs(MatchedFrame(epoch_ns, 2, at_ns, ordinal=1))


def test_without_a_trusted_frame_it_takes_two_that_agree() -> None:
    check = ExposureCheck(100_000_000)
    assert not check.belongs(MatchedFrame(7_000_000_000, 1, 0, ordinal=1))
    assert not check.belongs(MatchedFrame(7_500_000_000, 1, 250_000_000, ordinal=1))
    assert check.belongs(MatchedFrame(7_750_000_000, 1, 500_000_000, ordinal=1))


def test_a_camera_without_a_clock_cannot_be_checked() -> None:
    check = ExposureCheck(100_000_000)
    assert all(check.belongs(MatchedFrame(0, 1, at_ns, ordinal=1)) for at_ns in (0, 10, 10**12))


@pytest.mark.parametrize(
    ("frame_id", "device_ms", "is_proven"),
    [
        (2, 250, True),
        (1, 250, False),  # the camera counts none in between
        (3, 250, False),  # a later one, whose clock was set back
        (2, 500, False),
        (2, 0, False),
    ],
)
def test_it_takes_both_clock_and_counter_to_prove_an_exposure(
    frame_id: int, device_ms: int, is_proven: bool
) -> None:
    check = ExposureCheck(100_000_000)
    reference = MatchedFrame(10**9, 1, 0, ordinal=0)
    assert not check.proves(reference)
    assert check.belongs(reference)
    assert check.proves(reference)
    later = MatchedFrame(10**9 + device_ms * 1_000_000, frame_id, 250_000_000, ordinal=1)
    assert check.proves(later) is is_proven
    if is_proven:
        assert check.belongs(later)
        assert check.proves(reference)  # an earlier one that is even later


@given(
    gaps_ms=st.lists(st.integers(250, 4000), min_size=2, max_size=6),
    step_ms=st.integers(-9000, 9000).filter(lambda step_ms: abs(step_ms) > 110),
)
def test_after_its_clock_was_set_a_camera_is_back_with_the_second_frame(
    gaps_ms: list[int], step_ms: int
) -> None:
    check = ExposureCheck(100_000_000)
    times_ms = np.cumsum([0, *gaps_ms])
    believed = [
        check.belongs(
            MatchedFrame(
                (10_000 + at_ms + (step_ms if n > 0 else 0)) * 10**6, n + 1, at_ms * 10**6, ordinal=n
            )
        )
        for n, at_ms in enumerate(times_ms.tolist())
    ]
    assert believed == [True, False] + [True] * (len(gaps_ms) - 1)


def late_by_one(times_ms: list[int]) -> list[bool]:
    """Whether frames are believed that come when the trigger after theirs is due, all but the first."""
    check = ExposureCheck(100_000_000)
    exposures = [
        MatchedFrame(10**10 + times_ms[max(n - 1, 0)] * 10**6, max(n, 1), at_ms * 10**6, ordinal=n)
        for n, at_ms in enumerate(times_ms)
    ]
    return [check.belongs(exposure) for exposure in exposures]


def test_frames_that_are_one_trigger_late_are_never_believed() -> None:
    gaps_ms = np.random.default_rng(1).integers(250, 900, 40)
    assert late_by_one(np.cumsum([0, *gaps_ms]).tolist()) == [True] + [False] * 40
    assert late_by_one(np.arange(0, 250 * 40, 250).tolist()) == [True] + [False] * 39


def test_after_a_missed_trigger_and_a_set_clock_a_camera_is_back_within_ten_stones() -> None:
    check = ExposureCheck(100_000_000)
    assert check.belongs(MatchedFrame(10**10, 1, 0, ordinal=0))
    times_ms = np.cumsum(np.random.default_rng(2).integers(250, 900, 12)).tolist()
    believed = [
        check.belongs(MatchedFrame(10**10 + (at_ms + 3000) * 10**6, n + 2, at_ms * 10**6, ordinal=n + 2))
        for n, at_ms in enumerate(times_ms)  # its counter is one behind
    ]
    assert believed == [False] * 7 + [True] * 5
