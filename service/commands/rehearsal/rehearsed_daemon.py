"""The daemon of a rehearsal: a process that the script configures, kills, stops and starts."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any, Self

import tomli_w

from service.base.errors import ServiceError
from service.commands.daemon_client import Body, DaemonClient, DaemonError

HOST = "127.0.0.1"
PATIENCE_S = 300.0
"""Longest wait for anything; the first start on a machine compiles for a minute or two."""
STOP_S = ANSWER_S = 60.0
POLL_S = 0.1
SERVE = "from service.commands.cli import main; main()"
BY_OWN_CLOCK = (
    "import sys; from pathlib import Path; from service.commands.rehearsal.rehearsed_daemon import follow_file;"
    " follow_file(Path(sys.argv.pop(1)));"
)


hosts_time_s = time.time


class RehearsalError(ServiceError):
    """The daemon of a rehearsal does not do what the script expects."""


class RehearsedDaemon:
    """A daemon in a folder; not running until it is started."""

    def __init__(self, folder: Path, settings: Mapping[str, Any], port: int, *, has_own_clock: bool) -> None:
        self.folder = folder
        self.settings = dict(settings)  # of the next start, as TOML has them
        self.port = port
        self.state_dir = folder / "state"
        self.clock = folder / "clock"  # its wall clock follows the file, see `set_ahead`
        self._config, self._log = folder / "stonefall.toml", folder / "daemon.log"
        self._has_own_clock = has_own_clock
        self._process: subprocess.Popen[bytes] | None = None
        self._asked_port = port
        set_ahead(self.clock, 0)

    def start(self, *, is_reachable: bool = True) -> None:
        """Start it and return when it answers: at the port of the rehearsal, or where no client looks for it."""
        self._asked_port = self.port if is_reachable else free_port()
        api = {**self.settings.get("api", {}), "host": HOST, "port": self._asked_port}
        self._config.write_text(tomli_w.dumps({**self.settings, "api": api}))
        command = [sys.executable, "-c", SERVE, "serve", "--config", str(self._config)]
        if self._has_own_clock:
            command[2:3] = [BY_OWN_CLOCK + SERVE, str(self.clock)]
        with self._log.open("ab") as log:
            # in a session of its own: Ctrl-C reaches only the rehearsal, which stops it
            self._process = subprocess.Popen(command, stderr=log, start_new_session=True)  # noqa: S603 - ourselves
        self.wait_for("/health/live", lambda _: True)

    def stop(self) -> None:
        """Stop it in an orderly way, if it runs."""
        if self._process is not None:
            self._process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(STOP_S)
            self.kill()

    def kill(self) -> None:
        """End it at once."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def ask(self, path: str, body: Body = None, method: str | None = None) -> dict[str, Any]:
        """Return the answer to a request, as `DaemonClient.ask` does."""
        client = DaemonClient(f"http://{HOST}:{self._asked_port}")
        return client.ask(path, body, method=method, timeout_s=ANSWER_S)

    def find(self, path: str) -> dict[str, Any] | None:
        """Return the document at a path, None while there is no answer or nothing there."""
        try:
            return self.ask(path)
        except DaemonError:
            return None

    def wait_for(self, path: str, is_enough: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Poll until `is_enough(answer)`; raise `RehearsalError` if the daemon has ended, or it takes too long."""
        deadline_s = time.monotonic() + PATIENCE_S
        while (found := self.find(path)) is None or not is_enough(found):
            if self._process is None or self._process.poll() is not None:
                last = self._log.read_text(errors="replace").splitlines()[-1:]
                raise RehearsalError(f"the daemon ended: {' '.join(last)}")
            if time.monotonic() > deadline_s:
                raise RehearsalError(f"{path} is not as expected within {PATIENCE_S:.0f} s: {found}")
            time.sleep(POLL_S)
        return found


def free_port() -> int:
    """Return a free TCP port."""
    with socket.create_server((HOST, 0)) as found:
        return int(found.getsockname()[1])


def is_free(port: int) -> bool:
    """True when a server can listen at the port."""
    try:
        socket.create_server((HOST, port)).close()
    except OSError:
        return False
    return True


def set_ahead(path: Path, seconds: float) -> None:
    """Set the clock that follows a file, in one step."""
    unfinished = path.with_suffix(".new")
    unfinished.write_text(str(seconds))
    unfinished.rename(path)


def follow_file(path: Path) -> None:
    """Set the clock of stonefall in this process ahead by the seconds in the file."""

    def time_s() -> float:
        return hosts_time_s() + float(path.read_text())

    class Datetime(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return cls.fromtimestamp(time_s(), tz)

    import service.daemon.run  # noqa: F401 - whose clocks are replaced

    time.time = time_s
    for name, module in list(sys.modules.items()):
        is_ours = name.startswith(("service.", "drivers.")) and name != __name__
        if is_ours and getattr(module, "datetime", None) is datetime:
            module.datetime = Datetime  # type: ignore[attr-defined]  # a module, which has it by the line above
