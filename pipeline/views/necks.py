"""Silhouettes of two stones that touch or cover each other: they are narrow where one ends and the other begins.

Crushed stones have no such waist, dented and two-lobed ones included; horseshoes may have one. Where two stones touch,
some view of sixteen shows it, unless one is a grain of a fifth of the other's size: that changes the volume by less
than its sigma.
"""

from collections.abc import Iterable

import cv2
import numpy as np

from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, Silhouette

NECK = 0.8
"""Depth of a neck, relative to that of the smaller body, below which there are two."""
LEVELS = 0.1 * 1.2 ** np.arange(12)
"""Depths, relative to the greatest, below which bodies may be connected."""
N_SAMPLES = 64
"""Labels that are looked at along a silhouette: a large one takes no longer."""
MIN_DEPTH_PX = 10.0
"""Half of the width of the smallest body that is not dust."""


def shows_neck(silhouettes: Iterable[Silhouette]) -> bool:
    """True when any silhouette is that of two bodies which touch or cover each other."""
    return any(_has_neck(silhouette) for silhouette in silhouettes)


def _has_neck(silhouette: Silhouette) -> bool:
    left, top, width, height = cv2.boundingRect(silhouette.labels)
    step = max(1, max(width, height) // N_SAMPLES)
    seen = silhouette.labels[top : top + height : step, left : left + width : step]
    labels = cv2.copyMakeBorder(seen, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=int(OUTSIDE))
    depths = cv2.distanceTransform(cv2.threshold(labels, 0, 1, cv2.THRESH_BINARY)[1], cv2.DIST_L2, 3)
    for level in LEVELS * depths.max():
        n_parts, parts = cv2.connectedComponents((depths > level).view(np.uint8))
        if n_parts > 2:
            is_body = (depths >= max(level / NECK, MIN_DEPTH_PX / step)) & (labels == INSIDE)
            if len(np.unique(parts[is_body])) > 1:
                return True
    return False
