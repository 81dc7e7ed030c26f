"""What a U2-Net expects and returns (Qin et al. 2020, Pattern Recognition 106, 107404, and its published code)."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

PUBLISHED_SIZE_PX = 320
"""The published networks compute on 320 x 320, whatever the image's proportions."""
GREY_MEAN, GREY_SD = np.float32(0.485), np.float32(0.229)
"""The published code normalises a grey image by ImageNet's first channel, three times."""


def u2net_input(image: Array) -> Array:
    """(1, 3, s, s) of a grey image (s, s) in any unit: a share of its brightest pixel, then normalised."""
    brightest = max(float(image.max()), 1e-6)
    channel = (image / np.float32(brightest) - GREY_MEAN) / GREY_SD
    return np.broadcast_to(channel, (1, 3, *image.shape)).astype(np.float32)


def saliency(output: Array) -> Array:
    """0..1 over the image: the published code stretches each output between its own extremes."""
    low, high = float(output.min()), float(output.max())
    return np.asarray((output - np.float32(low)) / np.float32(max(high - low, 1e-6)))
