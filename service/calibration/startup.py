"""What a start of the daemon finds of calibrations, and which one it uses.

The rig file of the configuration is the first version. It wins over what was activated whenever its content is
not what it was at the last start: whoever changes it means it. Otherwise the choice of before holds.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.times import utc_now
from pipeline.rig.cameras import RigCalibration
from service.calibration.files import (
    Activation,
    Activations,
    CalibrationFiles,
    CalibrationRecord,
    image_sizes_px,
)
from service.calibration.states import OPEN, CalibrationState

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationsFound:
    """All calibrations at the start of the daemon."""

    files: CalibrationFiles
    records: dict[str, CalibrationRecord]  # by id, oldest first
    activations: Activations
    active: CalibrationRecord  # the one in use
    rig: RigCalibration  # its rig
    trouble: str | None  # why it is not the one that was activated last


def find_calibrations(folder: Path, configured: RigCalibration) -> CalibrationsFound:
    """Settle which calibration is in use, and what becomes of an open session; blocks.

    Raises
    ------
    RecordingError
        The list of activations is damaged: it is not guessed what was in use.
    """
    files = CalibrationFiles(folder)
    files.clean()
    records = {record.id: record for record in files.records()}
    try:
        activations = files.activations()
    except RecordingError as err:
        remedy = (
            "activate a calibration again after you have removed it: then the configured rig file is used"
        )
        raise RecordingError(err.path, f"{err.problem}; {remedy}") from err
    if activations.configured_calibration_id != configured.calibration_id:
        why = "the configured rig file was changed"
        activations = _take_over(files, records, activations, configured, why)
    found = _usable(files, records, activations, configured)
    if found is None:
        why = "no calibration that was in use can be read"
        activations = _take_over(files, records, activations, configured, why)
        record = records[activations.items[-1].id]
        found = (
            record,
            _mended(files, record, configured),
            f"{why}, the configured rig file is used: activate another",
        )
    active, rig, trouble = found
    for record in list(records.values()):
        if record.state in OPEN:
            records[record.id] = _resumed(files, record, active)
    return CalibrationsFound(
        files=files, records=records, activations=activations, active=active, rig=rig, trouble=trouble
    )


def _take_over(
    files: CalibrationFiles,
    records: dict[str, CalibrationRecord],
    activations: Activations,
    configured: RigCalibration,
    why: str,
) -> Activations:
    """Make the configured rig file a version, unless it is one, and the one in use."""
    known = [
        record
        for record in records.values()
        if record.state is CalibrationState.ACCEPTED and record.calibration_id == configured.calibration_id
    ]
    if known:
        record = known[-1]
    else:
        record = CalibrationRecord(
            id=files.next_name(),
            origin="configured",
            state=CalibrationState.ACCEPTED,
            method=configured.method,
            created_at=utc_now(),
            changed_at=utc_now(),
            note=why if records else "initial",
            calibration_id=configured.calibration_id,
        )
        files.create(record, configured)
        records[record.id] = record
    if activations.items:
        log.warning("%s: the configured rig file is used from now on calibration=%s", why, record.id)
    chosen = Activation(
        id=record.id, calibration_id=configured.calibration_id, at=utc_now(), by="configuration"
    )
    activations = Activations(
        configured_calibration_id=configured.calibration_id, items=(*activations.items, chosen)
    )
    files.write_activations(activations)
    return activations


def _usable(
    files: CalibrationFiles,
    records: Mapping[str, CalibrationRecord],
    activations: Activations,
    configured: RigCalibration,
) -> tuple[CalibrationRecord, RigCalibration, str | None] | None:
    """The calibration activated last whose rig can be used, and what is wrong with a later one."""
    trouble = None
    for activation in reversed(activations.items):
        try:
            record = records[activation.id]
            if record.calibration_id == configured.calibration_id:
                return record, _mended(files, record, configured), trouble
            rig = files.rig(record)
            if image_sizes_px(rig) == image_sizes_px(configured):
                return record, rig, trouble
            log.error("calibration %s cannot be used: it was made with other cameras", record.id)
        except (KeyError, RecordingError) as err:
            log.error("calibration %s cannot be used, the one before is: %s", activation.id, err)
            trouble = (
                trouble
                or f"calibration {activation.id} is damaged and an older one is in use: activate another"
            )
    return None


def _mended(files: CalibrationFiles, record: CalibrationRecord, configured: RigCalibration) -> RigCalibration:
    """The configured rig, in whose place on disk its copy is there again."""
    try:
        return files.rig(record)
    except RecordingError as err:
        log.error("written anew from the configured rig file: %s", err)
        files.write_rig(record, configured)
    return configured


def _resumed(
    files: CalibrationFiles, record: CalibrationRecord, active: CalibrationRecord
) -> CalibrationRecord:
    """An open session as a restart leaves it: without its unfinished solution, or cancelled."""
    if record.initial_calibration_id != active.calibration_id:
        detail = "another calibration is in use since the daemon was started again"
        record = replace(record, state=CalibrationState.CANCELLED, detail=detail, changed_at=utc_now())
    elif record.state is CalibrationState.SOLVING or not _is_whole(files, record):
        record = replace(
            record, state=CalibrationState.COLLECTING, calibration_id=None, detail=None, changed_at=utc_now()
        )
    files.write(record)
    log.warning("calibration %s: %s after a restart", record.id, record.state)
    return record


def _is_whole(files: CalibrationFiles, record: CalibrationRecord) -> bool:
    if record.state is not CalibrationState.SOLVED:
        return True
    try:
        files.rig(record)
        return files.report(record) is not None
    except RecordingError:
        return False
