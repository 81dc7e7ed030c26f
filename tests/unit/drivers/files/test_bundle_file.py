import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from support.extents import examples
from support.recordings import CAMERAS, assert_same_bundle, make_bundle, tagged_image

from drivers.errors import RecordingError
from drivers.files.bundle_file import overwrite_bundle, read_bundle, read_header, write_bundle
from drivers.files.bundle_header import FORMAT
from pipeline.frames import BundleKind, CameraId, Image


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_reading_is_the_inverse_of_writing(tmp_path: Path, compression: str) -> None:
    bundle = make_bundle(3, kind=BundleKind.BALL, missing={CAMERAS[1]: "lost"}, name="ball-3")
    path = tmp_path / "b.tiff"
    write_bundle(path, bundle, CAMERAS, compression=compression)
    assert_same_bundle(read_bundle(path, CAMERAS), bundle)
    assert list(tmp_path.iterdir()) == [path]


def test_any_tiff_reader_sees_one_page_a_camera(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    write_bundle(path, make_bundle(0, missing={CAMERAS[0]: "lost"}), CAMERAS, compression="zstd")
    with tifffile.TiffFile(path) as tiff:
        pages = [page.asarray() for page in tiff.pages]
        header = json.loads(tiff.pages.first.description)
        assert tiff.pages.first.predictor == tifffile.PREDICTOR.HORIZONTAL
        assert tiff.pages.first.compression == tifffile.COMPRESSION.ZSTD
    assert len(pages) == 3
    for page, camera in zip(pages, CAMERAS[1:], strict=True):
        assert np.array_equal(page, tagged_image(0, camera))
    assert [(frame["camera"], frame["page"]) for frame in header["frames"]] == [
        ("c02", 0),
        ("c03", 1),
        ("c04", 2),
    ]
    assert header["sequence"] == 0
    assert header["kind"] == "particle"


@given(image=arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_any_image_is_compressed_so_that_any_tiff_reader_sees_it(image: NDArray[np.uint8]) -> None:
    bundle = make_bundle(0)
    frames = {camera: replace(frame, image=image) for camera, frame in bundle.frames.items()}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "b.tiff"
        write_bundle(path, replace(bundle, frames=frames), CAMERAS, compression="zstd")
        assert np.array_equal(tifffile.imread(path, key=1), image)


def test_uncompressed_pages_can_be_mapped(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    write_bundle(path, make_bundle(0), CAMERAS, compression="none")
    assert np.array_equal(tifffile.memmap(path, page=2, mode="r"), tagged_image(0, CAMERAS[2]))


def test_a_mapped_bundle_is_the_file_itself(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    bundle = make_bundle(0)
    write_bundle(path, bundle, CAMERAS, compression="none")
    mapped = read_bundle(path, CAMERAS, mapped=True)
    assert_same_bundle(mapped, bundle)
    path.unlink()  # what was read stays
    assert_same_bundle(mapped, bundle)
    assert not any(frame.image.flags.owndata for frame in mapped.frames.values())


def test_a_file_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    for bundle in (make_bundle(0), make_bundle(1, missing={CAMERAS[2]: "lost"}), make_bundle(2)):
        overwrite_bundle(path, bundle, CAMERAS)
        assert_same_bundle(read_bundle(path, CAMERAS, mapped=True), bundle)
        assert list(tmp_path.iterdir()) == [path]


def test_what_was_mapped_is_another_file_by_now(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    for number in range(3):
        write_bundle(path, make_bundle(2 * number), CAMERAS, compression="none")
        assert_same_bundle(read_bundle(path, CAMERAS, mapped=True), make_bundle(2 * number))
        overwrite_bundle(path, make_bundle(2 * number + 1), CAMERAS)
        assert_same_bundle(read_bundle(path, CAMERAS, mapped=True), make_bundle(2 * number + 1))


def test_header_needs_no_pixels(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    write_bundle(path, make_bundle(5), CAMERAS, compression="none")
    header = read_header(path)
    assert (header.sequence, header.name, header.kind) == (5, "00000005", BundleKind.PARTICLE)
    assert header.cameras == CAMERAS
    assert header.trigger == make_bundle(5).trigger


def test_a_bundle_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    bundle = make_bundle(0)
    with pytest.raises(RecordingError, match=r"b\.tiff: bundle 00000000 has no frame"):
        write_bundle(path, replace(bundle, frames={}), CAMERAS, compression="none")
    with pytest.raises(RecordingError, match="unknown cameras c04"):
        write_bundle(path, bundle, CAMERAS[:3], compression="none")
    odd = replace(bundle.frames[CAMERAS[0]], image=np.zeros((4, 4), np.uint8))
    with pytest.raises(RecordingError, match="different sizes"):
        write_bundle(
            path, replace(bundle, frames={**bundle.frames, CAMERAS[0]: odd}), CAMERAS, compression="none"
        )
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_page_is_a_missing_view(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    bundle = make_bundle(0)
    write_bundle(path, bundle, CAMERAS, compression="none")
    content = path.read_bytes()
    where = content.index(tagged_image(0, CAMERAS[2]).tobytes())
    path.write_bytes(content[: where + 100] + bytes([content[where + 100] ^ 1]) + content[where + 101 :])
    found = read_bundle(path, CAMERAS)
    assert dict(found.missing) == {CAMERAS[2]: "damaged"}
    assert set(found.frames) == set(CAMERAS) - {CAMERAS[2]}
    assert read_bundle(path, CAMERAS, checked=False).frames.keys() == set(CAMERAS)


@pytest.mark.parametrize("compression", [None, "zstd"])
@pytest.mark.parametrize("mapped", [False, True])
@pytest.mark.parametrize(
    "change", [np.uint16, lambda page: np.stack([page] * 3, axis=2), lambda page: page[:-2]]
)
def test_pages_that_another_program_wrote_are_not_called_damaged(
    tmp_path: Path, change: Callable[[Image], Image], compression: str | None, mapped: bool
) -> None:
    path = tmp_path / "b.tiff"
    bundle = make_bundle(0)
    write_bundle(path, bundle, CAMERAS, compression="none")
    with tifffile.TiffFile(path) as tiff:
        description = tiff.pages.first.description
    pages = [np.asarray(change(bundle.frames[camera].image)) for camera in CAMERAS]
    with tifffile.TiffWriter(path) as tiff_out:
        for number, page in enumerate(pages):
            said = description if number == 0 else None
            tiff_out.write(page, description=said, metadata=None, compression=compression)
    with pytest.raises(RecordingError, match="its pages are not 8-bit grey images of the recorded size"):
        read_bundle(path, CAMERAS, mapped=mapped)


def test_foreign_files_are_named(tmp_path: Path) -> None:
    path = tmp_path / "b.tiff"
    with pytest.raises(RecordingError, match=r"b\.tiff: does not exist"):
        read_header(path)
    path.write_bytes(b"")
    with pytest.raises(RecordingError, match="not a readable TIFF"):
        read_header(path)
    image = np.zeros((48, 64), np.uint8)
    tifffile.imwrite(path, image)
    with pytest.raises(RecordingError, match="not a stonefall bundle"):
        read_header(path)
    tifffile.imwrite(path, image, description='{"format": "stonefall-bundle/9"}', metadata=None)
    with pytest.raises(RecordingError, match='"stonefall-bundle/9", of a later version: update stonefall'):
        read_header(path)
    tifffile.imwrite(path, image, description=json.dumps({"format": FORMAT, "sequence": 1}), metadata=None)
    with pytest.raises(RecordingError, match="header is damaged"):
        read_header(path)
    write_bundle(path, make_bundle(0), CAMERAS, compression="none")
    with pytest.raises(RecordingError, match="does not have: c03, c04"):
        read_bundle(path, CAMERAS[:2])
    (folder := tmp_path / "folder").mkdir()
    with pytest.raises(RecordingError, match="folder"):
        read_bundle(folder, CAMERAS)


@pytest.mark.parametrize("utc", ["yesterday", "2026-01-01T00:00:00"])
def test_a_time_that_is_no_instant_is_refused(tmp_path: Path, utc: str) -> None:
    bundle = make_bundle(1)
    path = tmp_path / "b.tiff"
    wrong = replace(bundle, trigger=replace(bundle.trigger, utc=utc))
    write_bundle(path, wrong, CAMERAS, compression="none")
    with pytest.raises(RecordingError, match=utc):
        read_header(path)


@examples(1.5)
@given(data=st.data(), compression=st.sampled_from(["none", "zstd"]), mapped=st.booleans())
def test_damage_never_goes_unnoticed(
    data: st.DataObject, compression: str, mapped: bool, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Whatever is flipped or cut: one clear error, or true frames with the rest named as missing."""
    path = tmp_path_factory.mktemp("damage") / "b.tiff"
    bundle = make_bundle(1, name="b")
    write_bundle(path, bundle, CAMERAS, compression=compression)
    content = bytearray(path.read_bytes())
    # most bytes are pixels; the structure is at the front and between them
    anywhere = st.integers(0, len(content) - 1)
    front = st.integers(0, 2000)
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(anywhere | front)] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.just(len(content)) | anywhere)]
    path.write_bytes(content)
    try:
        found = read_bundle(path, CAMERAS, mapped=mapped)
    except RecordingError as err:
        assert str(err).startswith(f"{path}: ")
        return
    assert found.trigger == bundle.trigger
    assert set(found.frames) | set(found.missing) == set(CAMERAS)
    for camera, frame in found.frames.items():
        assert np.array_equal(frame.image, tagged_image(1, CameraId(camera)))
