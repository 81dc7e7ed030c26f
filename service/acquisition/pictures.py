"""Pictures of the latest frames, made in the process `stonefall-draw`."""

from collections.abc import Sequence

import cv2
import numpy as np

from pipeline.frames import Image

SHEET_COLUMNS = 4
SHEET_TILE_PX = 320
"""Width of each camera's picture in the contact sheet."""
SHEET_GREY = 128
"""Where a camera has no picture."""
SHEET_QUALITY = 80
"""Quality of the JPEG: people look at it, nothing is measured in it."""


def snapshot_png(image: Image) -> bytes:
    """Return the latest frame of a camera as PNG; smaller than the others."""
    _, encoded = cv2.imencode(".png", image)
    return encoded.tobytes()


def subsampled(image: Image) -> Image:
    """Return every nth pixel: a little more than the contact sheet shows, and little to hand to its process."""
    step = max(1, image.shape[1] * 2 // (3 * SHEET_TILE_PX))
    return np.ascontiguousarray(image[::step, ::step])


def contact_sheet_jpg(images: Sequence[Image | None]) -> bytes:
    """Return all images as one JPEG, `SHEET_COLUMNS` a row; the first that is there gives the shape of all."""
    height_px, width_px = next((image.shape[:2] for image in images if image is not None), (3, 4))
    tile_px = (SHEET_TILE_PX, round(SHEET_TILE_PX * height_px / width_px))
    n_rows = -(-len(images) // SHEET_COLUMNS)
    sheet = np.full((n_rows * tile_px[1], SHEET_COLUMNS * tile_px[0]), SHEET_GREY, np.uint8)
    for number, image in enumerate(images):
        if image is not None:
            row, column = divmod(number, SHEET_COLUMNS)
            top, left = row * tile_px[1], column * tile_px[0]
            tile = sheet[top : top + tile_px[1], left : left + tile_px[0]]
            tile[:] = cv2.resize(image, tile_px, interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, SHEET_QUALITY])
    return encoded.tobytes()
