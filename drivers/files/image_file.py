"""Read grey images from PNG and TIFF files, and write 8-bit grey PNG, the format of exported images."""

import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded
from drivers.files.bundle_file import TIFF_DAMAGE
from pipeline.frames import Image

SUFFIXES = (".png", ".tif", ".tiff")
"""Ends of the names of images, in lower case."""
MAX_IMAGE_BYTES = 64 << 20
"""Largest file that is decoded; 1280 x 1024 pixels of 16 bits have a twenty-fifth."""
GREY_BITS = 8
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PNG_CHANNELS = {2: 3, 4: 2, 6: 4}
"""Numbers of a pixel by the type of colour, where it has more than one."""
TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
ORIENTATION = 274
"""Tag of TIFF and EXIF: how a program that shows the image turns it; 1: not at all."""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedImage:
    """A grey image as its file has it."""

    pixels: NDArray[Any]  # (H, W) uint8 or uint16
    bits: int  # of each pixel as the file says, which may be more than the camera gave

    def to_8_bits(self, bits: int) -> Image:
        """Return the upper eight of so many bits, as cameras do for Mono8; fewer than eight are all there are."""
        return np.asarray(self.pixels >> max(bits - GREY_BITS, 0), np.uint8)


def read_image(path: Path) -> DecodedImage:
    """Read an image; the content decides between PNG and TIFF, whatever the suffix.

    Colours that are all grey are, and so is an alpha channel that hides nothing.

    Raises
    ------
    RecordingError
        The file cannot be read, is neither a sound PNG nor a sound TIFF, has colours or several pages, is not of 1 to
        16 bits without sign, or bids programs turn or mirror it.
    """
    try:
        content = read_bounded(path, MAX_IMAGE_BYTES)
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    if content.startswith(PNG_SIGNATURE):
        return _read_png(path, content)
    if content.startswith(TIFF_SIGNATURES):
        return _read_tiff(path, content)
    raise RecordingError(path, "is neither PNG nor TIFF, whatever its name says")


def write_png(path: Path, image: Image) -> None:
    """Write an image (H, W); neither durable nor atomic."""
    path.write_bytes(imagecodecs.png_encode(image, level=1))  # level 9 saves 5 % for ten times the work


def _read_png(path: Path, content: bytes) -> DecodedImage:
    try:
        chunks = {kind: data for kind, data in _png_chunks(content) if kind in (b"IHDR", b"eXIf")}
        header = chunks[b"IHDR"]
        n_channels = PNG_CHANNELS.get(header[9], 1)
        _require_size(path, struct.unpack(">II", header[:8]), n_channels * max(header[8] // 8, 1))
        pixels = np.asarray(imagecodecs.png_decode(content))
        if b"eXIf" in chunks:
            _require_upright(path, _exif_orientation(chunks[b"eXIf"]))
    except (imagecodecs.PngError, ValueError, MemoryError, LookupError, struct.error) as err:
        raise RecordingError(path, f"is not a sound PNG: {err}") from err
    return DecodedImage(_grey(path, pixels), max(header[8], GREY_BITS))  # fewer are decoded to eight


def _png_chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield type and content of each chunk."""
    at = len(PNG_SIGNATURE)
    while at + 8 <= len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        yield kind, content[at + 8 : at + 8 + size]
        at += 12 + size


def _exif_orientation(exif: bytes) -> int:
    """Return the orientation of an EXIF block, whose form is that of a TIFF without images; 1 if it has none."""
    order = "<" if exif.startswith(b"II") else ">"
    (at,) = struct.unpack_from(f"{order}I", exif, 4)
    (entries,) = struct.unpack_from(f"{order}H", exif, at)
    for entry in range(entries):
        tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, at + 2 + 12 * entry)
        if tag == ORIENTATION:
            return int(value)
    return 1


def _read_tiff(path: Path, content: bytes) -> DecodedImage:
    try:
        with tifffile.TiffFile(io.BytesIO(content)) as tiff:
            n_pages, page = len(tiff.pages), tiff.pages.first
            tag = page.tags.get(ORIENTATION)
            orientation = 1 if tag is None else int(tag.value)
            photometric, bits, kind = page.photometric, page.bitspersample, page.sampleformat
            _require_size(path, page.shape, 0 if page.dtype is None else page.dtype.itemsize)
            axes, pixels = page.axes, page.asarray()
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"is not a sound TIFF: {err}") from err
    if n_pages > 1:
        raise RecordingError(path, f"has {n_pages} pages; one image a file is needed")
    _require_upright(path, orientation)
    if kind != tifffile.SAMPLEFORMAT.UINT or pixels.dtype not in (np.bool_, np.uint8, np.uint16):
        raise RecordingError(
            path, f"has pixels of type {pixels.dtype}; whole numbers of 1 to 16 bits are needed"
        )
    if photometric == tifffile.PHOTOMETRIC.PALETTE or axes not in ("YX", "YXS"):
        raise RecordingError(path, "has a palette or separate colours; grey levels are needed")
    pixels = _grey(path, pixels.astype(np.uint16 if bits > GREY_BITS else np.uint8))
    if photometric == tifffile.PHOTOMETRIC.MINISWHITE:
        pixels = (1 << bits) - 1 - pixels
    if bits < GREY_BITS:
        pixels = (pixels * (255 // ((1 << bits) - 1))).astype(np.uint8)  # exact for 1, 2 and 4 bits
    return DecodedImage(pixels, max(bits, GREY_BITS))


def _grey(path: Path, pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the grey levels (H, W) of pixels (H, W) or (H, W, channels); refuse what one level cannot hold."""
    if pixels.ndim == 2:
        return pixels
    colours = pixels[..., : (1 if pixels.shape[2] == 2 else 3)]
    if (colours != colours[..., :1]).any():
        raise RecordingError(path, "is a colour image; grey is needed")
    if pixels.shape[2] in (2, 4) and (pixels[..., -1] != np.iinfo(pixels.dtype).max).any():
        raise RecordingError(path, "is transparent in places; grey alone is needed")
    return np.ascontiguousarray(colours[..., 0])


def _require_size(path: Path, shape: Sequence[int], pixel_bytes: int) -> None:
    """Refuse an image without a pixel, or one whose file is small and says that its pixels are many or large."""
    if not 0 < prod(shape) * max(pixel_bytes, 1) <= 4 * MAX_IMAGE_BYTES:
        raise RecordingError(path, f"has {'x'.join(map(str, shape))} pixels, which no camera has")


def _require_upright(path: Path, orientation: int) -> None:
    if orientation != 1:
        raise RecordingError(
            path,
            f"has EXIF orientation {orientation}: programs show it turned or mirrored, and which of the two its camera"
            " is calibrated for is not known; store it upright without that mark",
        )
