"""Put a release on a host, beside the others: its environment, its guides, its compiled loops, its self-test."""

import os
import shutil
import tempfile
from functools import partial
from pathlib import Path

from installer import placement, releases, selftest, service
from installer.host import COMPILED, USER, Host, InstallError
from installer.releases import Release

PARTS = ("README.md", "deploy", "systemd", "selftest", "share", "service", "drivers", "pipeline", "tests")
"""What goes into a release beside its environment: guides, the installer, what is placed in /etc, the self-test."""
PACKAGE = Path("/usr/lib/stonefall")
"""Folder of the Debian package with its bundle: apt alone changes it, as a whole."""


def build(host: Host, bundle: Path, release: Release) -> bool:
    """Install a release from a bundle, up to its self-test, beside the current one; return if it was not there.

    Raises
    ------
    InstallError
        The version is there from another commit, or a step failed: what there was of the release is removed.
    """
    folder = release.folder(host)
    present = next((each for each in releases.installed(host) if each.version == release.version), None)
    if present is not None and present.debian != release.debian:  # the host was upgraded: another Python
        present = None
    if present is not None and present.commit != release.commit:
        raise InstallError(
            f"release {release.version} is installed from commit {present.commit[:7]}, this is {release.commit[:7]}:"
            " a release never changes; the new one needs a version of its own in pyproject.toml"
        )
    is_done = present is not None
    steps = (
        (f"{folder}: environment", partial(copy_environment, bundle, folder)),
        (f"{folder}: guides, installer, self-test", partial(copy_parts, bundle, folder)),
        ("account and folders of the service", partial(make_accounts, host, release)),
        ("compile loops for this processor", partial(compile_loops, host, release)),
        ("self-test", partial(run_selftest, host, release)),
    )
    try:
        for title, change in steps:
            host.step(title, change, is_done=is_done)
    except BaseException:
        if not is_done and not host.dry_run:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if not is_done and not host.dry_run:
        os.sync()  # all of it is on the disk before it counts
        releases.mark_complete(release, folder)
    return not is_done


def copy_environment(bundle: Path, folder: Path) -> None:
    """Copy the environment of a bundle to the folder that it was made for; link the files of the package."""
    if folder.exists():  # an earlier installation was interrupted, or it is of another Debian
        shutil.rmtree(folder)
    copy = _link if bundle == PACKAGE else shutil.copy2
    shutil.copytree(bundle / "environment", folder, symlinks=True, copy_function=copy)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # /usr and /opt are different file systems
        shutil.copy2(source, target)


def copy_parts(bundle: Path, folder: Path) -> None:
    """Copy what a release has beside its environment."""
    for part in PARTS:
        if (bundle / part).is_dir():
            shutil.copytree(bundle / part, folder / part, dirs_exist_ok=True)  # libraries bring a share/, too
        else:
            shutil.copy(bundle / part, folder)


def make_accounts(host: Host, release: Release) -> None:
    """Make the account of the service and its folders; done again, it changes nothing."""
    placement.place(host, release, {".sysusers", ".tmpfiles", ".toml"})
    host.run("systemd-sysusers", placement.BY_SUFFIX[".sysusers"])
    host.run("systemd-tmpfiles", "--create", placement.BY_SUFFIX[".tmpfiles"])


def compile_loops(host: Host, release: Release) -> None:
    """Compile for the processor of this host; what was compiled on another one does not run here."""
    config = f"{releases.FOLDER}/{release.version}/deploy/stonefall.toml"
    done = service.stonefall(host, release, "compile", "--config", config)
    if done.returncode != 0:
        raise InstallError(f"stonefall compile: {done.stderr.strip()}")
    if not any(host.path(COMPILED).rglob("*.nbc")):
        raise InstallError(f"stonefall compile left nothing in {COMPILED}: every start would compile again")


def run_selftest(host: Host, release: Release) -> None:
    """Measure the bundle's recording as the user of the service; raise `InstallError` if a figure is not as known."""
    bundled = release.folder(host) / "selftest"
    out = Path(tempfile.mkdtemp(prefix="stonefall-selftest-"))
    try:
        shutil.chown(out, USER)
        done = service.stonefall(
            host, release, "measure", bundled / "recording", "--out", out / "results", "--json"
        )
        if done.returncode != 0:
            raise InstallError(f"self-test: {done.stderr.strip()}")
        results = selftest.read_lines(out / "results" / selftest.RESULTS)
        if found := selftest.deviations(selftest.read_expectations(bundled), results):
            raise InstallError(f"self-test: {'; '.join(found)}")
    finally:
        shutil.rmtree(out)
