"""Grey images in every form that programs save them in: read as what they are, or refused by name."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile

from drivers.errors import RecordingError
from drivers.files.image_file import PNG_SIGNATURE, read_image
from pipeline.frames import Image

GREY: Image = np.random.default_rng(4).integers(0, 256, (20, 30), np.uint8)
DEEP = GREY.astype(np.uint16) << 8 | 7
BITS = GREY > 99


def chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(rows: bytes, bits: int, colour_type: int, *others: bytes) -> bytes:
    """A PNG of 30 x 20 pixels from packed rows without filter, as no library writes every kind."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 30, 20, bits, colour_type, 0, 0, 0))
    return (
        PNG_SIGNATURE + header + b"".join(others) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )


def unfiltered(image: np.ndarray) -> bytes:
    return b"".join(b"\0" + row.tobytes() for row in image)


def exif(orientation: int, order: str) -> bytes:
    mark = {"<": b"II*\0", ">": b"MM\0*"}[order]
    return chunk(b"eXIf", mark + struct.pack(f"{order}IHHHIHHI", 8, 1, 274, 3, 1, orientation, 0, 0))


def tiff(image: np.ndarray, path: Path, **options: object) -> None:
    tifffile.imwrite(path, image, **options)


def packed_12_bits(path: Path) -> None:
    """A TIFF of 12 bits a pixel, two in three bytes, as scientific cameras save it."""
    levels = (DEEP >> 4).reshape(-1, 2).astype(np.uint32)
    pairs = levels[:, 0] << 12 | levels[:, 1]
    pixels = np.stack([pairs >> 16, pairs >> 8 & 255, pairs & 255], axis=1).astype(np.uint8).tobytes()
    entries = [
        (256, 30),
        (257, 20),
        (258, 12),
        (259, 1),
        (262, 1),
        (273, 8),
        (277, 1),
        (278, 20),
        (279, len(pixels)),
    ]
    folder = struct.pack("<H", len(entries))
    folder += b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries) + bytes(4)
    path.write_bytes(b"II*\0" + struct.pack("<I", 8 + len(pixels)) + pixels + folder)


