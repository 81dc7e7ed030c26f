"""A picture of one view's silhouettes by several segmenters: outlines and unknown pixels beside the true edge."""

from collections.abc import Mapping

import cv2
import numpy as np

from pipeline.arrays import Flags, Mask, PointsUV, Values
from pipeline.evaluation.distance_picture import Picture, with_lettering
from pipeline.evaluation.silhouette_errors import TrueEdge
from pipeline.frames import Image
from pipeline.preview import INK_RGB, TOP_RGB
from pipeline.segmentation.silhouette import UNKNOWN, Silhouette, is_beside_gap

PANEL_PX = 460
"""Edge of the square that shows a segmenter's silhouette."""
TITLE_PX, CAPTION_PX = 44, 48
MARGIN_SHARE = 0.12
"""Margin around what is shown, as a share of its larger side."""
COLUMNS = 3
FOUND_RGB, TRUE_RGB, HIDDEN_RGB, UNKNOWN_RGB = (228, 26, 28), (0, 158, 60), (45, 110, 225), (255, 160, 0)
TINT = 0.55
"""Strength of the colour over unknown pixels."""
SUBPIXEL_BITS = 4
"""Fractional bits of the coordinates that lines are drawn between."""


def silhouette_picture(
    image: Image,
    truth: TrueEdge,
    shown: Mask,
    found: Mapping[str, tuple[Silhouette, str]],
    title: str,
) -> Picture:
    """Draw one panel for each segmenter: name -> its silhouette and a remark.

    The true edge is green where it is visible and blue where it is not, the outline found is red, and
    pixels that the segmenter calls unknown are orange. The panels show all pixels (H, W) that are `shown`,
    and a margin.
    """
    left, top, width, height = cv2.boundingRect(shown.astype(np.uint8))
    side_px = max(width, height) * (1 + 2 * MARGIN_SHARE)
    scale = PANEL_PX / side_px
    corner_uv = np.array([left, top]) + (np.array([width, height]) - side_px) / 2
    panels = [
        np.vstack([_panel(image, truth, silhouette, corner_uv, scale), _caption(name, remark)])
        for name, (silhouette, remark) in found.items()
    ]
    blank = np.full_like(panels[0], 255)
    panels += [blank] * (-len(panels) % COLUMNS)
    rows = [np.hstack(panels[first : first + COLUMNS]) for first in range(0, len(panels), COLUMNS)]
    return np.vstack([_heading(title, rows[0].shape[1]), *rows])


def _panel(image: Image, truth: TrueEdge, silhouette: Silhouette, corner_uv: Values, scale: float) -> Picture:
    """Draw the square of the image that begins at `corner_uv`, enlarged by `scale`, with lines over it."""
    # pixel centres have integer coordinates in both images
    shift_uv = (0.5 - corner_uv) * scale - 0.5
    to_panel = np.array([[scale, 0, shift_uv[0]], [0, scale, shift_uv[1]]])
    size = (PANEL_PX, PANEL_PX)
    grey = cv2.warpAffine(image, to_panel, size, flags=cv2.INTER_LINEAR, borderValue=255)
    unknown = (silhouette.label_image() == UNKNOWN).astype(np.uint8)
    is_unknown = cv2.warpAffine(unknown, to_panel, size, flags=cv2.INTER_NEAREST)[..., None] > 0
    tinted = (1 - TINT) * grey[..., None] + TINT * np.array(UNKNOWN_RGB)
    panel = np.where(is_unknown, tinted, grey[..., None]).astype(np.uint8)
    after = np.roll(truth.is_visible, -1) & truth.is_visible
    _draw(panel, truth.points_uv * scale + shift_uv, after, TRUE_RGB)
    _draw(panel, truth.points_uv * scale + shift_uv, ~after, HIDDEN_RGB)
    outline_uv = silhouette.outline_uv
    if len(outline_uv):
        is_gap = is_beside_gap(outline_uv)
        _draw(panel, outline_uv * scale + shift_uv, ~(is_gap & np.roll(is_gap, -1)), FOUND_RGB)
    return panel


def _draw(panel: Picture, points: PointsUV, is_drawn: Flags, color: tuple[int, int, int]) -> None:
    """Draw the pieces of a closed line that lead from a point (N, 2) that `is_drawn` to the next one."""
    fixed = np.rint(points * 2**SUBPIXEL_BITS).astype(np.int32)
    pieces = np.stack([fixed, np.roll(fixed, -1, axis=0)], axis=1)[is_drawn]
    cv2.polylines(panel, list(pieces), False, color, 1, cv2.LINE_AA, SUBPIXEL_BITS)


def _caption(name: str, remark: str) -> Picture:
    strip = np.full((CAPTION_PX, PANEL_PX, 3), np.rint(255 * np.array(TOP_RGB)), np.uint8)
    return with_lettering(strip, [(name, 10, 19, 0.5), (remark, 10, 38, 0.38)])


def _heading(title: str, width: int) -> Picture:
    """Draw the title, and the legend of the colours at the right."""
    strip = np.full((TITLE_PX, width, 3), np.rint(255 * np.array(TOP_RGB)), np.uint8)
    legend = (
        ("found", FOUND_RGB),
        ("true", TRUE_RGB),
        ("true, no contrast", HIDDEN_RGB),
        ("unknown", UNKNOWN_RGB),
    )
    texts, left = [(title, 10, 28, 0.58)], width - 480
    for name, color in legend:
        cv2.rectangle(strip, (left, 16), (left + 14, 28), color, cv2.FILLED)
        cv2.rectangle(strip, (left, 16), (left + 14, 28), INK_RGB, 1)
        texts.append((name, left + 21, 27, 0.42))
        left += 32 + 8 * len(name)
    return with_lettering(strip, texts)
