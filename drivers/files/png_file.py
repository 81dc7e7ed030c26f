"""Read and write 8-bit grey PNG, the format of imported and exported images."""

from pathlib import Path

import imagecodecs
import numpy as np

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from pipeline.frames import Image

MAX_PNG_BYTES = 64 << 20
"""Largest file that is decoded; an image of a camera has a fiftieth."""


def read_png(path: Path, size_px: tuple[int, int]) -> Image:
    """Read an image (H, W) that must have the size `size_px` (W, H).

    Raises
    ------
    RecordingError
        The file cannot be read, is no sound PNG, is not 8-bit grey or has another size.
    """
    try:
        image = imagecodecs.png_decode(read_bounded(path, MAX_PNG_BYTES))
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    except (imagecodecs.PngError, ValueError, MemoryError) as err:
        raise RecordingError(path, f"is not a sound PNG: {err}") from err
    if image.ndim != 2:
        raise RecordingError(path, "is a colour image; 8-bit grey is needed")
    if image.dtype != np.uint8:
        raise RecordingError(path, f"is a {8 * image.itemsize}-bit image; 8-bit grey is needed")
    if image.shape != size_px[::-1]:
        height_px, width_px = image.shape
        raise RecordingError(
            path, f"has {width_px}x{height_px} pixels; the rig's camera has {size_px[0]}x{size_px[1]}"
        )
    return np.asarray(image)


def write_png(path: Path, image: Image) -> None:
    """Write an image (H, W); neither durable nor atomic."""
    path.write_bytes(imagecodecs.png_encode(image, level=1))  # level 9 saves 5 % for ten times the work
