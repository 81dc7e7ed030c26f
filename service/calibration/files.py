"""Calibrations on disk: one folder each, and which one is in use. Everything blocks; every write is durable.

::

    calibrations/activations.json       which was activated when; the latest is in use
    calibrations/0001/session.json      its `CalibrationRecord`
    calibrations/0001/rig.json          the rig with its checksum, as soon as there is one
    calibrations/0001/report.json       the report of the solution
    calibrations/0001/drops/            its drops, see `service.calibration.drop_files`

A file is replaced as a whole or not at all, and which calibration is in use stands in one file: a process that is
killed at any moment leaves the old state or the new one. A file is written before another one names it.
"""

import logging
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from drivers.errors import RecordingError
from drivers.files.durable import new_folder, read_json, write_json
from drivers.files.rig_file import read_rig, write_rig
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base import aside
from service.base.messages import CodedFinding
from service.base.schema import Time, served
from service.calibration.states import CalibrationState
from service.processing.measure_job import RigFile

log = logging.getLogger(__name__)

CALIBRATION_NAME = re.compile(r"[0-9]{4,9}")
"""Name of a calibration or verification: its number."""
RIG, REPORT, SESSION = "rig.json", "report.json", "session.json"
DROPS, ACTIVATIONS = "drops", "activations.json"

Document = TypeVar("Document")


@served
class CalibrationRecord:
    """One calibration. It is open until it is accepted, rejected or cancelled; an accepted one is a version."""

    id: str
    """Name of the calibration in the addresses."""
    origin: Literal["configured", "session"]
    """`configured`: from the rig file of the configuration; `session`: from drops."""
    state: CalibrationState
    """Its state: `collecting`, `solving` and `solved` are open, the others ended."""
    method: str
    """`bundle`, `paper` or `stones` as requested; of a configured rig file also `nominal` or `imported`."""
    ball_diameters_mm: tuple[float, ...] = ()
    """As requested, mm."""
    created_at: Time
    """When it was begun, RFC 3339 UTC."""
    changed_at: Time
    """Latest change of its state."""
    by: str | None = None
    """Who began it."""
    decided_by: str | None = None
    """Who accepted, rejected or cancelled it."""
    note: str | None = None
    """Whatever was noted when it was begun; null for nothing."""
    initial_calibration_id: str | None = None
    """`calibration_id` in use when it was begun."""
    calibration_id: str | None = None
    """Checksum of its rig file, which results name; null without a rig."""
    detail: str | None = None
    """Why it was cancelled, could not be solved, or must not be accepted; null otherwise."""
    findings: tuple[CodedFinding, ...] = ()
    """What `detail` says, as codes with their parameters; `reported` where it is the solution's own text."""


def fields_of(record: CalibrationRecord) -> dict[str, Any]:
    """Return the fields of a record by name, their values as they are."""
    return {each.name: getattr(record, each.name) for each in fields(record)}


@served
class CalibrationSummary(CalibrationRecord):
    """One calibration. It is open until it is accepted, rejected or cancelled; an accepted one is a version."""

    is_active: bool
    """True if stones are measured with it now."""


