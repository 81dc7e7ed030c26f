"""Make grey images of the pixel formats of cameras that have no Mono8: the upper eight bits of each pixel.

Bit layouts are those of the Pixel Format Naming Convention (PFNC 2.1) and, of `Packed`, of GigE Vision 1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Layout of pixels in memory: `upper_bits` turns bytes of whole groups (N, group_bytes) into (N, pixels)."""

    group_bytes: int
    group_pixels: int
    upper_bits: Callable[[Bytes], Bytes]

    def grey(self, data: Bytes, n_pixels: int) -> Bytes:
        """Return the upper eight bits (n_pixels,) of the pixels that `data` (N,) begins with."""
        n_groups = -(-n_pixels // self.group_pixels)
        groups = np.zeros((n_groups, self.group_bytes), np.uint8)
        used = data[: groups.size]
        groups.reshape(-1)[: used.size] = used  # the last group may be sent in part
        return self.upper_bits(groups).reshape(-1)[:n_pixels]


def _unpacked(n_bits: int) -> PixelFormat:
    """Return the format of pixels in two bytes each, the lower one first."""

    def upper_bits(groups: Bytes) -> Bytes:
        return (groups.view("<u2") >> (n_bits - 8)).astype(np.uint8)

    return PixelFormat(2, 1, upper_bits)


def _upper_bits_of_10p(groups: Bytes) -> Bytes:
    """Return the upper bits of four pixels in five bytes, each beginning with the lowest bit that is free."""
    a, b, c, d, e = groups.T
    return np.stack((a >> 2 | b << 6, b >> 4 | c << 4, c >> 6 | d << 2, e), axis=1)


def _upper_bits_of_12p(groups: Bytes) -> Bytes:
    """Return the upper bits of two pixels in three bytes, each beginning with the lowest bit that is free."""
    a, b, c = groups.T
    return np.stack((a >> 4 | b << 4, c), axis=1)


_PACKED = PixelFormat(3, 2, lambda groups: groups[:, ::2])
"""Two pixels in three bytes: upper bits, the lower bits of both, upper bits."""

CONVERTED: dict[str, PixelFormat] = {
    "Mono10p": PixelFormat(5, 4, _upper_bits_of_10p),
    "Mono12p": PixelFormat(3, 2, _upper_bits_of_12p),
    "Mono10Packed": _PACKED,
    "Mono12Packed": _PACKED,
    "Mono10": _unpacked(10),
    "Mono12": _unpacked(12),
    "Mono14": _unpacked(14),
    "Mono16": _unpacked(16),
}
"""By the name of the format, the smallest on the wire first."""
