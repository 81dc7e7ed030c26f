"""`stonefall simulate` as a process of its own: sixteen cameras, a gate, and a belt that waits for `start`."""

import json
import socket
import subprocess
from contextlib import closing
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from support.daemon_process import STONEFALL
from support.live_rig import own_address

ENDING_S = 20.0


class SimulatorProcess:
    """Started on entering the context, ended with it."""

    def __init__(
        self, folder: Path, recording: Path, *, rate_hz: float = 4.0, address: str | None = None
    ) -> None:
        """`folder` gets the gate's port and the control socket."""
        self._folder = folder
        self._recording = recording
        self._command = [
            STONEFALL, "simulate", recording, "--json", "--loop", "--start", "manual", "--rate", str(rate_hz),
            "--address", address or own_address(30), "--gate-link", folder / "gate", "--control", folder / "control",
        ]  # fmt: skip

    def __enter__(self) -> Self:
        self.process = subprocess.Popen(self._command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self._rig = json.loads(self.process.stdout.readline())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.terminate()
        try:
            self.process.communicate(timeout=ENDING_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()

    @property
    def cameras(self) -> list[dict[str, str]]:
        """Id, serial number and address of each camera."""
        return list(self._rig["cameras"])

    @property
    def section(self) -> str:
        """`[rig]` of a daemon's configuration."""
        cameras = "\n".join(
            f'[[rig.cameras]]\nid = "{each["id"]}"\nserial = "{each["serial"]}"\naddress = "{each["address"]}"'
            for each in self.cameras
        )
        return f"""[rig]
backend = "aravis"
is_simulated = true
calibration = "{self._recording}/rig.json"
interfaces = ["127.0.0.1"]
[rig.gate.serial]
port = "{self._folder}/gate"
{cameras}
[empty_rig]
at_start = 2
every_s = 0
"""

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the answer of the control socket to a request."""
        with closing(socket.socket(socket.AF_UNIX)) as line:
            line.connect(str(self._folder / "control"))
            line.sendall(json.dumps(request).encode() + b"\n")
            answer = dict(json.loads(line.makefile().readline()))
        assert answer["ok"], answer
        return answer
