"""A Debian root of its own in a folder, run by systemd-nspawn: as in a chroot, or booted."""

import json
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from support.eventually import eventually

ROOT = Path(__file__).parents[2]
ASK = "import sys, urllib.request; print(urllib.request.urlopen(sys.argv[1]).read().decode())"
ENVIRONMENT = (
    "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
    "LANG=C.UTF-8",
    "HOME=/root",
)
MOUNTED = """
set -e
mount -t proc proc "$1/proc"
mount -t tmpfs tmpfs "$1/dev/shm"
[ -z "$2" ] || "$2" link set lo up
root=$1
shift 2
exec chroot "$root" "$@"
"""
"""Run in namespaces of its own: mounts, and the loopback of a network without any other device, are gone after it."""
NSPAWN = ("systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network")


@contextmanager
def timed(title: str) -> Iterator[None]:
    """Print a title, and how long its block took."""
    print(f"\n=== {title}", flush=True)
    start = time.monotonic()
    yield
    print(f"=== {title}: {(time.monotonic() - start) / 60:.1f} minutes", flush=True)


class Machine:
    """A root folder and how commands are run in it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.leader: int | None = None

    def command(self, *words: str) -> list[str]:
        if self.leader is not None:
            return ["nsenter", "--target", str(self.leader), "--all", *words]
        return [*NSPAWN, "--pipe", "--directory", str(self.root), *words]

    def run(self, *words: str, expect: int = 0) -> str:
        """Run a command, show what it prints, and require its exit status."""
        print(f"$ {' '.join(words)}", flush=True)
        done = subprocess.run(self.command(*words), capture_output=True, text=True)
        said = done.stdout + done.stderr
        print(said, flush=True)
        assert done.returncode == expect, f"exit {done.returncode} instead of {expect}"
        return said

    @contextmanager
    def booted(self) -> Iterator[None]:
        """Let systemd run the machine."""
        nspawn = subprocess.Popen(
            [*NSPAWN, "--boot", "--directory", str(self.root)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            eventually(lambda: self._systemd(nspawn.pid) is not None)
            self.leader = self._systemd(nspawn.pid)
            self.run("systemctl", "--no-pager", "list-units", "--failed")
            yield
        finally:
            self.leader = None
            nspawn.terminate()
            nspawn.wait(60)

    def _systemd(self, nspawn: int) -> int | None:
        """Return the process that systemd-nspawn has started, once it takes orders; others come and go before."""
        for child in Path(f"/proc/{nspawn}/task/{nspawn}/children").read_text().split():
            root = Path(f"/proc/{child}/root")
            if (root / "run/systemd/private").exists() and root.samefile(self.root):
                return int(child)
        return None

    def database(self) -> tuple[int, int]:
        """Return schema and number of results of the store, through a copy: a look must leave nothing beside it."""
        copy = self.root.parent / "look"
        shutil.rmtree(copy, ignore_errors=True)
        copy.mkdir()
        for path in (self.root / "var/lib/stonefall").glob("results.sqlite*"):
            shutil.copy(path, copy)
        with closing(sqlite3.connect(copy / "results.sqlite")) as connection:
            (schema,) = connection.execute("PRAGMA user_version").fetchone()
            (count,) = connection.execute("SELECT count(*) FROM results").fetchone()
        return schema, count

    def get(self, path: str) -> dict[str, Any]:
        """Return a document of the daemon."""
        answer = output(*self.command("python3", "-c", ASK, f"http://127.0.0.1:8080/api/v1{path}"))
        return dict(json.loads(answer))

    def unit(self, name: str, unit: str = "stonefall") -> str:
        """Return a property of a unit."""
        return output(*self.command("systemctl", "show", "--value", "--property", name, unit)).strip()

    def current(self) -> str:
        return (self.root / "opt/stonefall/current").readlink().name

    def measures(self) -> None:
        """Wait until results come."""
        before = self.get("/accounting")["measured"]
        eventually(lambda: self.get("/accounting")["measured"] > before + 2)


def output(*command: object) -> str:
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


class Chroot(Machine):
    """A root folder whose commands run in a chroot, without systemd; without network unless `is_online`."""

    def __init__(self, root: Path, *, is_online: bool = False) -> None:
        super().__init__(root)
        self.is_online = is_online

    def command(self, *words: str) -> list[str]:
        loopback = "" if self.is_online else shutil.which("ip") or "ip"
        namespaces = ["--mount", "--pid", "--fork", "--kill-child", *(() if self.is_online else ("--net",))]
        chroot = ["sh", "-c", MOUNTED, "-", str(self.root), loopback, "/usr/bin/env", "-i", *ENVIRONMENT]
        return ["unshare", *namespaces, *chroot, "DEBIAN_FRONTEND=noninteractive", *words]
