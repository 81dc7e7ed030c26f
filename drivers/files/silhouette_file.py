"""The silhouettes of one particle in one TIFF: a page for each view, of the region around the body alone.

The first page's description is JSON: format, size of the whole images, cameras and their regions.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import tifffile

from drivers.errors import RecordingError
from drivers.files.bundle_file import TIFF_DAMAGE, zstd_page
from pipeline.formats import unread_format
from pipeline.frames import CameraId, Image

FORMAT = "stonefall-silhouettes/2"
WHOLE_IMAGES_FORMAT = "stonefall-silhouettes/1"
"""The format of earlier releases, which wrote whole images; it is still read."""


def write_silhouettes(
    path: Path, regions: Mapping[CameraId, tuple[tuple[int, int], Image]], size_px: tuple[int, int]
) -> None:
    """Write the labels of each view in its region; neither durable nor atomic.

    Writing whole images takes several times as long.

    Parameters
    ----------
    regions
        At least one view: upper left corner (u, v) and labels (h, w) of its region. Labels outside of it are 0.
    size_px
        Size (W, H) of all images.
    """
    height, width = (
        max(1, *sizes) for sizes in zip(*(labels.shape for _, labels in regions.values()), strict=True)
    )
    views = [
        {"camera": camera, "offset_uv": offset_uv, "size_px": labels.shape[::-1]}
        for camera, (offset_uv, labels) in regions.items()
    ]
    page = np.zeros((height, width), np.uint8)
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(
            map(zstd_page, _pages([labels for _, labels in regions.values()], page)),
            shape=(len(regions), height, width),
            dtype=np.uint8,
            photometric="minisblack",
            description=json.dumps({"format": FORMAT, "image_size_px": size_px, "views": views}),
            metadata=None,
            software=False,
            rowsperstrip=height,
            compression="zstd",
        )


def _pages(regions: Sequence[Image], page: Image) -> Iterator[Image]:
    """Yield `page` (H, W), large enough for all regions, with one region after the other in its upper left corner."""
    for labels in regions:
        page[:] = 0
        page[: labels.shape[0], : labels.shape[1]] = labels
        yield page


def read_silhouettes(path: Path) -> dict[CameraId, Image]:
    """Read the labels (H, W) of each view.

    Raises
    ------
    RecordingError
        The file cannot be read, holds something else, or is damaged.
    """
    try:
        with tifffile.TiffFile(path) as tiff:
            document = json.loads(tiff.pages.first.description)
            pages = (page.asarray() for page in list(tiff.pages))
            if document["format"] == WHOLE_IMAGES_FORMAT:
                return dict(zip(map(CameraId, document["cameras"]), pages, strict=True))
            if document["format"] != FORMAT:
                raise RecordingError(path, f"format: {unread_format(document['format'], FORMAT)}")
            width_px, height_px = document["image_size_px"]
            silhouettes = {}
            for view, page in zip(document["views"], pages, strict=True):
                (u, v), (width, height) = view["offset_uv"], view["size_px"]
                image = silhouettes[CameraId(view["camera"])] = np.zeros((height_px, width_px), np.uint8)
                image[v : v + height, u : u + width] = page[:height, :width]
            return silhouettes
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"is not a sound TIFF of silhouettes: {err}") from err
