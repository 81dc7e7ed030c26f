import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import RecordingError
from drivers.files.silhouette_file import WHOLE_IMAGES_FORMAT, read_silhouettes, write_silhouettes
from pipeline.frames import CameraId

CAMERAS = (CameraId("c01"), CameraId("c03"))
SIZE_PX = (64, 48)
Region = tuple[tuple[int, int], np.ndarray]


def labels_of(number: int, size_px: tuple[int, int] = SIZE_PX) -> np.ndarray:
    return np.random.default_rng(number).choice(np.array([0, 128, 255], np.uint8), size_px[::-1])


def whole(number: int) -> Region:
    return (0, 0), labels_of(number)


@st.composite
def regions(draw: st.DrawFn) -> Region:
    """Anywhere in an image, and maybe empty."""
    u, v = draw(st.integers(0, SIZE_PX[0])), draw(st.integers(0, SIZE_PX[1]))
    size_px = draw(st.integers(0, SIZE_PX[0] - u)), draw(st.integers(0, SIZE_PX[1] - v))
    return (u, v), labels_of(draw(st.integers(0, 99)), size_px)


@given(st.lists(regions(), min_size=1, max_size=3))
def test_reading_gives_whole_images(tmp_path_factory: pytest.TempPathFactory, seen: list[Region]) -> None:
    path = tmp_path_factory.mktemp("silhouettes") / "s.tiff"
    written = {CameraId(f"c{number:02d}"): region for number, region in enumerate(seen)}
    write_silhouettes(path, written, SIZE_PX)
    found = read_silhouettes(path)
    assert list(found) == list(written)
    for image, ((u, v), labels) in zip(found.values(), seen, strict=True):
        expected = np.zeros(SIZE_PX[::-1], np.uint8)
        expected[v : v + labels.shape[0], u : u + labels.shape[1]] = labels
        np.testing.assert_array_equal(image, expected)


def test_files_of_releases_before_are_read(tmp_path: Path) -> None:
    path = tmp_path / "s.tiff"
    pages = np.stack([labels_of(0), labels_of(1)])
    description = json.dumps({"format": WHOLE_IMAGES_FORMAT, "cameras": CAMERAS})
    tifffile.imwrite(path, pages, photometric="minisblack", description=description, metadata=None)
    found = read_silhouettes(path)
    assert tuple(found) == CAMERAS
    np.testing.assert_array_equal(list(found.values()), pages)


def test_foreign_and_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "s.tiff"
    with pytest.raises(RecordingError, match=r"s\.tiff"):
        read_silhouettes(path)
    tifffile.imwrite(path, labels_of(0))
    with pytest.raises(RecordingError, match="silhouettes"):
        read_silhouettes(path)
    write_silhouettes(path, {camera: whole(number) for number, camera in enumerate(CAMERAS)}, SIZE_PX)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(RecordingError, match=r"s\.tiff"):
        read_silhouettes(path)
