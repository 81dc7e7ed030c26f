"""The outline of a stored silhouette as SVG, made in the process `stonefall-read`."""

from pathlib import Path

import cv2
import numpy as np

from pipeline.arrays import Mask
from service.particles.renditions import stored_silhouette

STONE, UNKNOWN = 255, 128
STYLE = (
    "path{fill:none;stroke-width:2;vector-effect:non-scaling-stroke}"
    ".stone{stroke:var(--sf-outline,#d9480f)}.unknown{stroke:var(--sf-unknown,#868e96);stroke-dasharray:6 4}"
)


def outline_svg(folder: Path, camera: str) -> bytes:
    """Return the borders of stone and unknown in one view; raise `NotKeptError` where there is no silhouette."""
    labels = stored_silhouette(folder, camera)
    height, width = labels.shape
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}">'
        f"<style>{STYLE}</style>"
        f'<path class="unknown" d="{_border(labels == UNKNOWN)}"/>'
        f'<path class="stone" d="{_border(labels == STONE)}"/></svg>'
    ).encode()


def _border(mask: Mask) -> str:
    """Return the closed polygons around a region and its holes, as path data in pixels of the image.

    They run through the centres of the outermost pixels, half a pixel within the region; pixel (u, v) covers the square
    from (u, v) to (u + 1, v + 1).
    """
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    return "".join(
        "M" + "L".join(f"{u + 0.5:g} {v + 0.5:g}" for u, v in contour[:, 0]) + "Z" for contour in found
    )
