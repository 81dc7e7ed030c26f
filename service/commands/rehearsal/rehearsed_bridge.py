"""The bridge of a rehearsal: a process beside the daemon, with all outlets whose packages are there, on free ports."""

import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tomli_w

from service.bridge.opcua.passwords import hash_password
from service.bridge.settings import OUTLETS
from service.commands.rehearsal.rehearsed_daemon import HOST, SERVE, RehearsalError, free_port

START_S, STOP_S, POLL_S = 60.0, 20.0, 0.1
BROKER = "mosquitto"
PACKAGES = {"opcua": "asyncua", "mqtt": "paho", "modbus": None}
"""Outlets that a rehearsal can have, and the package that each needs; lines of a chip are not among them."""
USER = "rehearsal"
"""Who may give orders over OPC UA; the password is the name."""
SCHEMES = {"opcua": "opc.tcp", "mqtt": "mqtt", "modbus": "modbus"}


def rehearsable() -> list[str]:
    """Return the outlets that can be served here."""
    return [
        name
        for name, package in PACKAGES.items()
        if (package is None or find_spec(package))
        and find_spec(OUTLETS[name])
        and (name != "mqtt" or _broker())
    ]


@contextmanager
def rehearsed_bridge(folder: Path, url: str) -> Iterator[Mapping[str, str]]:
    """Run the bridge to the daemon at an address; provide the address of each outlet, or of the broker it publishes to.

    Raises `RehearsalError` when it does not serve them.
    """
    ports = {name: free_port() for name in rehearsable()}
    tables: dict[str, Any] = {name: {"port": port} for name, port in ports.items()}
    if "opcua" in ports:
        tables["opcua"]["users"] = [{"name": USER, "password": hash_password(USER), "orders": True}]
    with ExitStack() as running:
        if "mqtt" in ports:
            tables["mqtt"] |= {"host": HOST, "tls": False, "prefix": "stonefall/rehearsal", "sparkplug": {}}
            (folder / "mosquitto.conf").write_text(f"listener {ports['mqtt']} {HOST}\nallow_anonymous true\n")
            running.enter_context(
                _process([str(_broker()), "-c", str(folder / "mosquitto.conf")], folder / "broker.log")
            )
        settings = {"dir": str(folder / "bridge"), "daemon": {"url": url, "consumer": "bridge"}, **tables}
        (folder / "bridge.toml").write_text(tomli_w.dumps(settings))
        command = [sys.executable, "-c", SERVE, "bridge", "--config", str(folder / "bridge.toml")]
        process = running.enter_context(_process(command, folder / "bridge.log"))
        for port in ports.values():
            _wait_for(port, process, folder / "bridge.log")
        yield {name: f"{SCHEMES[name]}://{HOST}:{port}" for name, port in ports.items()}


def _broker() -> str | None:
    return shutil.which(BROKER) or shutil.which(BROKER, path="/usr/sbin")


@contextmanager
def _process(command: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process until the end of the block; in a session of its own, as the daemon's."""
    with log.open("ab") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file, start_new_session=True)  # noqa: S603 - ourselves, a broker
    try:
        yield process
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(STOP_S)
        process.kill()
        process.wait()


def _wait_for(port: int, process: subprocess.Popen[bytes], log: Path) -> None:
    """Return when something listens at a port; raise `RehearsalError` if the bridge ends, or it takes too long."""
    deadline_s = time.monotonic() + START_S
    while True:
        with suppress(OSError), socket.create_connection((HOST, port), 1.0):
            return
        if process.poll() is not None or time.monotonic() > deadline_s:
            last = log.read_text(errors="replace").splitlines()[-1:]
            raise RehearsalError(f"the bridge does not serve port {port}: {' '.join(last)}")
        time.sleep(POLL_S)