@pytest.mark.parametrize(
    ("write", "bits", "expected"),
    [
        (lambda path: path.write_bytes(imagecodecs.png_encode(GREY)), 8, GREY),
        (lambda path: path.write_bytes(imagecodecs.png_encode(DEEP)), 16, GREY),
        (lambda path: path.write_bytes(imagecodecs.png_encode(np.dstack([GREY] * 3))), 8, GREY),
        (lambda path: path.write_bytes(imagecodecs.png_encode(np.dstack([GREY, GREY * 0 + 255]))), 8, GREY),
        (
            lambda path: path.write_bytes(imagecodecs.png_encode(np.dstack([GREY] * 3 + [GREY * 0 + 255]))),
            8,
            GREY,
        ),
        (lambda path: path.write_bytes(png(unfiltered(np.packbits(BITS, axis=1)), 1, 0)), 8, BITS * 255),
        (lambda path: path.write_bytes(png(unfiltered(GREY), 8, 0, exif(1, ">"))), 8, GREY),
        (lambda path: tiff(GREY, path), 8, GREY),
        (lambda path: tiff(GREY, path, byteorder=">", compression="zlib", predictor=True), 8, GREY),
        (lambda path: tiff(GREY, path, compression="lzw"), 8, GREY),
        (lambda path: tiff(DEEP, path, byteorder=">"), 16, GREY),
        (lambda path: tiff(255 - GREY, path, photometric="miniswhite"), 8, GREY),
        (lambda path: tiff(65535 - DEEP, path, photometric="miniswhite"), 16, GREY),
        (lambda path: tiff(np.dstack([GREY] * 3), path, photometric="rgb"), 8, GREY),
        (lambda path: tiff(~BITS, path), 8, BITS * 255),
        (lambda path: tiff(GREY, path, bigtiff=True, tile=(16, 16)), 8, GREY),
        (packed_12_bits, 12, GREY),
    ],
)
@pytest.mark.parametrize("name", ["c01.png", "c01.tif"])
def test_every_form_of_grey_is_read_whatever_its_name(
    tmp_path: Path, name: str, write: Callable[[Path], object], bits: int, expected: np.ndarray
) -> None:
    write(tmp_path / name)
    found = read_image(tmp_path / name)
    assert found.bits == bits
    assert np.array_equal(found.to_8_bits(bits), expected)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: path.write_bytes(b"\xff\xd8\xff\xe0 JFIF"), "is neither PNG nor TIFF"),
        (lambda path: path.write_bytes(b""), "is neither PNG nor TIFF"),
        (lambda path: path.write_bytes(PNG_SIGNATURE), "is not a sound PNG"),
        (lambda path: path.write_bytes(b"II*\0\x08\0\0\0"), "is not a sound TIFF"),
        (lambda path: path.write_bytes(b"II*\0\xff\xff\xff\xff"), "is not a sound TIFF"),
        (
            lambda path: path.write_bytes(imagecodecs.png_encode(np.dstack([GREY, GREY, 255 - GREY]))),
            "colour image",
        ),
        (
            lambda path: path.write_bytes(imagecodecs.png_encode(np.dstack([GREY, GREY]))),
            "is transparent in places",
        ),
        (lambda path: path.write_bytes(png(unfiltered(GREY), 8, 0, exif(6, "<"))), "has EXIF orientation 6"),
        (lambda path: path.write_bytes(png(unfiltered(GREY), 8, 0, exif(3, ">"))), "has EXIF orientation 3"),
        (
            lambda path: path.write_bytes(png(unfiltered(GREY), 8, 0, chunk(b"eXIf", b"II"))),
            "is not a sound PNG",
        ),
        (lambda path: tiff(GREY, path, extratags=[(274, 3, 1, 8, True)]), "has EXIF orientation 8"),
        (lambda path: tiff(np.stack([GREY, GREY]), path, photometric="minisblack"), "has 2 pages"),
        (lambda path: tiff(GREY.astype(np.float32), path), "has pixels of type float32"),
        (lambda path: tiff(GREY.astype(np.int16), path), "has pixels of type int16"),
        (
            lambda path: tiff(GREY, path, photometric="palette", colormap=np.zeros((3, 256), np.uint16)),
            "a palette",
        ),
        (
            lambda path: path.write_bytes(
                PNG_SIGNATURE + chunk(b"IHDR", struct.pack(">IIBBBBB", 60000, 60000, 8, 0, 0, 0, 0))
            ),
            "has 60000x60000 pixels, which no camera has",
        ),
        (
            lambda path: path.write_bytes(
                PNG_SIGNATURE + chunk(b"IHDR", struct.pack(">IIBBBBB", 16000, 16000, 16, 6, 0, 0, 0))
            ),  # 2 GB
            "has 16000x16000 pixels, which no camera has",
        ),
    ],
)
def test_other_images_are_refused_with_the_reason(
    tmp_path: Path, write: Callable[[Path], object], message: str
) -> None:
    write(tmp_path / "c01.tif")
    with pytest.raises(RecordingError, match=rf"c01\.tif: .*{message}"):
        read_image(tmp_path / "c01.tif")


def test_no_cut_or_flipped_file_does_more_than_be_refused(tmp_path: Path) -> None:
    """Property: a damaged file is read or refused, and nothing else is raised."""
    rng = np.random.default_rng(7)
    tiff(GREY, tmp_path / "a.tif", compression="zlib")
    for content in ((tmp_path / "a.tif").read_bytes(), png(unfiltered(GREY), 8, 0, exif(1, "<"))):
        for _ in range(150):
            damaged = bytearray(content[: rng.integers(4, len(content))])
            for at in rng.integers(0, len(damaged), 3):
                damaged[at] = rng.integers(256)
            (tmp_path / "b").write_bytes(damaged)
            try:
                read_image(tmp_path / "b")
            except RecordingError as err:
                assert "b: " in str(err)
