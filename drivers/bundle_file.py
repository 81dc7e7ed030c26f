"""One bundle in one TIFF: a page a camera, and a JSON header in the first page's ImageDescription.

What is read is what was written: the header carries a checksum of itself and one of every page's
pixels. A page that does not match is a missing view with reason `damaged`; without a sound header
nothing of the file is used.
"""

import json
import logging
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeVar

import tifffile

from drivers.errors import RecordingError
from drivers.files import replacing
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Image, Trigger

FORMAT = "stonefall-bundle/1"
Compression = Literal["none", "zstd"]

DAMAGED = "damaged"
"""Reason of a view whose page is torn or does not match its checksum."""
ABSENT = "absent"
"""Reason of a view of which the file says nothing."""

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

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameEntry:
    """What the header says of one frame."""

    page: int
    frame_id: int
    device_ns: int
    received_ns: int
    crc32: int  # of the pixels, row by row


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleHeader:
    """All of a bundle but its pixels."""

    path: Path
    trigger: Trigger
    image_size_px: tuple[int, int]  # W, H
    frames: Mapping[CameraId, FrameEntry]  # in page order
    missing: Mapping[CameraId, str]

    @property
    def sequence(self) -> int:
        return self.trigger.sequence

    @property
    def kind(self) -> BundleKind:
        return self.trigger.kind

    @property
    def name(self) -> str:
        return self.trigger.name or f"{self.trigger.sequence:08d}"

    @property
    def cameras(self) -> tuple[CameraId, ...]:
        return tuple(self.frames)


def write_bundle(
    path: Path, bundle: FrameBundle, camera_ids: Sequence[CameraId], *, compression: Compression
) -> None:
    """Write a bundle, one page a camera in the order of `camera_ids`; durable when this returns.

    Raises
    ------
    RecordingError
        The bundle has no frame, frames of different sizes, or a frame of a camera not in `camera_ids`.
    """
    frames = [bundle.frames[camera] for camera in camera_ids if camera in bundle.frames]
    if foreign := sorted(set(bundle.frames) - set(camera_ids)):
        raise RecordingError(path, f"bundle {bundle.name} has frames of unknown cameras {', '.join(foreign)}")
    if not frames:
        raise RecordingError(path, f"bundle {bundle.name} has no frame, so there is nothing to write")
    if len(sizes := {frame.image.shape for frame in frames}) > 1:
        raise RecordingError(path, f"bundle {bundle.name} has images of different sizes {sorted(sizes)}")
    description = json.dumps(_document(bundle, frames))
    # horizontal predictor and zstd-1 halve the images at a fifth of PNG's cost
    packing: dict[str, Any] = (
        {"compression": "zstd", "compressionargs": {"level": 1}, "predictor": True}
        if compression == "zstd"
        else {}
    )
    with replacing(path) as unfinished, tifffile.TiffWriter(unfinished) as tiff:
        for page, frame in enumerate(frames):
            tiff.write(
                frame.image,
                photometric="minisblack",
                description=description if page == 0 else None,
                metadata=None,
                software=False,
                contiguous=False,
                rowsperstrip=frame.image.shape[0],
                **packing,
            )


def read_header(path: Path) -> BundleHeader:
    """The header alone, without reading pixels.

    Raises
    ------
    RecordingError
        The file cannot be read, is not a bundle, is of another version, or its header is damaged.
    """
    with _open(path) as tiff:
        return _header(path, tiff)


def read_bundle(path: Path, camera_ids: Sequence[CameraId]) -> FrameBundle:
    """The bundle with its images; a damaged page is a missing view.

    Raises
    ------
    RecordingError
        As `read_header`, or a camera is not in `camera_ids`, or every page is damaged.
    """
    frames: dict[CameraId, Frame] = {}
    with _open(path) as tiff:
        header = _header(path, tiff)
        require_cameras_of(header, camera_ids)
        missing = {camera: ABSENT for camera in camera_ids if camera not in header.frames} | dict(
            header.missing
        )
        for camera, entry in header.frames.items():
            image = _image(tiff, entry, header.image_size_px)
            if image is None:
                missing[camera] = DAMAGED
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


