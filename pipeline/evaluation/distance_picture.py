"""A picture of a measured surface's errors: the mesh from two sides, coloured by its distance to the true surface."""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from pipeline.arrays import Floats, Values
from pipeline.preview import BOTTOM_RGB, INK_RGB, TOP_RGB, VIEW_DIRECTION, render_preview

Picture = NDArray[np.uint8]
"""RGB (H, W, 3)."""

VIEW_PX = 560
"""Edge of each view."""
TITLE_PX, BAR_PX = 56, 150
"""Height of the strip above the views, width of the one beside them."""
PALETTE_RGB = np.array(
    [(33, 60, 140), (67, 147, 195), (160, 205, 228), (240, 240, 236), (247, 183, 146), (214, 96, 77), (128, 10, 38)]
) / 255.0  # fmt: skip
"""Colours from inside by the limit, over none, to outside by the limit."""
LIMITS_MM = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
SHOWN_SHARE = 0.98
"""Share of the vertices whose distance is within the limit of the colours."""
SCALE = 2
"""Factor by which lettering is drawn larger and then shrunk."""


def distance_picture(mesh: trimesh.Trimesh, distances_mm: Values, title: str) -> Picture:
    """Draw a mesh whose vertices have signed distances (N,), seen from two opposite sides.

    The colours end at the least of `LIMITS_MM` that almost all vertices stay below; the bar says which.
    """
    reached_mm = float(np.quantile(np.abs(distances_mm), SHOWN_SHARE))
    limit_mm = next((limit for limit in LIMITS_MM if limit >= reached_mm), LIMITS_MM[-1])
    colors_rgb = _colors_rgb(distances_mm / limit_mm)
    x, y, z = VIEW_DIRECTION
    views = [
        render_preview(mesh.vertices, mesh.faces, VIEW_PX, colors_rgb=colors_rgb, view_direction=direction)
        for direction in ((x, y, z), (-x, -y, -z))
    ]
    bar = _bar(limit_mm, f"{distances_mm.min():+.3f}", f"{distances_mm.max():+.3f}")
    body = np.hstack([*views, bar])
    strip = np.full((TITLE_PX, body.shape[1], 3), np.rint(255 * np.array(TOP_RGB)), np.uint8)
    return np.vstack([with_lettering(strip, [(title, 22, TITLE_PX // 2 + 7, 0.62)]), body])


def _colors_rgb(relative: Values) -> Floats:
    """Return the colours (N, 3), 0..1, of values (N,) from -1 to 1 and beyond."""
    stops = np.linspace(-1, 1, len(PALETTE_RGB))
    return np.column_stack([np.interp(relative, stops, PALETTE_RGB[:, channel]) for channel in range(3)])


def _bar(limit_mm: float, least: str, greatest: str) -> Picture:
    """Draw the scale of colours from the limit down to its negative; extremes above and below."""
    backdrop = np.linspace(TOP_RGB, BOTTOM_RGB, VIEW_PX)[:, None].repeat(BAR_PX, axis=1)
    strip = np.rint(255 * backdrop).astype(np.uint8)
    top, bottom, left, right = 70, VIEW_PX - 70, 20, 46
    relative = np.linspace(1, -1, bottom - top)
    strip[top:bottom, left:right] = np.rint(255 * _colors_rgb(relative))[:, None]
    cv2.rectangle(strip, (left, top), (right, bottom), INK_RGB, 1)
    texts = [(f"max {greatest}", left, top - 14, 0.45), (f"min {least}", left, bottom + 24, 0.45)]
    for share in (1.0, 0.5, 0.0, -0.5, -1.0):
        row = round(top + (1 - share) / 2 * (bottom - top))
        cv2.line(strip, (right, row), (right + 5, row), INK_RGB, 1)
        label = f"{share * limit_mm:+.3g} mm" if share else "0"
        texts.append((label, right + 10, row + 5, 0.45))
    return with_lettering(strip, texts)


def with_lettering(picture: Picture, texts: list[tuple[str, int, int, float]]) -> Picture:
    """Return the picture with texts (text, left, base line, scale) in smooth letters."""
    height, width = picture.shape[:2]
    large = cv2.resize(picture, (SCALE * width, SCALE * height), interpolation=cv2.INTER_NEAREST)
    for text, left, base, scale in texts:
        cv2.putText(
            large,
            text,
            (SCALE * left, SCALE * base),
            cv2.FONT_HERSHEY_SIMPLEX,
            SCALE * scale,
            INK_RGB,
            SCALE,
            cv2.LINE_AA,
        )
    return np.asarray(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
