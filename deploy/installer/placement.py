"""Files of a release that belong into /etc: units, accounts, folders, and what prepares the host.

A file is put in its place if none is there, and replaced while it is as a release brought it. One that was edited on
the host stays, and the new one lies beside it with the suffix `.default`, which no program reads.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from pathlib import Path

from installer import releases
from installer.host import Host, InstallError, write_whole
from installer.releases import Release

UNITS = {".service", ".socket", ".timer", ".path", ".target", ".mount", ".slice"}
BY_SUFFIX = {".sysusers": "/etc/sysusers.d/stonefall.conf", ".tmpfiles": "/etc/tmpfiles.d/stonefall.conf"}
GOES_TO = re.compile(r"# Goes to (/[^\s:;,]+)")
EXAMPLES = {".network", ".link"}
"""They name ports of another machine; in their place they could readdress one of this machine."""
CONFIGURATION = "/etc/stonefall/stonefall.toml"
LINKS = {
    "/usr/local/bin/stonefall": "bin/stonefall",
    "/usr/local/share/man/man1/stonefall.1.gz": "share/man/man1/stonefall.1.gz",
    "/usr/local/share/bash-completion/completions/stonefall": "share/bash-completion/completions/stonefall",
}
"""The command, its manual page and its completion, in the current release; the Debian package has its own in /usr."""
PACKAGED = "/usr/bin/stonefall"
DEFAULT = ".default"


class Owner(Enum):
    """Owner of a file's contents."""

    RELEASE = auto()
    SITE = auto()
    EXAMPLE = auto()


@dataclass(frozen=True)
class Placement:
    """A file of a release, by its path in the release, and where it goes."""

    source: str
    target: str
    owner: Owner = Owner.RELEASE


def placements(folder: Path) -> Iterator[Placement]:
    """Yield all files of a release that belong into /etc; a file says in its first line where, if its name does not."""
    for path in sorted([*folder.glob("systemd/*"), *folder.glob("deploy/host/*")]):
        source, owner = str(path.relative_to(folder)), Owner.RELEASE
        if path.suffix in UNITS:
            target = f"/etc/systemd/system/{path.name}"
        elif path.suffix in BY_SUFFIX:
            target = BY_SUFFIX[path.suffix]
        elif match := GOES_TO.match(path.read_text()):
            target = match[1] + (path.name if match[1].endswith("/") else "")
            owner = Owner.EXAMPLE if path.suffix in EXAMPLES else Owner.RELEASE
        else:
            raise InstallError(f"{source}: its first line does not say '# Goes to /PATH'")
        yield Placement(source, target, owner)
    yield Placement("deploy/stonefall.toml", CONFIGURATION, Owner.SITE)


def place(host: Host, release: Release, suffixes: set[str] | None = None) -> list[str]:
    """Put all files of a release, or those with some suffixes, in their places; return which targets changed."""
    folder = release.folder(host)
    folders = list(host.path(releases.FOLDER).glob("*"))  # that of an interrupted installation, too
    changed = []
    for each in placements(folder):
        if suffixes is not None and Path(each.source).suffix not in suffixes:
            continue
        wanted = (folder / each.source).read_bytes()
        target = host.path(each.target)
        found = target.read_bytes() if target.exists() else None
        if found == wanted:
            continue
        brought = [other / each.source for other in folders] if each.owner is Owner.RELEASE else []
        is_unedited = found is None or any(path.is_file() and path.read_bytes() == found for path in brought)
        goes_to = each.target if is_unedited and each.owner is not Owner.EXAMPLE else each.target + DEFAULT
        path = host.path(goes_to)
        if not (path.exists() and path.read_bytes() == wanted):
            host.step(_title(each, goes_to, found is not None), partial(write_whole, path, wanted))
            changed.append(goes_to)
    return changed


def link_command(host: Host) -> bool:
    """Put the command on the PATH, unless the package has, or something else is there; return whether that changed."""
    changed = False
    for link, inside in LINKS.items():
        path, destination = host.path(link), Path(releases.CURRENT, inside)
        if host.path(PACKAGED).is_symlink() or path.exists() or path.is_symlink():
            continue
        changed |= host.step(f"{link} -> {destination}", partial(_link, path, destination))
    return changed


def _link(path: Path, destination: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(destination)


def links(host: Host) -> Iterator[str]:
    """Yield the links of `LINKS` that lead to the current release."""
    for link, inside in LINKS.items():
        if host.path(link).is_symlink() and host.path(link).readlink() == Path(releases.CURRENT, inside):
            yield link


def placed(host: Host, every: list[Release]) -> Iterator[tuple[str, bool]]:
    """Yield each placed file that exists, and whether it was edited on the host."""
    brought: dict[str, set[bytes]] = {}
    for release in every:
        folder = release.folder(host)
        for each in placements(folder):
            if each.owner is not Owner.SITE:
                for target in (each.target, each.target + DEFAULT):
                    brought.setdefault(target, set()).add((folder / each.source).read_bytes())
    for target, contents in sorted(brought.items()):
        if (path := host.path(target)).is_file():
            yield target, path.read_bytes() not in contents


def _title(each: Placement, goes_to: str, exists: bool) -> str:
    if goes_to == each.target:
        return goes_to
    return (
        f"{goes_to}; {Path(each.target).name} stays as it is here"
        if exists
        else f"{goes_to}, an example to edit"
    )
