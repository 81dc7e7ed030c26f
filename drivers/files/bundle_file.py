"""One bundle in one TIFF: a page a camera, and a JSON header in the first page's ImageDescription.

What is read is what was written: the header carries a checksum of itself and one of every page's
pixels. A page that does not match is a missing view with reason `damaged`; without a sound header
nothing of the file is used. Uncompressed pixels lie one behind the other, so that they can be mapped.
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
from drivers.files.bundle_header import BundleHeader, FrameEntry, crc32, described, parsed
from drivers.files.durable import replacing
from drivers.interfaces import FrameLossReason
from pipeline.frames import CameraId, Frame, FrameBundle, Image

Compression = Literal["none", "zstd"]


MAPPED_FILES = 4
"""So many stay mapped, for those that are written over again and again: to map 21 MB takes 2 ms, page by page."""

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
"""What tifffile and imagecodecs raise on damaged files: they parse without checking."""

logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # it also logs each damage, which is ours to tell


def write_bundle(
    path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId], *, compression: Compression
) -> None:
    """Write a bundle, one page a camera in the order of `camera_ids`; durable when this returns.

    Raises
    ------
    RecordingError
        The bundle has no frame, frames of different sizes, or a frame of a camera not in `camera_ids`.
    """
    frames = _frames_in_order(path, bundle, camera_ids)
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        _write_pages(file, bundle, frames, compression)


def overwrite_bundle(path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId]) -> None:
    """Write a bundle, uncompressed, into the file that is there, if there is one; of no use after a power cut.

    On tmpfs new memory costs as much as filling it. Nobody may look at the file while it is overwritten.

    Raises
    ------
    RecordingError
        As `write_bundle`.
    """
    frames = _frames_in_order(path, bundle, camera_ids)
    with path.open("r+b" if path.exists() else "xb") as file:
        _write_pages(file, bundle, frames, "none")


def _frames_in_order(path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId]) -> list[Frame]:
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
    packing: dict[str, Any] = {}
    if compression == "zstd":
        pages, packing = map(_differences_packed, images), {"compression": "zstd", "predictor": True}
    with tifffile.TiffWriter(file) as tiff:
        tiff.write(
            pages,
            shape=(len(images), *images[0].shape),
            dtype=np.uint8,
            photometric="minisblack",
            description=described(bundle, frames, images),
            metadata=None,
            software=False,
            rowsperstrip=images[0].shape[0],
            maxworkers=1,
            **packing,
        )


def _differences_packed(image: Image) -> bytes:
    """A page (H, W) as tifffile would compress it, which takes four times as long for the differences.

    Horizontal predictor and zstd-1 halve the images at a fifth of PNG's cost.
    """
    differences = image.copy()
    np.subtract(image[:, 1:], image[:, :-1], out=differences[:, 1:])
    return packed(differences)


def packed(page: Image) -> bytes:
    """A page (H, W) in zstd-1, as a TIFF has it; given arrays tifffile would copy each first."""
    return bytes(zstd_encode(page, level=1))  # type: ignore[arg-type]  # its stub knows no array


def read_header(path: Path) -> BundleHeader:
    """The header alone, without reading pixels.

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
    """The bundle with its images; a damaged page is a missing view.

    `mapped`: images that are not compressed are views of the file, without a copy. If it is cut or its disk
    fails while they are in use, that kills the process.
    `checked`: pixels are compared with their checksums, which takes a pass over all of them.

    Raises
    ------
    RecordingError
        As `read_header`, or a camera is not in `camera_ids`, or every page is damaged.
    """
    frames: dict[CameraId, Frame] = {}
    with _open(path) as tiff:
        header = _header(path, tiff)
        require_cameras_of(header, camera_ids)
        tiff.pages.useframes = True  # all pages are alike: only where each one lies is read
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
    """Refuse a bundle with a view that its recording does not know."""
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
    """A view of the file from the first page's pixels on, those of the others follow; nothing of a compressed one."""
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
    """The file, as long as it is this one and of this size: a mapping keeps its inode from being another's."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ)


def _image(
    tiff: tifffile.TiffFile, pixels: NDArray[np.uint8] | None, entry: FrameEntry, size_px: tuple[int, int]
) -> Image | None:
    """Image (H, W) of a page, or nothing when it cannot be read."""
    width_px, height_px = size_px
    n_pixels = width_px * height_px
    try:
        image: Image
        if pixels is None:
            page = tiff.pages[entry.page]
            if page.shape != (height_px, width_px) or page.dtype != "uint8":
                return None
            image = page.asarray()
        else:  # to look for the pages takes nearly as long as to check their pixels
            image = pixels[entry.page * n_pixels :][:n_pixels].reshape(height_px, width_px)
    except TIFF_DAMAGE:
        return None
    return image if image.shape == (height_px, width_px) else None


def _header(path: Path, tiff: tifffile.TiffFile) -> BundleHeader:
    try:
        description = tiff.pages.first.description
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"has no readable first page: {err}") from err
    return parsed(path, description)