@served
class Activation:
    """One activation of a calibration."""

    id: str
    """`id` of the calibration."""
    calibration_id: str
    """Checksum of its rig file, which results name."""
    at: Time
    """When it was activated, RFC 3339 UTC."""
    by: str | None = None
    """Who activated it; null: unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Activations:
    """All activations, oldest first."""

    configured_calibration_id: str | None = None  # of the configured rig file at the latest start
    items: tuple[Activation, ...] = ()


@dataclass(frozen=True, slots=True)
class CalibrationFiles:
    """The folder of all calibrations."""

    folder: Path

    def clean(self) -> None:
        """Create the folder, and remove unfinished files of a process that was killed."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for unfinished in self.folder.glob(".*.unfinished"):
            shutil.rmtree(unfinished, ignore_errors=True)

    def records(self) -> list[CalibrationRecord]:
        """Read all records, oldest first; a damaged one is logged and left out."""
        paths = {path.name: path / SESSION for path in self.folder.iterdir()}
        return read_numbered("calibration", paths, CalibrationRecord)

    def drops(self, name: str) -> Path:
        """Return the folder of the drops of a calibration, see `service.calibration.drop_files`."""
        return self.folder / name / DROPS

    def next_name(self) -> str:
        """Return a name that no calibration has or had."""
        taken = [int(path.name) for path in self.folder.iterdir() if CALIBRATION_NAME.fullmatch(path.name)]
        return f"{max(taken, default=0) + 1:04d}"

    def create(self, record: CalibrationRecord, rig: RigCalibration | None = None) -> None:
        """Create the folder of a calibration, with its rig if there is one already."""
        with new_folder(self.folder / record.id) as folder:
            (folder / DROPS).mkdir()
            if rig is not None:
                write_rig(folder / RIG, rig)
            write_document(folder / SESSION, record)

    def write(self, record: CalibrationRecord) -> None:
        """Replace the record of a calibration."""
        write_document(self.folder / record.id / SESSION, record)

    def activations(self) -> Activations:
        """Read the activations, none before the first start; raise `RecordingError` when the file is damaged."""
        path = self.folder / ACTIVATIONS
        return read_document(path, Activations) if path.exists() else Activations()

    def set_activations_aside(self, why: str) -> None:
        """Move the damaged list of activations away, with a note that says why."""
        path, folder = self.folder / ACTIVATIONS, aside.new_folder(self.folder.parent, "damaged")
        path.replace(folder / ACTIVATIONS)
        aside.explain(folder, why)

    def write_activations(self, activations: Activations) -> None:
        """Replace the list of activations, and thereby which calibration is in use."""
        write_document(self.folder / ACTIVATIONS, activations)

    def rig(self, record: CalibrationRecord) -> RigCalibration:
        """Read the rig; raise `RecordingError` when it is missing, damaged or not the one recorded."""
        path = self.folder / record.id / RIG
        rig = read_rig(path)
        if rig.calibration_id != record.calibration_id:
            raise RecordingError(path, f"is not the rig of calibration {record.id}: the file was replaced")
        return rig

    def rig_file(self, record: CalibrationRecord) -> RigFile:
        """Return path and id of the rig, as jobs name it; `ValueError` without a rig."""
        if record.calibration_id is None:
            raise ValueError(f"calibration {record.id} has no rig")
        return RigFile(self.folder / record.id / RIG, record.calibration_id)

    def report(self, record: CalibrationRecord) -> dict[str, Any] | None:
        """Read the report of the solution, None for a configured rig."""
        path = self.folder / record.id / REPORT
        return dict(read_json(path)) if path.exists() else None


def image_sizes_px(rig: RigCalibration) -> dict[CameraId, tuple[int, int]]:
    """Return width and height of the images by camera; equal in all calibrations of the same cameras."""
    return {camera.id: camera.image_size_px for camera in rig.cameras}


_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def write_document(path: Path, document: Any) -> None:
    """Write a dataclass durably to a JSON file."""
    write_json(path, _adapter(type(document)).dump_python(document, mode="json"))


def read_document(path: Path, kind: type[Document]) -> Document:
    """Read a dataclass from a JSON file; raise `RecordingError`, which names file and field, if it cannot be."""
    try:
        found: Document = _adapter(kind).validate_python(read_json(path))
        return found
    except ValidationError as err:
        error = err.errors()[0]
        raise RecordingError(path, f"{'.'.join(map(str, error['loc']))}: {error['msg']}") from err


def read_numbered(what: str, paths: Mapping[str, Path], kind: type[Document]) -> list[Document]:
    """Read the files whose names are numbers, oldest first; a damaged one is logged and left out."""
    found = []
    for name in sorted(filter(CALIBRATION_NAME.fullmatch, paths)):
        try:
            found.append(read_document(paths[name], kind))
        except RecordingError as err:
            log.error("%s %s is not used: %s", what, name, err)
    return found
