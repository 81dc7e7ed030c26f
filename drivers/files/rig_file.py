"""Read and write rig files: the JSON document of `pipeline.rig.document` on disk, and cameras of other programs."""

from pathlib import Path

import cv2
import numpy as np

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from drivers.files.durable import MAX_JSON_BYTES, read_json, write_json
from pipeline.arrays import Floats
from pipeline.errors import RigError
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.rig.document import rig_from_document
from pipeline.rig.foreign import Size, from_blender, from_colmap, from_matrices, from_opencv
from pipeline.rig.placing import Entry, Placement, placed_rig

OPENCV_SUFFIXES = (".yml", ".yaml", ".xml")
NESTING = ("[", "{", "<", "- ")
MOST_CHARACTERS, MOST_NESTING = 1_000_000, 2000
"""Bounds of a file of OpenCV, whose parsers end the process where elements are nested too deeply."""
OPENCV_NAMES = {
    "K": ("camera_matrix", "cameraMatrix", "K"),
    "distortion": ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D"),
    "R": ("R", "rvec", "rotation"),
    "t": ("T", "tvec", "t", "translation"),
}
"""Names that examples of OpenCV give the parts of a camera; the first that is there counts."""


def read_rig(path: Path) -> RigCalibration:
    """Read a rig file.

    Raises
    ------
    RecordingError
        Names the file and the field that is damaged, missing or implausible.
    """
    document = read_json(path)
    try:
        return rig_from_document(document)
    except RigError as err:
        raise RecordingError(path, str(err)) from err


def write_rig(path: Path, rig: RigCalibration) -> None:
    """Write a rig with its checksum, durably."""
    write_json(path, rig_to_document(rig))


def is_rig_file(path: Path) -> bool:
    """True unless `read_foreign_rig` is meant: for a folder, a JSON document with `frames`, and text."""
    if path.is_dir() or not path.exists():
        return not path.exists()
    try:
        document = read_json(path)
    except RecordingError:
        return path.suffix.lower() == ".json"
    return not (isinstance(document, dict) and "frames" in document)


def read_foreign_rig(path: Path, size_px: Size, placement: Placement) -> RigCalibration:
    """Read the cameras that another program wrote.

    Parameters
    ----------
    path
        A folder with the cameras.txt and images.txt of COLMAP, or with a file <camera id>.yml or .xml of OpenCV for
        each camera; a transforms.json; or a text of matrices. `pipeline.rig.foreign` describes each.
    size_px
        Width and height of the images, where the files do not tell.

    Raises
    ------
    RecordingError
        Names the file and what is missing, wrong or implausible.
    """
    try:
        return placed_rig(path.name, _entries(path, size_px), placement)
    except RigError as err:
        raise RecordingError(path, f"{err} ({placement})") from err


def _entries(path: Path, size_px: Size) -> list[Entry]:
    if path.is_dir():
        if (path / "cameras.txt").exists():
            return from_colmap(_read_text(path / "cameras.txt"), _read_text(path / "images.txt"))
        files = sorted(each for each in path.iterdir() if each.suffix.lower() in OPENCV_SUFFIXES)
        if not files:
            raise RecordingError(
                path, "has neither cameras.txt of COLMAP (its model_converter writes it) nor files of OpenCV"
            )
        return [_read_opencv(file, size_px) for file in files]
    if path.suffix.lower() != ".json":
        return from_matrices(_read_text(path), size_px)
    document = read_json(path)
    if not isinstance(document, dict) or not isinstance(document.get("frames"), list):
        raise RecordingError(path, "is neither a rig file nor a transforms.json with frames")
    return from_blender(document, size_px)


def _read_text(path: Path) -> str:
    try:
        return read_bounded(path, MAX_JSON_BYTES).decode("utf-8-sig")
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    except UnicodeDecodeError as err:
        raise RecordingError(path, "is no text in UTF-8") from err


def _read_opencv(path: Path, size_px: Size) -> Entry:
    text = _read_text(path)
    if len(text) > MOST_CHARACTERS or sum(map(text.count, NESTING)) > MOST_NESTING:
        raise RecordingError(
            path, "is larger than the file of a camera: leave its K, R, t and distortion in it"
        )
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        matrices = {
            key: values
            for key, names in OPENCV_NAMES.items()
            for values in [_first(storage, names)]
            if values is not None
        }
        sides = [storage.getNode(key) for key in ("image_width", "image_height")]
        if not any(side.empty() for side in sides):
            size_px = int(sides[0].real()), int(sides[1].real())
    except (cv2.error, SystemError, ValueError, OverflowError) as err:
        raise RecordingError(path, "is no file of OpenCV: write it with cv2.FileStorage") from err
    return from_opencv(path.stem, matrices, size_px)


def _first(storage: cv2.FileStorage, names: tuple[str, ...]) -> Floats | None:
    """Return the first matrix or sequence of numbers with one of these names, None if there is none."""
    for name in names:
        node = storage.getNode(name)
        if node.isMap():
            return np.asarray(node.mat(), np.float64)
        if node.isSeq():
            return np.array([node.at(index).real() for index in range(node.size())], np.float64)
    return None
