"""Grey images of the pixel formats of cameras without Mono8: layouts by hand, and against an independent packer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.cameras.pixel_formats import CONVERTED
from drivers.gige_simulator.gvsp import in_format


@pytest.mark.parametrize(
    ("name", "data", "grey"),
    [
        ("Mono10", "ff03 0000 fc00 0004", [255, 0, 63, 0]),  # 1023, 0, 252, beyond ten bits
        ("Mono12", "ff0f f00f 1000", [255, 255, 1]),
        ("Mono14", "ff3f 4000", [255, 1]),
        ("Mono16", "ffff 00ab", [255, 0xAB]),
        # 0x2aa, 0x155, 0x3ff, 0x004: bit 0 of the first pixel is bit 0 of the first byte
        ("Mono10p", "aa56f53f01", [0xAA, 0x55, 0xFF, 0x01]),
        ("Mono12p", "bcfade", [0xAB, 0xDE]),  # 0xabc, 0xdef
        ("Mono12Packed", "abfcde", [0xAB, 0xDE]),  # 0xabc, 0xdef: upper bits, lower bits of both, upper bits
        ("Mono10Packed", "ab31cd", [0xAB, 0xCD]),
        ("Mono12p", "bc0a", [0xAB]),  # the last pixel alone
        ("Mono12Packed", "ab0c", [0xAB]),
        ("Mono10p", "aa56", [0xAA]),
    ],
)
def test_layouts_by_hand(name: str, data: str, grey: list[int]) -> None:
    pixels = CONVERTED[name].grey(np.frombuffer(bytes.fromhex(data), np.uint8), len(grey))
    assert pixels.tolist() == grey


@given(
    st.sampled_from(sorted(CONVERTED)),
    st.lists(st.integers(0, 255), min_size=1, max_size=50).map(lambda values: np.array(values, np.uint8)),
)
def test_what_a_camera_packed_is_unpacked_whatever_lies_behind(name: str, grey: NDArray[np.uint8]) -> None:
    buffer = np.concatenate([in_format(grey, name), np.full(40, 0xA5, np.uint8)])
    np.testing.assert_array_equal(CONVERTED[name].grey(buffer, grey.size), grey)
