"""The daemon of a host: its configuration, whether it runs, and whether it measures."""

import fcntl
import http.client
import json
import os
import subprocess
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from installer.host import USER, Host, InstallError
from installer.placement import CONFIGURATION
from installer.releases import FOLDER, Release
from installer.store import Copy, Stock

UNIT = "stonefall.service"
BRIDGE = "stonefall-bridge.service"
"""Placed, and left disabled: a plant enables it that needs it."""
READY_S = 90.0
"""Longest wait for readiness after the daemon has started."""
PATIENCE_S = 20.0
"""Longest look at whether the daemon from before is ready: one slow answer must not weaken the health gate."""
POLL_S = 1.0
NOT_READY = (503, "urn:stonefall:problem:not-ready")
"""Status and type of the daemon's answer while it would not measure the next stone."""


@dataclass(frozen=True)
class Configuration:
    """The configuration as a release reads it; without folder and address if it cannot read it."""

    state_dir: Path | None
    health_url: str | None
    problems: frozenset[str]


@dataclass(frozen=True)
class Readiness:
    """Answer of a daemon to whether the next stone will be measured; `answers` is False if there was none."""

    answers: bool
    ready: bool
    detail: str


def read_configuration(host: Host, release: Release) -> Configuration:
    """Return the configuration of the host as a release reads it; raise `InstallError` if it prints no JSON."""
    document = _checked(host, release)
    settings = document["settings"]
    if settings is None:
        return Configuration(None, None, frozenset(document["problems"]))
    return Configuration(
        Path(CONFIGURATION).parent / settings["store"]["dir"],
        f"{document['url']}/api/v1/health",
        frozenset(document["problems"]),
    )


def read_settings(host: Host, release: Release) -> dict[str, Any] | None:
    """Return all settings of the host as a release reads them, defaults included; None if it cannot read them."""
    settings: dict[str, Any] | None = _checked(host, release)["settings"]
    return settings


def _checked(host: Host, release: Release) -> dict[str, Any]:
    done = stonefall(host, release, "check-config", CONFIGURATION, "--json")
    try:
        document: dict[str, Any] = json.loads(done.stdout)
    except ValueError as err:
        raise InstallError(f"check-config of {release.version}: {done.stderr.strip() or err}") from err
    return document


def stonefall(
    host: Host, release: Release, *arguments: object, is_idle: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run the command `stonefall` of a release as the user of the service; `is_idle`: when nothing else computes."""
    idle = ("nice", "-n", "19") if is_idle else ()
    return host.ask(*idle, f"{FOLDER}/{release.version}/bin/stonefall", *arguments, user=USER)


def is_running(host: Host) -> bool:
    """True when systemd runs the daemon."""
    return host.runs_systemd and host.ask("systemctl", "is-active", UNIT).stdout.strip() in {
        "active",
        "activating",
        "reloading",
    }


def look_at_store(host: Host, release: Release, state_dir: Path) -> Stock:
    """Return the databases of the store, seen with the rights of the service; `InstallError` if it cannot be read."""
    if not host.path(str(state_dir)).is_dir():
        return Stock(None, ())
    found = json.loads(_store(host, release, "look", state_dir))
    in_use = Copy(**found["in_use"]) if found["in_use"] else None
    return Stock(in_use, tuple(Copy(**each) for each in found["backups"]))


def write_later_results(host: Host, release: Release, database: str, seq: int, out: Path) -> int:
    """Write all results after number `seq` to a file of the store, and return how many these are."""
    return int(_store(host, release, "later", database, seq, out))


def _store(host: Host, release: Release, *arguments: object) -> str:
    python = ("env", f"PYTHONPATH={FOLDER}/{release.version}/deploy", "/usr/bin/python3", "-B", "-m")
    return host.run(*python, "installer.store", *arguments, user=USER)


def ask_readiness(url: str, timeout_s: float = 5.0) -> Readiness:
    """Ask a daemon whether the next stone will be measured; needs no key."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # no proxy of the plant between
    try:
        try:
            answer = opener.open(f"{url}/ready", timeout=timeout_s)
        except urllib.error.HTTPError as err:
            answer = err
        with answer:
            status, body = answer.status, answer.read()
    except (OSError, ValueError, http.client.HTTPException) as err:
        return Readiness(False, False, f"{url}/ready: {err}")
    return _readiness(status, body) or Readiness(
        False, False, f"{url}/ready: status {status}, not from stonefall"
    )


def _readiness(status: int, body: bytes) -> Readiness | None:
    """Parse an answer of `/ready`; None if no daemon answers so."""
    try:
        document = json.loads(body)
    except ValueError:
        return None
    match document:
        case {"ready": True} if status == 200:
            return Readiness(True, True, "ready")
        case {"type": str(kind), "detail": str(detail)} if (status, kind) == NOT_READY:
            return Readiness(True, False, detail)
    return None


def usual_readiness(url: str, patience_s: float = PATIENCE_S) -> Readiness:
    """Return that a running daemon is ready if it says so at any time within a while, else its last answer."""
    end = time.monotonic() + patience_s
    while not (now := ask_readiness(url)).ready and time.monotonic() < end:
        time.sleep(POLL_S)
    return now


def wait_until_healthy(url: str, before: Readiness, deadline_s: float = READY_S) -> Readiness:
    """Return once the daemon is ready, or answers if it was not ready before either; raise `InstallError` if not."""
    end = time.monotonic() + deadline_s
    while True:
        now = ask_readiness(url)
        if now.ready or (now.answers and not before.ready):
            return now
        if time.monotonic() >= end:
            raise InstallError(f"not ready within {deadline_s:.0f} s after its start: {now.detail}")
        time.sleep(POLL_S)


def start(host: Host) -> None:
    """Start the daemon until the rig is armed, or held with a reason; raise `InstallError` with its log if it fails."""
    host.ask("systemctl", "reset-failed", UNIT)
    done = host.ask("systemctl", "start", UNIT)
    if done.returncode != 0:
        log = host.ask("journalctl", "-u", UNIT, "-n", "3", "-o", "cat").stdout.strip().splitlines()
        raise InstallError(f"the daemon did not start: {' | '.join(log)}")


def require_release(host: Host, release: Release) -> None:
    """Raise `InstallError` when the daemon that systemd has started is not of a release, as after an edited unit."""
    pid = host.run("systemctl", "show", "--property=MainPID", "--value", UNIT).strip()
    try:
        python = host.path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[0].decode()
    except OSError as err:
        raise InstallError(f"the daemon ended after its start: {err}") from err
    if not python.startswith(f"{FOLDER}/{release.version}/"):
        raise InstallError(f"{python} was started, not {release.version}: systemctl cat {UNIT} shows why")


def stop(host: Host) -> None:
    """Stop the daemon, which measures first what the cameras have seen; raise `InstallError` if systemd cannot."""
    host.run("systemctl", "stop", UNIT)


def require_unlocked_store(state_dir: Path) -> None:
    """Raise `InstallError` when a daemon that systemd does not run has the store open."""
    if not state_dir.is_dir():
        return
    descriptor = os.open(state_dir, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as err:
        raise InstallError(
            f"{state_dir}: a daemon that systemd did not start has it open: end it first"
        ) from err
    finally:
        os.close(descriptor)
