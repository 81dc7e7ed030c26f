"""The choice of the calibration that the daemon uses when it starts.

The rig file of the configuration is the first version. If its content has changed since the latest start, it is
activated; otherwise the calibration that was activated last is used.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.rig_file import write_rig
from drivers.files.times import utc_now
from pipeline.rig.cameras import RigCalibration
from service.base.messages import Code, findings_of, message
from service.calibration.files import (
    Activation,
    Activations,
    CalibrationFiles,
    CalibrationRecord,
    image_sizes_px,
)
from service.calibration.states import OPEN, CalibrationState

log = logging.getLogger(__name__)

LOST_LIST = message(Code.CALIBRATION_LIST_LOST)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationsAtStart:
    """All calibrations when the daemon starts."""

    files: CalibrationFiles
    records: dict[str, CalibrationRecord]  # by id, oldest first
    activations: Activations
    active: CalibrationRecord  # in use
    rig: RigCalibration  # of the calibration in use
    trouble: str | None  # why the calibration in use is not the one activated last


def load_calibrations(folder: Path, configured: RigCalibration) -> CalibrationsAtStart:
    """Read all calibrations, decide which one is in use, and resume or cancel an open one; blocks.

    When the list of activations is damaged, which calibration was in use is not guessed: the configured one is.
    """
    files = CalibrationFiles(folder)
    files.clean()
    records = {record.id: record for record in files.records()}
    lost = None
    try:
        activations = files.activations()
    except RecordingError as err:
        files.set_activations_aside(f"{err}; {LOST_LIST}")
        activations, lost = Activations(), LOST_LIST
    if activations.configured_calibration_id != configured.calibration_id:
        why = "the configured rig file was changed"
        activations = _activate_configured(files, records, activations, configured, why)
    usable = _latest_usable(files, records, activations, configured)
    if usable is None:
        why = "no calibration that was in use can be read"
        activations = _activate_configured(files, records, activations, configured, why)
        record = records[activations.items[-1].id]
        remedy = message(Code.CALIBRATIONS_UNREADABLE)
        usable = record, _configured_rig(files, record, configured), remedy
    active, rig, trouble = usable
    for record in list(records.values()):
        if record.state in OPEN:
            records[record.id] = _after_restart(files, record, active)
    return CalibrationsAtStart(
        files=files, records=records, activations=activations, active=active, rig=rig, trouble=trouble or lost
    )


def _activate_configured(
    files: CalibrationFiles,
    records: dict[str, CalibrationRecord],
    activations: Activations,
    configured: RigCalibration,
    why: str,
) -> Activations:
    """Make the configured rig file a version, unless it is one already, and activate it."""
    accepted, calibration_id = CalibrationState.ACCEPTED, configured.calibration_id
    of_this_rig = (record for record in reversed(records.values()) if record.calibration_id == calibration_id)
    record = next((record for record in of_this_rig if record.state is accepted), None)
    if record is None:
        record = CalibrationRecord(
            id=files.next_name(),
            origin="configured",
            state=accepted,
            method=configured.method,
            created_at=utc_now(),
            changed_at=utc_now(),
            note=why if records else "initial",
            calibration_id=calibration_id,
        )
        files.create(record, configured)
        records[record.id] = record
    if activations.items:
        log.warning("%s: the configured rig file is used from now on calibration=%s", why, record.id)
    chosen = Activation(id=record.id, calibration_id=calibration_id, at=utc_now(), by="configuration")
    activations = Activations(configured_calibration_id=calibration_id, items=(*activations.items, chosen))
    files.write_activations(activations)
    return activations


def _latest_usable(
    files: CalibrationFiles,
    records: Mapping[str, CalibrationRecord],
    activations: Activations,
    configured: RigCalibration,
) -> tuple[CalibrationRecord, RigCalibration, str | None] | None:
    """Return the latest activated calibration whose rig is usable, its rig, and why not a later one; None without."""
    trouble = None
    for activation in reversed(activations.items):
        try:
            record = records[activation.id]
            if record.calibration_id == configured.calibration_id:
                return record, _configured_rig(files, record, configured), trouble
            rig = files.rig(record)
            if image_sizes_px(rig) == image_sizes_px(configured):
                return record, rig, trouble
            log.error("calibration %s cannot be used: it was made with other cameras", record.id)
        except (KeyError, RecordingError) as err:
            log.error("calibration %s cannot be used, the one before is: %s", activation.id, err)
            why = err.problem if isinstance(err, RecordingError) else "its record is not there"
            trouble = trouble or message(Code.CALIBRATION_DAMAGED, calibration=activation.id, reported=why)
    return None


def _configured_rig(
    files: CalibrationFiles, record: CalibrationRecord, configured: RigCalibration
) -> RigCalibration:
    """Return the configured rig; its copy on disk is written again if it is damaged."""
    try:
        return files.rig(record)
    except RecordingError as err:
        log.error("restored from the configured rig file: %s", err)
        write_rig(files.rig_file(record).path, configured)
    return configured


def _after_restart(
    files: CalibrationFiles, record: CalibrationRecord, active: CalibrationRecord
) -> CalibrationRecord:
    """Return an open calibration as it goes on: without an unfinished solution, or cancelled."""
    if record.initial_calibration_id != active.calibration_id:
        detail = message(Code.CALIBRATION_CHANGED)
        record = replace(
            record,
            state=CalibrationState.CANCELLED,
            detail=detail,
            findings=findings_of(detail),
            changed_at=utc_now(),
        )
    elif record.state is CalibrationState.SOLVING or not _has_whole_solution(files, record):
        record = replace(
            record,
            state=CalibrationState.COLLECTING,
            calibration_id=None,
            detail=None,
            findings=(),
            changed_at=utc_now(),
        )
    files.write(record)
    log.warning("calibration %s: %s after a restart", record.id, record.state)
    return record


def _has_whole_solution(files: CalibrationFiles, record: CalibrationRecord) -> bool:
    if record.state is not CalibrationState.SOLVED:
        return True
    try:
        files.rig(record)
        return files.report(record) is not None
    except RecordingError:
        return False
