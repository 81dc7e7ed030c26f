from pathlib import Path

import numpy as np
import pytest
import tifffile

from drivers.errors import RecordingError
from drivers.silhouette_file import read_silhouettes, write_silhouettes
from pipeline.frames import CameraId

CAMERAS = (CameraId("c01"), CameraId("c03"))


def labels_of(number: int) -> np.ndarray:
    return np.random.default_rng(number).choice(np.array([0, 128, 255], np.uint8), (48, 64))


def test_reading_is_the_inverse_of_writing(tmp_path: Path) -> None:
    path = tmp_path / "s.tiff"
    write_silhouettes(path, CAMERAS, map(labels_of, range(2)), (64, 48))
    found = read_silhouettes(path)
    assert tuple(found) == CAMERAS
    for number, labels in enumerate(found.values()):
        assert np.array_equal(labels, labels_of(number))


def test_one_view_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "s.tiff"
    write_silhouettes(path, CAMERAS[:1], [labels_of(0)], (64, 48))
    assert np.array_equal(read_silhouettes(path)[CAMERAS[0]], labels_of(0))


def test_foreign_and_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.tiff"
    with pytest.raises(RecordingError, match=r"s\.tiff"):
        read_silhouettes(path)
    tifffile.imwrite(path, labels_of(0))
    with pytest.raises(RecordingError, match="silhouettes"):
        read_silhouettes(path)
    write_silhouettes(path, CAMERAS, map(labels_of, range(2)), (64, 48))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(RecordingError, match=r"s\.tiff"):
        read_silhouettes(path)
