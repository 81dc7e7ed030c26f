"""Folders of images: a folder for each exposure, and in it an image for each camera."""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.image_file import SUFFIXES
from pipeline.frames import CameraId

SYSTEM_NAMES = frozenset({"__macosx", "thumbs.db", "desktop.ini", "@eadir"})
"""Names, in lower case, of what operating systems leave in folders, beside those that begin with a dot."""


def exposure_folders(source: Path) -> tuple[list[Path], list[Path]]:
    """Return the folders in a folder, and the files beside them; both in the order of their names, numbers by value.

    What operating systems leave is in neither.

    Raises
    ------
    RecordingError
        `source` is no folder, or has none.
    """
    if not source.is_dir():
        raise RecordingError(source, "is not a folder")
    found = _visible(source)
    folders = [path for path in found if path.is_dir()]
    if not folders:
        raise RecordingError(source, "has no folder of images")
    return folders, [path for path in found if not path.is_dir()]


def camera_images(
    folder: Path, camera_ids: Collection[CameraId] | None = None
) -> tuple[dict[CameraId, Path], list[Path]]:
    """Return the image of each camera in the folder of an exposure, and what else is there.

    Parameters
    ----------
    camera_ids
        The cameras there are; None: any.

    Raises
    ------
    RecordingError
        There is no image, or one of no camera, or two of one camera.
    """
    images: dict[CameraId, Path] = {}
    others = []
    for path in _visible(folder):
        if path.suffix.lower() not in SUFFIXES or path.is_dir():
            others.append(path)
            continue
        camera = CameraId(path.stem)
        if camera_ids is not None and camera not in camera_ids:
            raise RecordingError(path, f"{path.stem!r} is no camera of the rig")
        if camera in images:
            raise RecordingError(path, f"is a second image of camera {camera}, beside {images[camera].name}")
        images[camera] = path
    if not images:
        raise RecordingError(folder, "has no image <camera id>.png or .tif")
    return images, others


def _visible(folder: Path) -> Sequence[Path]:
    """Return the files and folders in a folder, but for those of `SYSTEM_NAMES`, in the order of their names."""
    return sorted(
        (
            path
            for path in folder.iterdir()
            if not path.name.startswith(".") and path.name.lower() not in SYSTEM_NAMES
        ),
        key=_sort_key,
    )


def _sort_key(path: Path) -> tuple[list[tuple[int, str]], str]:
    return [(int(number or 0), word) for number, word in re.findall(r"(\d+)|(\D+)", path.name)], path.name
