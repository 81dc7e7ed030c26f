"""The silhouettes of one particle in one TIFF: a page a view, the cameras' names in the first page's description."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import tifffile

from drivers.bundle_file import TIFF_DAMAGE
from drivers.errors import RecordingError
from pipeline.frames import CameraId, Image

FORMAT = "stonefall-silhouettes/1"


def write_silhouettes(
    path: Path, cameras: Sequence[CameraId], labels: Iterable[Image], size_px: tuple[int, int]
) -> None:
    """Write the labels (H, W) of at least one view, those of each of `cameras`; `size_px` is (W, H)."""
    with tifffile.TiffWriter(path) as tiff:
        tiff.write(
            iter(labels),
            shape=(len(cameras), *size_px[::-1]),
            dtype=np.uint8,
            photometric="minisblack",
            description=json.dumps({"format": FORMAT, "cameras": list(cameras)}),
            metadata=None,
            software=False,
            rowsperstrip=size_px[1],
            # 0.4 ms a view, PNG takes 5
            compression="zstd",
            compressionargs={"level": 1},
            maxworkers=1,
        )


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
            if not isinstance(document, dict) or document.get("format") != FORMAT:
                raise RecordingError(path, "holds no silhouettes of ours")
            cameras = [CameraId(camera) for camera in document["cameras"]]
            return {camera: page.asarray() for camera, page in zip(cameras, list(tiff.pages), strict=True)}
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"is no sound TIFF of silhouettes: {err}") from err
