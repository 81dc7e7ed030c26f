"""Input and output of a U2-Net (Qin et al. 2020, Pattern Recognition 106, 107404, and its published code)."""

import numpy as np

from pipeline.arrays import FloatImage, Singles

PUBLISHED_SIZE_PX = 320
"""The published networks compute on 320 x 320, whatever the image's proportions."""
GREY_MEAN, GREY_SD = np.float32(0.485), np.float32(0.229)
"""The published code normalises a grey image by ImageNet's first channel, three times."""


def u2net_input(image: FloatImage) -> Singles:
    """Return the input (1, 3, s, s) for a grey image (s, s) in any unit: scaled to its brightest pixel, normalised."""
    brightest = max(float(image.max()), 1e-6)
    channel = (image / np.float32(brightest) - GREY_MEAN) / GREY_SD
    return np.broadcast_to(channel, (1, 3, *image.shape)).astype(np.float32)


def saliency(output: FloatImage) -> FloatImage:
    """Stretch an output between its own extremes to 0..1, as the published code does."""
    low, high = float(output.min()), float(output.max())
    return np.asarray((output - np.float32(low)) / np.float32(max(high - low, 1e-6)))
