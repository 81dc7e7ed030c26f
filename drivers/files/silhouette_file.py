"""The silhouettes of one particle in one TIFF: a page a view, of the region around the body alone.

The first page's description names the views, their regions, and the size of the whole images.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import tifffile

from drivers.errors import RecordingError
from drivers.files.bundle_file import TIFF_DAMAGE, packed
from pipeline.frames import CameraId, Image

FORMAT, OF_WHOLE_IMAGES = "stonefall-silhouettes/2", "stonefall-silhouettes/1"
"""What is written, and what was: releases before wrote whole images."""


def write_silhouettes(
    path: Path, regions: Mapping[CameraId, tuple[tuple[int, int], Image]], size_px: tuple[int, int]
) -> None:
    """Write at least one view: the upper left corner (u, v) and the labels (h, w) of a region, beyond which they are 0.

    `size_px` is (W, H) of all images. To write these whole takes several times as long.
    """
    height, width = (
        max(1, *sizes) for sizes in zip(*(seen.shape for _, seen in regions.values()), strict=True)
    )
    views = [
        {"camera": camera, "offset_uv": offset_uv, "size_px": seen.shape[::-1]}
        for camera, (offset_uv, seen) in regions.items()
    ]
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(
            map(packed, _pages([seen for _, seen in regions.values()], np.zeros((height, width), np.uint8))),
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
    """Regions, one after the other in the corner of the same page (H, W), which has room for any."""
    for seen in regions:
        page[:] = 0
        page[: seen.shape[0], : seen.shape[1]] = seen
        yield page


def read_silhouettes(path: Path) -> dict[CameraId, Image]:
    """The labels (H, W) of each view.

    Raises
    ------
    RecordingError
        The file cannot be read, is another one, or is damaged.
    """
    try:
        with tifffile.TiffFile(path) as tiff:
            document = json.loads(tiff.pages.first.description)
            pages = (page.asarray() for page in list(tiff.pages))
            if document["format"] == OF_WHOLE_IMAGES:
                return dict(zip(map(CameraId, document["cameras"]), pages, strict=True))
            if document["format"] != FORMAT:
                raise RecordingError(path, "holds no silhouettes of ours")
            width_px, height_px = document["image_size_px"]
            found = {}
            for view, page in zip(document["views"], pages, strict=True):
                (u, v), (width, height) = view["offset_uv"], view["size_px"]
                image = found[CameraId(view["camera"])] = np.zeros((height_px, width_px), np.uint8)
                image[v : v + height, u : u + width] = page[:height, :width]
            return found
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"is no sound TIFF of silhouettes: {err}") from err
