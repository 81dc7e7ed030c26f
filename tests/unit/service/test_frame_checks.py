import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.frame_checks import LARGEST_ID_STEP, ExposureCheck, id_step


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
    assert check.belongs(epoch_ns, at_ns, is_first_trigger=True)
    for gap_s in gaps_s:
        gap_ns = round(gap_s * 1e9)
        at_ns += gap_ns
        epoch_ns += round(gap_ns * (1 + drift))
        assert check.belongs(epoch_ns, at_ns, is_first_trigger=False)


def test_without_a_trusted_frame_it_takes_two_that_agree() -> None:
    check = ExposureCheck(100_000_000)
    assert not check.belongs(7_000_000_000, 0, is_first_trigger=False)
    assert not check.belongs(7_500_000_000, 250_000_000, is_first_trigger=False)
    assert check.belongs(7_750_000_000, 500_000_000, is_first_trigger=False)


def test_a_camera_without_a_clock_cannot_be_checked() -> None:
    check = ExposureCheck(100_000_000)
    assert all(check.belongs(0, at_ns, is_first_trigger=False) for at_ns in (0, 10, 10**12))
