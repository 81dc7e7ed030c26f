"""The depths that each pass tries: as deep as dents are, in steps no coarser than it says."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.refinement.passes import PASSES


@given(size_mm=st.floats(2.0, 60.0))
def test_a_pass_tries_depths_around_the_one_before_in_steps_no_larger_than_it_says(size_mm: float) -> None:
    for each in PASSES:
        depths_mm = each.depths_mm(size_mm)
        assert len(depths_mm) % 8 == 0
        assert depths_mm[0] < 0 < depths_mm[-1]
        assert np.diff(depths_mm).max() <= each.step_mm * (1 + 1e-9)


@given(size_mm=st.floats(2.0, 35.0))
def test_the_first_pass_reaches_the_bottom_of_a_dent_of_a_sixth_of_the_stone(size_mm: float) -> None:
    assert PASSES[0].depths_mm(size_mm)[-1] >= size_mm / 6
