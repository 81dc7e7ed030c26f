"""Make the archive: a .tar.gz of a few texts, bounded in size and time, without secrets.

Everything that goes in passes `add`, which scrubs it: known secrets wherever they stand, and what looks like one. A
part that cannot be read is named in `missing.txt` and takes nothing else with it.
"""

import io
import json
import os
import platform
import sqlite3
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.files.rig_file import read_rig
from drivers.files.times import utc_now
from service.base.redaction import redacted, scrubbed
from service.calibration.files import CalibrationFiles
from service.health.alarms.alarms import history
from service.host.host import Host
from service.host.machine import HostNeeds, check_host
from service.results.version import ALGORITHM_VERSION
from service.store import read
from service.store.accounting import accounting
from service.store.events import event_ends, events_after
from service.store.history import DATABASE

MAX_PART_BYTES = 4 << 20
"""The end of a longer part is kept: what is newest in a log."""
MAX_S = 15.0
"""Parts that would begin later are left out: the last is the log, which may take 10 s of a request's 30."""
FOLDER = "stonefall-diagnostics"
N_ALARMS, N_EVENTS = 200, 500
LOG_LINES = 5000
LOG_S = 10.0
"""Longest time that the journal may take to answer."""
README = """What stonefall says of itself, for support: configuration, versions, health, host, store, calibrations, log.
Keys, tokens, secrets of webhooks, and all of URLs but host and first part of the path were replaced by `redacted`.
It has names of devices and addresses of the plant, but no images, no meshes and no results.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Where to look, and what the running daemon adds; all of it can be pickled."""

    store_dir: Path
    calibration: Path  # the configured rig file
    needs: HostNeeds
    secrets: frozenset[str]
    """What must not appear in the archive, wherever it stands."""
    configuration: Mapping[str, Any]  # as JSON has it
    live: Mapping[str, Any] = field(default_factory=dict)
    """By the name of the file: documents and texts of the running daemon; empty when none runs."""


def build_archive(inputs: Inputs) -> bytes:
    """Return the archive; blocks for seconds."""
    known = inputs.secrets
    texts = {"README.txt": README}
    missing = [] if inputs.live else ["health, cameras, acquisition, alarms, metrics: no daemon runs"]

    def add(name: str, content: Any) -> None:
        if isinstance(content, str):
            text = scrubbed(content, known)
        else:
            # as JSON and back: whatever was in it is plain values then
            plain = json.loads(json.dumps(content, default=str))
            text = json.dumps(redacted(plain, partial(scrubbed, known=known)), indent=1, ensure_ascii=False)
        data = text.encode()
        if len(data) > MAX_PART_BYTES:
            missing.append(f"{name}: its first {len(data) - MAX_PART_BYTES} bytes")
        texts[name] = data[-MAX_PART_BYTES:].decode(errors="ignore")

    add("configuration.json", inputs.configuration)
    for name, content in inputs.live.items():
        add(name, content)
    end_s = time.monotonic() + MAX_S
    for name, part in PARTS.items():
        if time.monotonic() > end_s:
            missing.append(f"{name}: no time was left")
            continue
        try:
            add(name, part(inputs))
        except Exception as err:  # noqa: BLE001 - of a machine where anything may be broken
            missing.append(f"{name}: {scrubbed(str(err), known)}")
    texts["missing.txt"] = "\n".join([*missing, ""]) if missing else "nothing is missing\n"
    return _packed(texts)


def _packed(texts: Mapping[str, str]) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz", compresslevel=6) as tar:
        for name, text in texts.items():
            data = text.encode()
            member = tarfile.TarInfo(f"{FOLDER}/{name}")
            member.size, member.mtime, member.mode = len(data), int(time.time()), 0o600
            tar.addfile(member, io.BytesIO(data))
    return packed.getvalue()


def _versions(inputs: Inputs) -> Mapping[str, Any]:
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


def _store(connection: sqlite3.Connection) -> Mapping[str, Any]:
    """Return schema, accounting, newest events and the history of the alarms; the database is only read."""
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


def _calibrations(inputs: Inputs) -> Mapping[str, Any]:
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


def _folders(inputs: Inputs) -> Mapping[str, Any]:
    """Count the files in the folders of the store and quote the notes on what was moved aside."""
    aside = inputs.store_dir / "aside"
    notes = {
        str(note.parent.name): note.read_text(errors="replace")[:10_000] for note in aside.glob("*/note.txt")
    }
    found = sorted(each for each in inputs.store_dir.iterdir() if each.is_dir())
    return {"folders": {each.name: sum(1 for _ in each.iterdir()) for each in found}, "aside": notes}


def _log(inputs: Inputs) -> str:
    """Return the newest lines of the service's journal, or why they cannot be read."""
    command = ["journalctl", "--unit=stonefall", "--no-pager", "--output=short-iso", f"--lines={LOG_LINES}"]
    try:
        done = subprocess.run(  # noqa: S603 - of no client
            command, capture_output=True, timeout=LOG_S, check=False, text=True, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired) as err:
        return f"the journal cannot be read: {err}\n"
    return done.stdout or f"the journal cannot be read: {done.stderr or 'it has no lines of this unit'}\n"


PARTS: Mapping[str, Callable[[Inputs], Any]] = {
    "versions.json": _versions,
    "host.json": lambda inputs: [asdict(finding) for finding in check_host(Host(), inputs.needs)],
    "store.json": lambda inputs: read(inputs.store_dir / DATABASE, _store),
    "calibrations.json": _calibrations,
    "folders.json": _folders,
    "log.txt": _log,
}
"""The parts that need no daemon; each blocks."""
