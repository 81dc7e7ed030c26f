"""Scores of a network on views it never saw, per hard case, against the truth."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.arrays import FloatImage, Singles
from pipeline.evaluation.hard_cases import HardCase, HardView, hard_view
from pipeline.segmentation.background import coarsen
from pipeline.segmentation.light import flash_gain
from pipeline.segmentation.network import MAX_RELATIVE
from pipeline.training.image_layers import VIEW_PX

MARGIN_SHARE = 0.2
"""Margin of the region around the bodies, as a share of their extent."""
CONFIDENT = 0.95
"""Probability beyond which the network is sure of body; below one less this it is sure of wall."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ValidationView:
    """A region as a network sees it, and the truth."""

    case: HardCase
    view: Singles  # (2, VIEW_PX, VIEW_PX)
    coverage: FloatImage  # (VIEW_PX, VIEW_PX)


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Scores over the views of one case."""

    iou: float  # mean over views, at P(body) > 1/2
    worst_iou: float
    surely_wrong: float  # share of all pixels that are wrong though the network was sure


def validation_view(case: HardCase, seed: int, *, with_background: bool = True) -> ValidationView:
    """Return the region around all bodies of `hard_view(case, seed)`."""
    hard = hard_view(case, seed, with_background=with_background)
    image = hard.frame.image.astype(np.float32)
    known = hard.background.get(hard.frame.camera)
    if known is None:
        wall = float(np.quantile(coarsen(image), 0.8))
        channels = [image / np.float32(wall)]
    else:
        gain = flash_gain(coarsen(image), known.coarse)
        wall = gain * known.typical
        channels = [image / np.float32(wall), known.mean * np.float32(gain / wall)]
    rows, columns = _region(hard)
    view = np.zeros((2, VIEW_PX, VIEW_PX), np.float32)
    for channel, values in enumerate(channels):
        view[channel] = np.clip(_reduced(values[rows, columns]), 0, MAX_RELATIVE)
    return ValidationView(case=case, view=view, coverage=_reduced(hard.coverage[rows, columns]))


def score(
    views: Iterable[ValidationView], probability: Callable[[Singles], FloatImage]
) -> dict[HardCase, Score]:
    """Score `probability`, from a view (2, VIEW_PX, VIEW_PX) to P(body) (VIEW_PX, VIEW_PX), on each case."""
    ious: dict[HardCase, list[float]] = {}
    surely_wrong: dict[HardCase, list[float]] = {}
    for view in views:
        found, is_body = probability(view.view), view.coverage > 0.5
        union = np.count_nonzero((found > 0.5) | is_body)
        both = np.count_nonzero((found > 0.5) & is_body)
        wrong = np.where(is_body, found < 1 - CONFIDENT, found > CONFIDENT)
        # a pixel at the edge is neither right nor wrong
        clear = np.abs(view.coverage - 0.5) > 0.4
        ious.setdefault(view.case, []).append(both / union if union else 1.0)
        surely_wrong.setdefault(view.case, []).append(float(np.mean(wrong & clear)))
    return {
        case: Score(
            iou=float(np.mean(values)),
            worst_iou=float(np.min(values)),
            surely_wrong=float(np.mean(surely_wrong[case])),
        )
        for case, values in ious.items()
    }


def _region(hard: HardView) -> tuple[slice, slice]:
    """Return rows and columns of a square around the bodies, at least as large as the view, within the image."""
    height, width = hard.coverage.shape
    x, y, box_width, box_height = cv2.boundingRect((hard.coverage > 0.5).astype(np.uint8))
    side = round(max(VIEW_PX, max(box_width, box_height) * (1 + 2 * MARGIN_SHARE)))
    side = min(side, height, width)
    top = int(np.clip(y + box_height / 2 - side / 2, 0, height - side))
    left = int(np.clip(x + box_width / 2 - side / 2, 0, width - side))
    return slice(top, top + side), slice(left, left + side)


def _reduced(region: FloatImage) -> FloatImage:
    return np.asarray(cv2.resize(region, (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_AREA))