def _image(tiff: tifffile.TiffFile, entry: FrameEntry, size_px: tuple[int, int]) -> Image | None:
    """Image (H, W) of a page, or nothing when it is not what was written."""
    try:
        page = tiff.pages[entry.page]
        if page.shape != size_px[::-1] or page.dtype != "uint8":
            return None
        image = page.asarray()
    except TIFF_DAMAGE:
        return None
    return image if image.shape == size_px[::-1] and zlib.crc32(image.tobytes()) == entry.crc32 else None


# --- the header (format "stonefall-bundle/1") ---


def _document(bundle: FrameBundle, frames: Sequence[Frame]) -> dict[str, Any]:
    trigger = bundle.trigger
    height_px, width_px = frames[0].image.shape
    document: dict[str, Any] = {
        "format": FORMAT,
        "name": trigger.name,
        "sequence": trigger.sequence,
        "kind": trigger.kind.value,
        "trigger": {
            "utc": trigger.utc,
            "received_ns": trigger.received_ns,
            "device_ns": trigger.device_ns,
            "pulse_width_ns": trigger.pulse_width_ns,
        },
        "image_size_px": [width_px, height_px],
        "checksum_algorithm": "crc32",
        "frames": [
            {
                "camera": frame.camera,
                "page": page,
                "frame_id": frame.frame_id,
                "device_ns": frame.device_ns,
                "received_ns": frame.received_ns,
                "checksum": f"{zlib.crc32(frame.image.tobytes()):08x}",
            }
            for page, frame in enumerate(frames)
        ],
        "missing": dict(bundle.missing),
    }
    document["checksum"] = _checksum(document)
    return document


def _checksum(document: Mapping[str, Any]) -> str:
    """crc32 (hex) of the canonical JSON without the member `checksum`."""
    bare = {key: value for key, value in document.items() if key != "checksum"}
    return f"{zlib.crc32(json.dumps(bare, sort_keys=True, separators=(',', ':')).encode()):08x}"


def _header(path: Path, tiff: tifffile.TiffFile) -> BundleHeader:
    try:
        description = tiff.pages.first.description
    except TIFF_DAMAGE as err:
        raise RecordingError(path, f"has no readable first page: {err}") from err
    try:
        document = json.loads(description)
    except (ValueError, RecursionError) as err:
        raise RecordingError(path, "is no bundle of ours: its first page has no JSON description") from err
    if not isinstance(document, dict) or "format" not in document:
        raise RecordingError(path, "is no bundle of ours: its description names no format")
    if document["format"] != FORMAT:
        raise RecordingError(path, f'has format {document["format"]!r}, not "{FORMAT}"')
    if document.get("checksum") != _checksum(document):
        raise RecordingError(path, "header is damaged: it does not match its checksum")
    try:
        return _parse(path, document)
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(path, f"header is wrong: {type(err).__name__} {err}") from err


def _parse(path: Path, document: Mapping[str, Any]) -> BundleHeader:
    times = _typed(document["trigger"], dict)
    width_px, height_px = document["image_size_px"]
    pulse_width_ns, name = times["pulse_width_ns"], document["name"]
    return BundleHeader(
        path=path,
        trigger=Trigger(
            sequence=_typed(document["sequence"], int),
            received_ns=_typed(times["received_ns"], int),
            device_ns=_typed(times["device_ns"], int),
            utc=_instant(times["utc"]),
            pulse_width_ns=None if pulse_width_ns is None else _typed(pulse_width_ns, int),
            kind=BundleKind(document["kind"]),
            name=None if name is None else _typed(name, str),
        ),
        image_size_px=(_typed(width_px, int), _typed(height_px, int)),
        frames={
            CameraId(_typed(entry["camera"], str)): FrameEntry(
                page=_typed(entry["page"], int),
                frame_id=_typed(entry["frame_id"], int),
                device_ns=_typed(entry["device_ns"], int),
                received_ns=_typed(entry["received_ns"], int),
                crc32=int(entry["checksum"], 16),
            )
            for entry in _typed(document["frames"], list)
        },
        missing={
            CameraId(camera): _typed(reason, str)
            for camera, reason in _typed(document["missing"], dict).items()
        },
    )


def _instant(value: Any) -> str:
    if datetime.fromisoformat(_typed(value, str)).tzinfo is None:
        raise ValueError(f"time {value!r} has no offset from UTC")
    return str(value)


def _typed(value: Any, kind: type[T]) -> T:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"expected {kind.__name__}, found {value!r}")
    return value
