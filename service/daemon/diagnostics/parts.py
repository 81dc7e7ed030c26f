"""The parts of the archive that need no daemon: versions, store, calibrations, host, log. Each blocks."""

import os
import platform
import sqlite3
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.files.rig_file import read_rig
from drivers.files.times import utc_now
from service.calibration.files import CalibrationFiles
from service.daemon.diagnostics.inputs import Inputs
from service.health.alarms.table import history
from service.host.check import check_host
from service.host.host import Host
from service.results.version import ALGORITHM_VERSION
from service.store import read
from service.store.accounting import accounting
from service.store.events import event_ends, events_after
from service.store.history import DATABASE

N_ALARMS, N_EVENTS = 200, 500
LOG_LINES = 5000
LOG_S = 10.0
"""Longest time that the journal may take to answer."""


def versions(inputs: Inputs) -> Mapping[str, Any]:
    """Return the versions of everything that is installed: what the lock files have become here."""
    packages = {str(each.metadata["Name"]).lower(): each.version for each in metadata.distributions()}
    return {
        "made_at": utc_now(),
        "stonefall": metadata.version("stonefall"),
        "algorithm": ALGORITHM_VERSION,
        "python": sys.version,
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "packages": dict(sorted(packages.items())),
    }


def store(inputs: Inputs) -> Mapping[str, Any]:
    """Return schema, accounting, newest events and the history of the alarms; the database is only read."""
    return read(inputs.store_dir / DATABASE, _store)


def _store(connection: sqlite3.Connection) -> Mapping[str, Any]:
    (schema,) = connection.execute("PRAGMA user_version").fetchone()
    (instance_id,) = connection.execute("SELECT instance_id FROM store").fetchone()
    sessions = connection.execute(
        "SELECT session, started_at, info FROM sessions ORDER BY session DESC LIMIT 20"
    )
    _, newest = event_ends(connection)
    return {
        "schema": schema,
        "instance_id": instance_id,
        "accounting": asdict(accounting(connection, None)),
        "sessions": [dict(zip(("session", "started_at", "info"), row, strict=True)) for row in sessions],
        "events": events_after(connection, max(0, newest - N_EVENTS), N_EVENTS).items,
        "alarms": [asdict(alarm) for alarm in history(connection, None, 1 << 62, N_ALARMS)],
    }


def calibrations(inputs: Inputs) -> Mapping[str, Any]:
    """List the calibrations, their activations, and the reprojection errors of the configured one's cameras."""
    files = CalibrationFiles(inputs.store_dir / "calibrations")
    rig = read_rig(inputs.calibration)
    return {
        "configured": {
            "calibration_id": rig.calibration_id,
            "method": rig.method,
            "created_at": rig.created_at,
            "cameras": [
                {"id": each.id, "serial": each.serial, "rms_px": each.rms_px} for each in rig.cameras
            ],
        },
        "activations": asdict(files.activations()) if files.folder.is_dir() else None,
        "records": [asdict(record) for record in files.records()] if files.folder.is_dir() else [],
    }


def host(inputs: Inputs) -> list[Mapping[str, Any]]:
    """Return the findings of `stonefall check-host`."""
    return [asdict(finding) for finding in check_host(Host(), inputs.needs)]


def folders(inputs: Inputs) -> Mapping[str, Any]:
    """Count the files in the folders of the store and quote the notes on what was moved aside."""
    aside = inputs.store_dir / "aside"
    notes = {
        str(note.parent.name): note.read_text(errors="replace")[:10_000] for note in aside.glob("*/note.txt")
    }
    return {
        "folders": {each.name: sum(1 for _ in each.iterdir()) for each in _folders(inputs.store_dir)},
        "aside": notes,
    }


def _folders(folder: Path) -> list[Path]:
    return sorted(each for each in folder.iterdir() if each.is_dir())


def log(inputs: Inputs) -> str:
    """Return the newest lines of the service's journal, or why they cannot be read."""
    command = ["journalctl", "--unit=stonefall", "--no-pager", "--output=short-iso", f"--lines={LOG_LINES}"]
    try:
        done = subprocess.run(  # noqa: S603 - of no client
            command, capture_output=True, timeout=LOG_S, check=False, text=True, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired) as err:
        return f"the journal cannot be read: {err}\n"
    return done.stdout or f"the journal cannot be read: {done.stderr or 'it has no lines of this unit'}\n"
