"""The host that is installed: its paths, commands run on it, and a line for each step."""

import os
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

USER, BRIDGE_USER = "stonefall", "stonefall-bridge"
COMPILED = "/var/cache/stonefall/numba"
PROCESSOR = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
"""Environment variables of numba that set the target processor of compiled loops; unset, it is that of this machine."""


class InstallError(Exception):
    """A step that cannot be done, in words for the engineer at the machine."""


def execute(command: Sequence[str], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command with exactly this environment, and return what it printed and its exit status."""
    return subprocess.run(command, env=environment, capture_output=True, text=True, cwd="/")  # noqa: S603 - no shell


@dataclass(frozen=True)
class Host:
    """Where files go, whether anything may be changed, and how commands are run."""

    root: Path = Path("/")
    dry_run: bool = False
    execute: Callable[[Sequence[str], Mapping[str, str]], subprocess.CompletedProcess[str]] = execute

    def path(self, absolute: str) -> Path:
        """Return where an absolute path of the host lies."""
        return self.root / absolute.lstrip("/")

    @property
    def runs_systemd(self) -> bool:
        """True when systemd runs the host; False in a chroot and in most containers."""
        return self.path("/run/systemd/system").is_dir()

    @property
    def is_root(self) -> bool:
        """True when this process may read configuration and database of the host."""
        return os.geteuid() == 0

    def ask(self, *command: object, user: str | None = None) -> subprocess.CompletedProcess[str]:
        """Run a command that may fail, as root or as a user."""
        as_user = ["runuser", "-u", user, "--"] if user else []
        # the variables of the unit: the same compiled loops are found
        environment = {
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "LANG": "C.UTF-8",
            "NUMBA_CACHE_DIR": COMPILED,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            **{name: os.environ[name] for name in PROCESSOR if name in os.environ},
        }
        return self.execute([*as_user, *map(str, command)], environment)

    def run(self, *command: object, user: str | None = None) -> str:
        """Run a command and return what it printed; raise `InstallError` with its last words if it fails."""
        done = self.ask(*command, user=user)
        if done.returncode != 0:
            words = (done.stderr or done.stdout).strip().splitlines()[-5:]
            raise InstallError(f"{' '.join(map(str, command))}: exit {done.returncode}: {' | '.join(words)}")
        return done.stdout

    def step(self, title: str, change: Callable[[], object], *, is_done: bool = False) -> bool:
        """Do a step and print a line about it; return whether anything was, or would be, changed."""
        if is_done:
            say("unchanged", title)
        elif self.dry_run:
            say("would", title)
        else:
            start = time.monotonic()
            change()
            say("done", f"{title} ({time.monotonic() - start:.0f} s)")
        return not is_done


def say(word: str, text: str) -> None:
    """Print a line of the installation's log, if the terminal is still there: the work goes on without."""
    with suppress(OSError):
        print(f"  {word:<10}{text}", flush=True)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that all may read, as a whole or not at all; make its folder if there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.unfinished")
    unfinished.write_bytes(content)
    unfinished.chmod(0o644)
    unfinished.replace(path)
