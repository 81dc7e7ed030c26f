"""Releases on a host: each in a folder of its own, one of them the current one, three kept."""

import json
import os
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from installer.host import Host, InstallError, write_whole

FOLDER, CURRENT = "/opt/stonefall/releases", "/opt/stonefall/current"
COMPLETE = "release.json"
"""Written last: a folder without it was left by an installation that was interrupted."""
KEEP = 3


@dataclass(frozen=True)
class Release:
    """A release: what `bundle.json` and `release.json` say of it."""

    version: str
    commit: str
    debian: str
    architecture: str
    schema: int  # newest schema of the store that it knows
    needs_mb: int

    def folder(self, host: Host) -> Path:
        """Return where it lies on the host."""
        return host.path(FOLDER) / self.version


def read_release(path: Path) -> Release:
    """Return the release that a JSON file describes; raise `InstallError` naming what is wrong with it."""
    try:
        release = Release(**json.loads(path.read_text()))
        version_key(release.version)
    except (OSError, ValueError, TypeError) as err:
        raise InstallError(f"{path}: {err}") from err
    return release


def mark_complete(release: Release, folder: Path) -> None:
    """Mark the folder of a release as complete."""
    write_whole(folder / COMPLETE, json.dumps(asdict(release), indent=2).encode())


def installed(host: Host) -> list[Release]:
    """Return all whole releases of the host, the oldest version first."""
    found = [read_release(path) for path in host.path(FOLDER).glob(f"*/{COMPLETE}")]
    return sorted(found, key=lambda release: version_key(release.version))


def current(host: Host) -> Release | None:
    """Return the release that the link `current` leads to; None if there is none, or one installed by hand."""
    link = read_link(host)
    folder = host.path(CURRENT).parent / link if link else None
    return next((release for release in installed(host) if release.folder(host) == folder), None)


def read_link(host: Host) -> Path | None:
    """Return where the link `current` leads; None if there is no such link."""
    link = host.path(CURRENT)
    return link.readlink() if link.is_symlink() else None


def make_current(host: Host, release: Release) -> None:
    """Let the link `current` lead to a release, at one moment."""
    set_link(host, Path("releases", release.version))


def set_link(host: Host, destination: Path | None) -> None:
    """Let the link `current` lead to a folder, at one moment; None removes it."""
    link = host.path(CURRENT)
    if destination is None:
        link.unlink(missing_ok=True)
        return
    unfinished = link.with_name(".current")
    unfinished.unlink(missing_ok=True)
    unfinished.symlink_to(destination)
    unfinished.replace(link)
    folder = os.open(link.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def version_key(version: str) -> tuple[tuple[int, ...], bool, str, int]:
    """Return a key that sorts versions: 0.9.1 before 0.10.0rc1 before 0.10.0; raise `ValueError` for other words."""
    match = re.fullmatch(r"(\d+(?:\.\d+)*)(?:(a|b|rc)(\d+))?", version)
    if match is None:
        raise ValueError(f"version {version!r} is not like 0.3.0 or 0.3.0rc1")
    numbers, stage, count = match.groups()
    parts = [int(number) for number in numbers.split(".")]
    while parts and parts[-1] == 0:  # 0.3 is 0.3.0
        parts.pop()
    return tuple(parts), stage is None, stage or "", int(count or 0)


def expendable(releases: Iterable[Release], needed: Iterable[Release | None]) -> list[Release]:
    """Return the releases to remove: all but the needed ones, and the newest others up to `KEEP` in all."""
    needed = [release for release in needed if release is not None]
    others = sorted(
        (release for release in releases if release not in needed),
        key=lambda release: version_key(release.version),
        reverse=True,
    )
    return others[max(KEEP - len(set(needed)), 0) :]
