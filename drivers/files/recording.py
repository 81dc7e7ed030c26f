"""The recording: a folder of bundle files, their cameras and the calibrated rig.

`recording.json` names the cameras and what was recorded, `rig.json` (optional) is the rig file, and
`bundles/<name>.tiff` are the bundles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.errors import RecordingError
from drivers.files.bundle_file import Compression, read_bundle, read_header, require_cameras_of, write_bundle
from drivers.files.bundle_header import BundleHeader
from drivers.files.durable import new_folder, read_json, write_json
from drivers.files.rig_file import read_rig, write_rig
from drivers.files.times import utc_now
from pipeline.fall import FALL_HEIGHT_MM, Fall
from pipeline.formats import unread_format
from pipeline.frames import CAMERA_ID, BundleKind, CameraId, FrameBundle, Trigger
from pipeline.rig.cameras import RigCalibration

__all__ = [
    "BundleHeader",
    "Recording",
    "RecordingSource",
    "RecordingWriter",
    "open_recording",
    "playback_order",
    "read_bundle",
    "read_header",
    "require_rig_of",
    "unreadable_triggers",
    "write_bundle",
]

FORMAT = "stonefall-recording/1"
UNKNOWN_UTC = "1970-01-01T00:00:00.000Z"
UNREADABLE_SPACING_NS = 250_000_000
MAX_FALL = {"fall_height_mm": 100_000, "speed_at_gate_mm_s": 100_000}


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """An opened recording, without pixels."""

    path: Path
    camera_ids: tuple[CameraId, ...]
    image_size_px: tuple[int, int]  # W, H
    rig_name: str
    is_simulated: bool
    holds_masks: bool  # silhouettes, 255 where the body is, instead of photographs
    fall: Fall  # of the stones from the gate
    rig: RigCalibration | None
    document: Mapping[str, Any]
    """The content of recording.json."""
    headers: tuple[BundleHeader, ...]
    """The bundles that can be used, in order of sequence."""
    unreadable: tuple[RecordingError, ...]
    """The bundles that cannot be used, and why."""


def open_recording(path: Path, *, takes_masks: bool = False) -> Recording:
    """Open a recording; reads recording.json, rig.json and the header of every bundle, no pixels.

    Raises
    ------
    RecordingError
        recording.json is missing, it or rig.json is damaged or of another version, the rig is one of other cameras,
        or no bundle can be used; or the recording holds masks, and only photographs are taken.
    """
    document_path = path / "recording.json"
    if not document_path.is_file():
        raise RecordingError(path, "is not a recording: it has no recording.json")
    document = read_json(document_path)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        found = document.get("format") if isinstance(document, dict) else None
        raise RecordingError(document_path, f"format: {unread_format(found, FORMAT)}")
    camera_ids = _camera_ids(document_path, document)
    size_px = _image_size(document_path, document)
    is_simulated = document.get("is_simulated")
    if not isinstance(is_simulated, bool):
        raise RecordingError(document_path, f"is_simulated: must be true or false, not {is_simulated!r}")
    holds_masks = document.get("holds_masks", False)
    if holds_masks and not takes_masks:
        raise RecordingError(path, "holds masks, not photographs: only `stonefall measure` takes those")
    rig_path = path / "rig.json"
    rig = read_rig(rig_path) if rig_path.exists() else None
    if rig is not None:
        _require_rig_of(rig_path, rig, camera_ids, size_px)
    headers, unreadable = _read_headers(path / "bundles", camera_ids, size_px)
    return Recording(
        path=path,
        camera_ids=camera_ids,
        image_size_px=size_px,
        rig_name=str(document.get("rig_name", "")),
        is_simulated=is_simulated,
        holds_masks=bool(holds_masks),
        fall=_fall(document_path, document),
        rig=rig,
        document=document,
        headers=headers,
        unreadable=unreadable,
    )


def playback_order(recording: Recording) -> list[BundleHeader]:
    """Return the bundles by sequence, but all backgrounds first if a stone would come before the first of them."""
    headers = list(recording.headers)
    if headers and headers[0].kind is not BundleKind.BACKGROUND:
        headers.sort(key=lambda header: header.kind is not BundleKind.BACKGROUND)
    return headers


def unreadable_triggers(recording: Recording) -> list[tuple[Trigger, RecordingError]]:
    """Return a trigger for each bundle that cannot be used, with the error, so that every stone is accounted for.

    They follow after all other triggers. When they were recorded is not known: their time is in 1970.
    """
    last = recording.headers[-1].trigger
    return [
        (
            Trigger(
                sequence=last.sequence + number,
                received_ns=last.received_ns + number * UNREADABLE_SPACING_NS,
                device_ns=0,
                utc=UNKNOWN_UTC,
                name=error.path.stem,
            ),
            error,
        )
        for number, error in enumerate(recording.unreadable, start=1)
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSource:
    """Description of the rig that is recorded."""

    camera_ids: tuple[CameraId, ...]  # in the order of the pages of bundle files
    rig: RigCalibration
    is_simulated: bool
    holds_masks: bool = False  # silhouettes, 255 where the body is, instead of photographs
    camera_settings: Mapping[str, Any] = field(default_factory=dict)  # JSON, as recording.json has them
    gate_settings: Mapping[str, Any] = field(default_factory=dict)
    fall: Fall = field(default_factory=Fall)

    @property
    def image_size_px(self) -> tuple[int, int]:
        """Width and height of all images."""
        return self.rig.cameras[0].image_size_px

    @property
    def bundle_bytes(self) -> int:
        """Largest size of a bundle on disk."""
        width_px, height_px = self.image_size_px
        return len(self.camera_ids) * (width_px * height_px + 4096)


class RecordingWriter:
    """Writes a recording as a context manager: the folder takes its name when the block ends without error.

    Files that belong beside the bundles (such as `truth.jsonl`) are written into `folder` meanwhile.

    Raises
    ------
    RecordingError
        `path` exists and is not an empty folder.
    """

    def __init__(
        self,
        path: Path,
        source: RecordingSource,
        *,
        made_by: Mapping[str, Any],
        compression: Compression = "zstd",
    ) -> None:
        self.path = path
        self.folder = path  # until the block is entered
        self.made_by = dict(made_by)
        self._creation = new_folder(path)
        self._source = source
        self._compression: Compression = compression
        self._names: set[str] = set()
        self._document = {
            "format": FORMAT,
            "created_at": utc_now("seconds"),
            "cameras": list(source.camera_ids),
            "image_size_px": list(source.image_size_px),
            "rig_name": source.rig.name,
            "is_simulated": source.is_simulated,
            "camera_settings": dict(source.camera_settings),
            "gate_settings": dict(source.gate_settings),
            "made_by": self.made_by,
        }
        if source.holds_masks:
            self._document["holds_masks"] = True
        _require_rig_of(path / "rig.json", source.rig, source.camera_ids, source.image_size_px)

    def __enter__(self) -> Self:
        self.folder = self._creation.__enter__()
        (self.folder / "bundles").mkdir()
        write_json(self.folder / "recording.json", self._document)
        write_rig(self.folder / "rig.json", self._source.rig)
        return self

    def add(self, bundle: FrameBundle) -> None:
        """Write one bundle.

        Raises
        ------
        RecordingError
            Its name is not fit for a file or is taken, its images have another size, or `write_bundle` refuses it.
        """
        path = self.folder / "bundles" / f"{bundle.name}.tiff"
        if bundle.name != path.stem or path.parent.name != "bundles" or bundle.name.startswith("."):
            raise RecordingError(path, f"{bundle.name!r} cannot be the name of a file")
        if bundle.name in self._names:
            raise RecordingError(path, f"the recording already has a bundle {bundle.name}")
        for frame in bundle.frames.values():
            if (size_px := frame.image.shape[::-1]) != self._source.image_size_px:
                raise RecordingError(
                    path, f"camera {frame.camera}: {_sizes(size_px, self._source.image_size_px)}"
                )
        write_bundle(path, bundle, self._source.camera_ids, compression=self._compression)
        self._names.add(bundle.name)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._creation.__exit__(kind, error, traceback)


def _read_headers(
    folder: Path, camera_ids: tuple[CameraId, ...], size_px: tuple[int, int]
) -> tuple[tuple[BundleHeader, ...], tuple[RecordingError, ...]]:
    paths = sorted(folder.glob("*.tiff"))
    if not paths:
        raise RecordingError(folder, "holds no bundle")
    headers: list[BundleHeader] = []
    unreadable: list[RecordingError] = []
    for path in paths:
        try:
            header = read_header(path)
            require_cameras_of(header, camera_ids)
            if header.image_size_px != size_px:
                raise RecordingError(path, _sizes(header.image_size_px, size_px))
            if header.name != path.stem:
                raise RecordingError(path, f"holds bundle {header.name!r}: the file was renamed or copied")
        except RecordingError as err:
            unreadable.append(err)
        else:
            headers.append(header)
    if not headers:
        raise RecordingError(folder, f"none of its {len(paths)} bundles can be used; {unreadable[0]}")
    headers.sort(key=lambda header: (header.sequence, header.name))
    return tuple(headers), tuple(unreadable)


def require_rig_of(recording: Recording, rig: RigCalibration, path: Path) -> None:
    """Check that a rig, read from `path`, has the cameras of a recording.

    Raises
    ------
    RecordingError
        Names `path` and the cameras it lacks, or the camera with images of another size.
    """
    _require_rig_of(path, rig, recording.camera_ids, recording.image_size_px)


def _require_rig_of(
    path: Path, rig: RigCalibration, camera_ids: Sequence[CameraId], size_px: tuple[int, int]
) -> None:
    if missing := sorted(set(camera_ids) - set(rig.camera_ids)):
        raise RecordingError(path, f"is the rig of other cameras: it has no {', '.join(missing)}")
    for camera in rig.cameras:
        if camera.id in camera_ids and camera.image_size_px != size_px:
            raise RecordingError(path, f"camera {camera.id}: {_sizes(camera.image_size_px, size_px)}")


def _sizes(found_px: Sequence[int], expected_px: Sequence[int]) -> str:
    found, expected = ("x".join(map(str, size_px)) for size_px in (found_px, expected_px))
    return f"images of {found} in a recording of {expected} px"


def _camera_ids(path: Path, document: Mapping[str, Any]) -> tuple[CameraId, ...]:
    ids = document.get("cameras")
    if not isinstance(ids, list) or not ids or not all(isinstance(item, str) for item in ids):
        raise RecordingError(path, f"cameras: must be a list of camera ids, not {ids!r}")
    for camera in ids:
        if not CAMERA_ID.fullmatch(camera):
            raise RecordingError(
                path, f"cameras: {camera!r} is not a camera id (letters, digits, '-' and '_')"
            )
    if len(set(ids)) < len(ids):
        raise RecordingError(path, "cameras: an id occurs twice")
    return tuple(CameraId(item) for item in ids)


def _image_size(path: Path, document: Mapping[str, Any]) -> tuple[int, int]:
    size_px = document.get("image_size_px")
    match size_px:
        case [int(width_px), int(height_px)] if width_px > 0 and height_px > 0:
            return width_px, height_px
    raise RecordingError(path, f"image_size_px: must be [W, H] in pixels, not {size_px!r}")


def _fall(path: Path, document: Mapping[str, Any]) -> Fall:
    """Return the fall that recording.json gives; by default from rest at the beam, from the usual height."""
    settings = document.get("gate_settings", {})
    if not isinstance(settings, Mapping):
        raise RecordingError(path, f"gate_settings: must be an object, not {settings!r}")

    def given(name: str, least: float, default: float) -> float:
        match settings.get(name, default):
            case int(value) | float(value) if least <= value <= MAX_FALL[name]:
                return float(value)
            case other:
                wrong = f"gate_settings.{name}: must be in {least:g}..{MAX_FALL[name]:g}, not {other!r}"
                raise RecordingError(path, wrong)

    return Fall(
        height_mm=given("fall_height_mm", 1, FALL_HEIGHT_MM),
        speed_at_gate_mm_s=given("speed_at_gate_mm_s", 0, 0.0),
    )
