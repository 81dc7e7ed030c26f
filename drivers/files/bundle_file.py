"""The bundle file: one TIFF with a page for each camera, and a JSON header in the first page's ImageDescription.

The header carries a checksum of itself and one of every page's pixels. A page that does not match is a missing
view with reason `damaged`; without a sound header nothing of the file is used. Uncompressed pixels of all pages
lie one behind the other, so that they can be mapped.
"""

import logging
import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
import tifffile
from imagecodecs import zstd_encode
from numpy.typing import NDArray

from drivers.errors import RecordingError
from drivers.files.bundle_header import BundleHeader, FrameEntry, crc32, header_text, parse_header
from drivers.files.durable import replacing
from drivers.interfaces import FrameLossReason
from pipeline.frames import CameraId, Frame, FrameBundle, Image

Compression = Literal["none", "zstd"]


MAPPED_FILES = 4
"""How many files stay mapped, for those that are written over again and again: mapping 21 MB anew takes 2 ms."""

TIFF_DAMAGE = (
    tifffile.TiffFileError,
    struct.error,
    zlib.error,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    AttributeError,
    MemoryError,
    RuntimeError,  # the root of imagecodecs' errors
    OSError,
)
"""Errors that tifffile and imagecodecs raise on damaged files: they parse without checking."""

logging.getLogger("tifffile").setLevel(
    logging.CRITICAL
)  # it logs each damage, which is raised here as an error


def write_bundle(
    path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId], *, compression: Compression
) -> None:
    """Write a bundle durably, one page for each camera in the order of `camera_ids`.

    Raises
    ------
    RecordingError
        The bundle has no frame, frames of different sizes, or a frame of a camera not in `camera_ids`.
    """
    frames = _frames_in_order(path, bundle, camera_ids)
    with replacing(path) as temporary, temporary.open("wb") as file:
        _write_pages(file, bundle, frames, compression)


def overwrite_bundle(path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId]) -> None:
    """Write a bundle uncompressed over the file that is there, if any; neither durable nor atomic.

    For tmpfs, where new memory costs as much as filling it. The file must not be read meanwhile.

    Raises
    ------
    RecordingError
        As `write_bundle`.
    """
    frames = _frames_in_order(path, bundle, camera_ids)
    with path.open("r+b" if path.exists() else "xb") as file:
        _write_pages(file, bundle, frames, "none")


def _frames_in_order(path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId]) -> list[Frame]:
    """Return the frames of a bundle that can be written; raises `RecordingError` as `write_bundle` does."""
    frames = [bundle.frames[camera] for camera in camera_ids if camera in bundle.frames]
    if foreign := sorted(set(bundle.frames) - set(camera_ids)):
        raise RecordingError(path, f"bundle {bundle.name} has frames of unknown cameras {', '.join(foreign)}")
    if not frames:
        raise RecordingError(path, f"bundle {bundle.name} has no frame, so there is nothing to write")
    if len(sizes := {frame.image.shape for frame in frames}) > 1:
        raise RecordingError(path, f"bundle {bundle.name} has images of different sizes {sorted(sizes)}")
    return frames


def _write_pages(
    file: BinaryIO, bundle: FrameBundle, frames: Sequence[Frame], compression: Compression
) -> None:
    images = [np.ascontiguousarray(frame.image) for frame in frames]
    pages: Iterator[Image] | Iterator[bytes] = iter(images)
    tags: dict[str, Any] = {}
    if compression == "zstd":
        pages, tags = map(_predicted_page, images), {"compression": "zstd", "predictor": True}
    with tifffile.TiffWriter(file) as tiff:
        tiff.write(
            pages,
            shape=(len(images), *images[0].shape),
            dtype=np.uint8,
            photometric="minisblack",
            description=header_text(bundle, frames, images),
            metadata=None,
            software=False,
            rowsperstrip=images[0].shape[0],
            maxworkers=1,
            **tags,
        )


def _predicted_page(image: Image) -> bytes:
    """Return the compressed page of an image (H, W), with the horizontal predictor of TIFF.

    Predictor and zstd-1 halve the images at a fifth of PNG's cost. tifffile would do the same, but takes four times
    as long for the differences.
    """
    differences = image.copy()
    np.subtract(image[:, 1:], image[:, :-1], out=differences[:, 1:])
    return zstd_page(differences)


def zstd_page(page: Image) -> bytes:
    """Return a page (H, W) compressed by zstd-1, as a TIFF holds it; tifffile would copy the array first."""
    return bytes(zstd_encode(page, level=1))  # type: ignore[arg-type]  # its stub knows no array


