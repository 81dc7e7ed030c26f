"""Distances between pixels, against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from support.extents import examples

from pipeline.views.interpolation import interpolate


@examples(0.3)
@given(seed=st.integers(0, 999), height=st.integers(2, 9), width=st.integers(2, 9))
def test_values_are_linear_between_pixels_and_the_border_s_beyond(seed: int, height: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(height, width)).astype(np.float32)
    seen = rng.uniform(-30, 90, size=(4, 40)).astype(np.float32)
    at, weights, found = np.empty(40, np.int32), np.empty((2, 40), np.float32), np.zeros(40, np.float32)
    interpolate(image.reshape(-1), height, width, np.float32(1 / 6), seen, 39, at, weights, found)
    expected = map_coordinates(image, seen[1::-1] / 6, order=1, mode="nearest")
    assert found[:39] == pytest.approx(expected[:39], abs=1e-4)
    assert found[39] == 0
