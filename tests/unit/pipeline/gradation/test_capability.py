"""Capability indices by hand, and the coverage of their interval."""

import numpy as np
import pytest

from pipeline.gradation.capability import capability

ALTERNATING = [9.0, 11.0] * 10


def test_the_nearest_limit_counts() -> None:
    found = capability(ALTERNATING, 4.0, 13.0)
    assert found is not None
    assert found.cpk == pytest.approx(3 / (3 * 2 / 1.128))
    assert found.ppk == pytest.approx(3 / (3 * np.std(ALTERNATING, ddof=1)))
    assert (found.ppk_low + found.ppk_high) / 2 == pytest.approx(found.ppk)
    assert found.ppk_high - found.ppk == pytest.approx(
        1.95996 * np.sqrt(1 / 180 + found.ppk**2 / 38), rel=1e-5
    )
    assert capability(ALTERNATING, upper=13.0) == found
    outside = capability(ALTERNATING, 11.0)
    assert outside is not None
    assert outside.cpk < 0


def test_no_index_without_what_it_needs() -> None:
    assert capability(ALTERNATING) is None
    assert capability(ALTERNATING[1:], 4.0) is None
    assert capability([10.0] * 30, 4.0) is None


def test_the_interval_has_its_coverage() -> None:
    rng = np.random.default_rng(11)
    found = [capability(rng.normal(0, 1, 30), -3.0, None) for _ in range(1000)]
    hits = [each.ppk_low <= 1.0 <= each.ppk_high for each in found if each is not None]
    assert np.mean(hits) == pytest.approx(0.95, abs=0.025)