def read_header(path: Path) -> BundleHeader:
    """Read the header alone, no pixels.

    Raises
    ------
    RecordingError
        The file cannot be read, is not a bundle, is of another version, or its header is damaged.
    """
    with _open(path) as tiff:
        return _header(path, tiff)


def read_bundle(
    path: Path, camera_ids: Sequence[CameraId], *, mapped: bool = False, checked: bool = True
) -> FrameBundle:
    """Read a bundle with its images; a damaged page is a missing view.

    Parameters
    ----------
    camera_ids
        All cameras of the recording; those that the file does not name are missing with reason `absent`.
    mapped
        Uncompressed images are views of the mapped file, without a copy. If the file is cut or its disk fails while
        they are in use, the process is killed (SIGBUS).
    checked
        Pixels are compared with their checksums, which takes a pass over all of them.

    Raises
    ------
    RecordingError
        As `read_header`, or the file names a camera that is not in `camera_ids`, or every page is damaged; or pages
        are not as recorded, as if another program had written them.
    """
    frames: dict[CameraId, Frame] = {}
    with _open(path) as tiff:
        header = _header(path, tiff)
        require_cameras_of(header, camera_ids)
        first = tiff.pages.first
        if first.shape != header.image_size_px[::-1] or first.dtype != "uint8":
            problem = "its pages are not 8-bit grey images of the recorded size"
            raise RecordingError(path, f"{problem}, as if another program had written them")
        tiff.pages.useframes = True  # all pages are alike: only their offsets are read
        pixels = _mapped_pixels(tiff) if mapped else None
        absent = [camera for camera in camera_ids if camera not in header.frames]
        missing: dict[CameraId, str] = dict.fromkeys(absent, FrameLossReason.ABSENT)
        missing.update(header.missing)
        for camera, entry in header.frames.items():
            image = _image(tiff, pixels, entry, header.image_size_px)
            if image is None or (checked and crc32(image.data) != entry.crc32):
                missing[camera] = FrameLossReason.DAMAGED
                continue
            frames[camera] = Frame(
                camera=camera,
                image=image,
                frame_id=entry.frame_id,
                device_ns=entry.device_ns,
                received_ns=entry.received_ns,
            )
    if not frames:
        raise RecordingError(path, "every page is damaged")
    return FrameBundle(trigger=header.trigger, frames=frames, missing=missing)


def require_cameras_of(header: BundleHeader, camera_ids: Sequence[CameraId]) -> None:
    """Raise `RecordingError` if a bundle names a camera that is not in `camera_ids`."""
    if foreign := sorted({*header.frames, *header.missing} - set(camera_ids)):
        raise RecordingError(header.path, f"names cameras its recording does not have: {', '.join(foreign)}")


def _open(path: Path) -> tifffile.TiffFile:
    try:
        return tifffile.TiffFile(path)
    except FileNotFoundError as err:
        raise RecordingError(path, "does not exist") from err
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"is not a readable TIFF: {err}") from err


def _mapped_pixels(tiff: tifffile.TiffFile) -> NDArray[np.uint8] | None:
    """Map the pixels (N,) of all pages, one behind the other; None if the file is compressed or damaged."""
    try:
        first = tiff.pages.first
        if first.compression != tifffile.COMPRESSION.NONE:
            return None
        found = os.fstat(tiff.filehandle.fileno())
        mapping = _mapping(Path(tiff.filehandle.path), found.st_dev, found.st_ino, found.st_size)
        return np.frombuffer(mapping, np.uint8, offset=first.dataoffsets[0])
    except TIFF_DAMAGE:
        return None


@lru_cache(MAPPED_FILES)
def _mapping(path: Path, device: int, inode: int, size: int) -> mmap.mmap:
    """Map a whole file; kept until device, inode or size change. The mapping keeps the inode from being reused."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)


def _image(
    tiff: tifffile.TiffFile, pixels: NDArray[np.uint8] | None, entry: FrameEntry, size_px: tuple[int, int]
) -> Image | None:
    """Return the image (H, W) of a page, None when it cannot be read."""
    width_px, height_px = size_px
    n_pixels = width_px * height_px
    try:
        image: Image
        if pixels is None:
            image = tiff.pages[entry.page].asarray()
        else:  # without parsing the pages, which takes nearly as long as verifying their pixels
            image = pixels[entry.page * n_pixels :][:n_pixels].reshape(height_px, width_px)
    except TIFF_DAMAGE:
        return None
    return image if image.shape == (height_px, width_px) else None


def _header(path: Path, tiff: tifffile.TiffFile) -> BundleHeader:
    try:
        description = tiff.pages.first.description
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"has no readable first page: {err}") from err
    return parse_header(path, description)
