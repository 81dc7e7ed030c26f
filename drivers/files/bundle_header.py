"""The JSON header of a bundle file, format "stonefall-bundle/1", with a checksum of itself and of every page."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeVar

from imagecodecs import deflate_crc32

from drivers.errors import RecordingError
from pipeline.formats import unread_format
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Image, NearStone, Trigger

FORMAT = "stonefall-bundle/1"

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameEntry:
    """Entry of the header for one frame."""

    page: int
    frame_id: int
    device_ns: int
    received_ns: int
    crc32: int  # of the pixels, row by row


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleHeader:
    """A bundle without its pixels."""

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


def crc32(data: bytes | memoryview) -> int:
    """Return the CRC-32 of zlib, at 7 GB/s instead of 3."""
    return deflate_crc32(data)  # type: ignore[arg-type]  # its stub knows no memoryview


def header_text(bundle: FrameBundle, frames: Sequence[Frame], images: Sequence[Image]) -> str:
    """Return the header of a bundle whose pages are `images`, contiguous and in the order of `frames`."""
    return json.dumps(_document(bundle, frames, images))


def parse_header(path: Path, description: str) -> BundleHeader:
    """Parse a text that `header_text` made; `path` is that of its file.

    Raises
    ------
    RecordingError
        The text is no header, of another version, or damaged.
    """
    try:
        document = json.loads(description)
    except (ValueError, RecursionError) as err:
        raise RecordingError(
            path, "is not a stonefall bundle: its first page has no JSON description"
        ) from err
    if not isinstance(document, dict) or "format" not in document:
        raise RecordingError(path, "is not a stonefall bundle: its description names no format")
    if document["format"] != FORMAT:
        raise RecordingError(path, f"format: {unread_format(document['format'], FORMAT)}")
    if document.get("checksum") != _checksum(document):
        raise RecordingError(path, "header is damaged: it does not match its checksum")
    try:
        return _parse(path, document)
    except (KeyError, TypeError, ValueError) as err:
        raise RecordingError(path, f"header is wrong: {type(err).__name__} {err}") from err


def _document(bundle: FrameBundle, frames: Sequence[Frame], images: Sequence[Image]) -> dict[str, Any]:
    trigger = bundle.trigger
    height_px, width_px = images[0].shape
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
                "checksum": f"{crc32(image.data):08x}",
            }
            for page, (frame, image) in enumerate(zip(frames, images, strict=True))
        ],
        "missing": dict(bundle.missing),
    }
    if trigger.near_stones:  # a header without them is what it always was
        document["trigger"]["near_stones"] = [list(stone) for stone in trigger.near_stones]
    document["checksum"] = _checksum(document)
    return document


def _checksum(document: Mapping[str, Any]) -> str:
    """Return the CRC-32, in hex, of the canonical JSON without the member `checksum`."""
    bare = {key: value for key, value in document.items() if key != "checksum"}
    return f"{crc32(json.dumps(bare, sort_keys=True, separators=(',', ':')).encode()):08x}"


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
            near_stones=tuple(
                NearStone(_typed(later_ns, int), None if width_ns is None else _typed(width_ns, int))
                for later_ns, width_ns in _typed(times.get("near_stones", []), list)
            ),
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
    """Return `value` as it is; raises if it is no ISO 8601 time with an offset from UTC."""
    if datetime.fromisoformat(_typed(value, str)).tzinfo is None:
        raise ValueError(f"time {value!r} has no offset from UTC")
    return str(value)


def _typed(value: Any, kind: type[T]) -> T:
    """Return `value`; raises `TypeError` if it is of another type (a boolean is no integer)."""
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"expected {kind.__name__}, found {value!r}")
    return value
