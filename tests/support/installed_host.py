"""A host of the installer in a folder: a few files of two releases, and a script that answers its commands."""

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from installer import releases
from installer.host import Host
from installer.releases import Release
from installer.store import Copy

OLD = Release("0.3.0", "c0ffee", "12", "amd64", schema=11, needs_mb=1)
NEW = replace(OLD, version="0.10.0", commit="decade", schema=12)
UNIT = "/etc/systemd/system/stonefall.service"


def put(host: Host, release: Release, unit: str = "[Unit]\n") -> None:
    """Put a release of a few files on a host."""
    folder = release.folder(host)
    for name, text in {
        "systemd/stonefall.service": unit,
        "systemd/stonefall.sysusers": "u stonefall -\n",
        "deploy/host/90-x.conf": "# Goes to /etc/sysctl.d/: buffers\n",
        "deploy/host/50-x.network": "# Goes to /etc/systemd/network/; Name= are the ports\n",
        "deploy/stonefall.toml": f"# of {release.version}\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    releases.mark_complete(release, folder)


class Script:
    """A host's commands: answers them, and remembers what was run."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.ran: list[str] = []
        self.schema = 11
        self.backups: list[Copy] = []
        self.problems: dict[str, list[str]] = {}
        self.unreadable: set[str] = set()
        self.starts: Release | None = None  # whatever release is the current one
        self.damaged: set[str] = set()  # releases that restore no backup

    @property
    def last_seq(self) -> int:
        return 5 if self.schema == 12 else 3

    def __call__(self, command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        words = [Path(word).name if "/bin/" in word else word for word in command]
        line = " ".join(words).removeprefix("runuser -u stonefall -- ")
        release = next((part for part in command if "releases/" in part), "").removeprefix(
            releases.FOLDER + "/"
        )
        answer, code = "", 0
        if "is-active" in line:
            answer = "active\n"
        elif "check-config" in line:
            settings = (
                None if release.split("/")[0] in self.unreadable else {"store": {"dir": "/var/lib/stonefall"}}
            )
            problems = self.problems.get(release.split("/")[0], [])
            answer = json.dumps({"url": "http://127.0.0.1:8080", "settings": settings, "problems": problems})
        elif "installer.store look" in line:
            in_use = vars(Copy("results.sqlite", self.schema, self.last_seq, 0.0))
            answer = json.dumps({"in_use": in_use, "backups": [vars(each) for each in self.backups]})
        elif "installer.store later" in line:
            answer = "2\n"
        elif " backup " in line:
            name = next(word for word in command if word.endswith(".sqlite"))
            self.backups.append(Copy(name, self.schema, self.last_seq, 0.0))
            self.host.path(name).parent.mkdir(exist_ok=True)
            self.host.path(name).touch()
        elif " restore " in line:
            backup = next(each for each in self.backups if each.path in command)
            code = int(not self.host.path(backup.path).exists() or release.split("/")[0] in self.damaged)
            self.schema = self.schema if code else backup.schema
        elif "systemctl start" in line:
            started = self.starts or releases.current(self.host)
            if started == NEW:
                self.schema = 12  # the daemon migrates
            command_line = self.host.path("/proc/7/cmdline")
            command_line.parent.mkdir(parents=True, exist_ok=True)
            python = f"{releases.FOLDER}/{started.version}/bin/python" if started else "/usr/bin/python3"
            command_line.write_text(f"{python}\0serve\0")
        elif "MainPID" in line:
            answer = "7\n"
        elif "systemctl disable" in line and not self.host.path(UNIT).exists():
            code = 1
        if not any(word in line for word in ("check-config", "is-active", "look", "reset-failed", "MainPID")):
            self.ran.append(f"{release.split('/')[0]}: {line}")
        return subprocess.CompletedProcess(command, code, answer, "")
