import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bundling.exposure_check import LARGEST_ID_STEP, Exposure, ExposureCheck, id_step


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
    assert check.belongs(Exposure(epoch_ns, 1, at_ns, ordinal=0))
    for gap_s in gaps_s:
        gap_ns = round(gap_s * 1e9)
        at_ns += gap_ns
        epoch_ns += round(gap_ns * (1 + drift))
        assert check.belongs(Exposure(epoch_ns, 2, at_ns, ordinal=1))


def test_without_a_trusted_frame_it_takes_two_that_agree() -> None:
    check = ExposureCheck(100_000_000)
    assert not check.belongs(Exposure(7_000_000_000, 1, 0, ordinal=1))
    assert not check.belongs(Exposure(7_500_000_000, 1, 250_000_000, ordinal=1))
    assert check.belongs(Exposure(7_750_000_000, 1, 500_000_000, ordinal=1))


def test_a_camera_without_a_clock_cannot_be_checked() -> None:
    check = ExposureCheck(100_000_000)
    assert all(check.belongs(Exposure(0, 1, at_ns, ordinal=1)) for at_ns in (0, 10, 10**12))


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
    reference = Exposure(10**9, 1, 0, ordinal=0)
    assert not check.proves(reference)
    assert check.belongs(reference)
    assert check.proves(reference)
    later = Exposure(10**9 + device_ms * 1_000_000, frame_id, 250_000_000, ordinal=1)
    assert check.proves(later) is is_proven
    if is_proven:
        assert check.belongs(later)
        assert check.proves(reference)  # an earlier one that is even later
