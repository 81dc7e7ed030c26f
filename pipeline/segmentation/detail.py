"""Fine detail of an image, which the wall has none of: it is out of focus by a hundred pixels, and a stone is not.

So what has more detail than noise explains is body, however alike the grey levels of body and wall are.
"""

import cv2
import numpy as np

from pipeline.arrays import GreyImage, Mask
from pipeline.segmentation.noise import SensorNoise

WINDOW = 7
"""Edge of the window, in pixels of the grid that is looked at, in which grey levels are compared with each other."""
DETAIL_SIGMAS = 3.0
"""Deviation within a window, in those of noise, from which on it shows detail: of noise alone one in 10^30 has it."""
EVEN = 9
"""Gaps in the detail up to this width are even places of a body."""
MAX_BORDER_SHARE = 0.02
"""Share of the border of a region with detail from which on it is the wall's, or that of the light."""
BARE_SHARE, BRIGHT_SHARE = np.float32(0.01), 0.5
"""Deviation of a window's mean from the background, as a share of it, up to which it is wall if it has no detail; and
the least background, as a share of the brightest, of which that can be said: before an aperture black is as black."""
HALO = WINDOW // 2 + 2
"""Width beside a body in which a window, or blur, reaches its edge."""
WALL_SIGMAS = 2.0
"""Standard deviation of grey levels, relative to noise, up to which a hole shows the wall: a hundred pixels tell it."""
RIM_PX, MIN_HOLE_PX = 3, 100
"""Pixels beside the rim of a hole that blur mixes, and the least left of one that is seen through."""


def told_by_detail(
    seen: GreyImage, expected: GreyImage, gain: float, noise: SensorNoise, even: int = EVEN
) -> tuple[Mask, Mask]:
    """Mark cells (h, w) that are surely within a body, and those that are surely wall, by the detail around them.

    None are marked where the wall has any, too.

    `seen` and `expected` (h, w) are grey levels with the body and without, `gain` not applied. The wall reaches to the
    border. Gaps in the detail, up to `even` cells wide, are even places of a body.
    """
    background = np.float32(gain) * expected.astype(np.float32)
    residual = seen - background
    mean, square = cv2.blur(residual, (WINDOW, WINDOW)), cv2.blur(residual * residual, (WINDOW, WINDOW))
    limit = np.float32(DETAIL_SIGMAS**2) * noise.variance_grey2(background)
    has_detail = np.asarray(square - mean * mean > limit).view(np.uint8)
    border = np.concatenate([has_detail[0], has_detail[-1], has_detail[:, 0], has_detail[:, -1]])
    if np.mean(border) > MAX_BORDER_SHARE:
        none = np.zeros(seen.shape, np.bool_)
        return none, none
    closed = cv2.morphologyEx(has_detail, cv2.MORPH_CLOSE, np.ones((even, even), np.uint8))
    core = np.asarray(cv2.erode(closed, np.ones((2 * HALO + 1,) * 2, np.uint8), borderValue=0) != 0)
    is_bright = background > BRIGHT_SHARE * background.max()
    return core, np.asarray((closed == 0) & is_bright & (np.abs(mean) < BARE_SHARE * background))


def is_wall(hole: GreyImage, image: GreyImage, expected: GreyImage, gain: float, noise: SensorNoise) -> bool:
    """True when the pixels of a hole (h, w), those beside its rim apart, show the wall and nothing but noise."""
    inner = cv2.erode(hole, np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)) != 0
    if np.count_nonzero(inner) < MIN_HOLE_PX:
        return False
    background = np.float32(gain) * expected[inner].astype(np.float32)
    deviation = float(np.std(image[inner] - background))
    return deviation**2 < WALL_SIGMAS**2 * float(noise.variance_grey2(background).mean())
