"""The real daemon as a process of its own, with a notify socket in systemd's place."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from http.client import HTTPConnection
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

from support.eventually import PATIENCE_S, eventually
from support.warm_stonefall import HELD, WarmStonefall

from service.processing.worker_pool import WORKER_NAME

STONEFALL = Path(sys.executable).with_name("stonefall")
"""The program as it is installed."""

CONFIG = """
{rig}
[spool]
dir = "{spool}"
max_bundles = {max_bundles}
[store]
dir = "state"
retention.min_free_gb = 0.0
{store}
[segmentation]
{segmentation}
[recordings]
reserve_gb = 0.1
[carving]
n = {voxels}
[body]
kind = "{body}"
[workers]
slots = {slots}
[api]
port = {port}
"""


def free_port() -> int:
    """Return a port that nobody listens on."""
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        return int(listener.getsockname()[1])


class DaemonProcess:
    """Started on entering the context, killed at its end if it still runs."""

    def __init__(
        self,
        folder: Path,
        recording: Path,
        *,
        rig: str = 'pace = "fast"',
        store: str = "",
        segmentation: str = "",
        spool: str = "spool",
        voxels: int = 64,
        body: str = "estimate",
        slots: int = 1,
        port: int = 0,
        max_bundles: int = 100,
        command: Sequence[str | Path] = (),
    ) -> None:
        """`rig`: what follows `recording` in the section of that name, or all of it with its name.

        `command`: the program and what is before it; without it the daemon is forked where it has been imported. What
        measures a start, memory or speed gives `(STONEFALL,)`, and as many `slots` as its figure is of.
        """
        self._command = command
        if not rig.startswith("[rig]"):
            rig = f'[rig]\nrecording = "{recording}"\n{rig}'
        self.folder = folder
        self.log_path = folder / "daemon.log"
        self.config_path = folder / "stonefall.toml"
        self.config_path.write_text(
            CONFIG.format(
                rig=rig,
                store=store,
                segmentation=segmentation,
                spool=spool,
                voxels=voxels,
                body=body,
                slots=slots,
                port=port,
                max_bundles=max_bundles,
            )
        )
        self.heard: list[str] = []

    def __enter__(self) -> Self:
        self._n_earlier = len(self._addresses())  # of daemons before this one, in the same log
        address = self.folder / "notify"
        address.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._listener.bind(str(address))
        # read at once: the kernel keeps ten, and a watchdog that is fed fills them in seconds
        self._listening = threading.Thread(target=self._listen, name="notify socket")
        self._listening.start()
        environment = os.environ | {"NOTIFY_SOCKET": str(address), "WATCHDOG_USEC": "600000"}
        arguments = ("serve", "--config", self.config_path)
        self.process: subprocess.Popen[bytes] | WarmStonefall
        if self._command:
            with self.log_path.open("ab") as log:
                self.process = subprocess.Popen([*self._command, *arguments], stderr=log, env=environment)
        else:
            self.process = WarmStonefall(
                arguments, out=self.folder / "daemon.out", log=self.log_path, environment=environment
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        workers = self.worker_pids()
        self.process.kill()
        self.process.wait()
        for pid in workers:  # a stopped one would not notice the daemon's end
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._listener.shutdown(socket.SHUT_RD)
        self._listening.join()
        self._listener.close()
        assert error or HELD not in self.log, self.log

    def _listen(self) -> None:
        while assignments := self._listener.recv(4096):
            self.heard += assignments.decode().splitlines()

    def hear(self, assignment: str, timeout_s: float = PATIENCE_S) -> None:
        """Return once the daemon has notified `assignment`."""
        deadline, ended = time.monotonic() + timeout_s, None
        while not any(line.startswith(assignment) for line in self.heard):
            assert ended is None, f"no {assignment}, it ended with {ended}; the daemon's log:\n{self.log}"
            assert time.monotonic() < deadline, f"no {assignment}; the daemon's log:\n{self.log}"
            ended = self.process.poll()  # what it said last may be on its way
            time.sleep(0.005)

    @property
    def log(self) -> str:
        return self.log_path.read_text()

    def get(self, path: str) -> dict[str, Any]:
        return self._ask(path)

    def put(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        return self._ask(path, method="PUT", body=json.dumps(body))

    def post(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        return self._ask(path, method="POST", body=json.dumps(body))

    def url(self, path: str) -> str:
        """Return the address of a path, once the log has where this daemon serves: a thread writes it."""
        eventually(lambda: len(self._addresses()) > self._n_earlier or self.process.poll() is not None)
        return f"{self._addresses()[-1]}/api/v1{path}"

    def hear_line(self, text: str) -> None:
        """Return once the log has a text."""
        eventually(lambda: text in self.log)

    def _addresses(self) -> list[str]:
        return re.findall(r"serving url=(\S+)", self.log) if self.log_path.exists() else []

    def _ask(self, path: str, method: str = "GET", body: str | None = None) -> dict[str, Any]:
        """Return the answer, a refusal as well."""
        url = urlsplit(self.url(path))
        connection = HTTPConnection(url.netloc, timeout=PATIENCE_S)
        with closing(connection):
            headers = {"Content-Type": "application/json"} if body else {}
            connection.request(method, f"{url.path}?{url.query}", body, headers)
            return dict(json.load(connection.getresponse()))

    def wait_for(
        self, path: str, condition: Callable[[dict[str, Any]], bool], timeout_s: float = PATIENCE_S
    ) -> dict[str, Any]:
        deadline = time.monotonic() + timeout_s
        while not condition(document := self.get(path)):
            assert time.monotonic() < deadline, f"{path}: {document}\n{self.log}"
            time.sleep(0.02)
        return document

    def check(self, name: str, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return a check of the health once it is so: it is looked at once a second."""
        health = self.wait_for("/health", lambda now: is_so(now["checks"][name]))
        return dict(health["checks"][name])

    def results(self) -> list[dict[str, Any]]:
        return list(self.get("/results?after=0&limit=1000")["items"])

    def worker_pids(self) -> list[int]:
        """Processes of the pool that measures."""
        return [pid for pid in descendants_of(self.process.pid) if process_name(pid) == WORKER_NAME]

    def camera_pid(self) -> int:
        """The process that the cameras' library runs in."""
        (pid,) = (pid for pid in descendants_of(self.process.pid) if process_name(pid) == "stonefall-cams")
        return pid

    def signal_workers(self, number: signal.Signals) -> None:
        for pid in self.worker_pids():
            with suppress(ProcessLookupError):  # its time may have come meanwhile
                os.kill(pid, number)

    def stop(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send the signal and return the exit code."""
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


def descendants_of(pid: int) -> list[int]:
    """Child processes and theirs, none if the process is gone."""
    children: list[int] = []
    for thread in Path(f"/proc/{pid}/task").glob("*/children"):  # each has the children that it started
        with suppress(FileNotFoundError, ProcessLookupError):  # it may end meanwhile
            children += map(int, thread.read_text().split())
    return children + [theirs for child in children for theirs in descendants_of(child)]


def process_name(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def is_running(pid: int) -> bool:
    """Whether it runs; a zombie nobody has reaped yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
