"""Put a release on a host, beside the others: its environment, its guides, its compiled loops, its self-test."""

import os
import shutil
import tempfile
from pathlib import Path

from installer import placement, releases, selftest, service
from installer.host import COMPILED, USER, Host, InstallError
from installer.releases import Release

PARTS = ("README.md", "deploy", "systemd", "selftest", "service", "drivers", "pipeline", "tests")
"""What goes into a release beside its environment: guides, the installer, what is placed in /etc, the self-test."""
ACCOUNTS, FOLDERS = ".sysusers", ".tmpfiles"


def build(host: Host, bundle: Path, release: Release) -> bool:
    """Install a release from a bundle, up to its self-test, beside the current one; return if it was not there."""
    folder = release.folder(host)
    present = next((each for each in releases.installed(host) if each.version == release.version), None)
    if present is not None and present.commit != release.commit:
        raise InstallError(
            f"release {release.version} is installed from commit {present.commit[:7]}, this is {release.commit[:7]}:"
            " a release never changes; the new one needs a version of its own in pyproject.toml"
        )
    is_done = present is not None
    if not is_done:
        _require_room(host, release)

    def environment() -> None:
        if folder.exists():  # an earlier installation was interrupted
            shutil.rmtree(folder)
        folder.parent.mkdir(parents=True, exist_ok=True)
        host.run("/usr/bin/python3", "-m", "venv", "--system-site-packages", folder)
        pip = (folder / "bin/python", "-m", "pip", "--isolated", "--quiet", "--disable-pip-version-check")
        offline = (*pip, "install", "--no-index", "--find-links", bundle / "wheels")
        host.run(*offline, "--require-hashes", "--requirement", bundle / "deploy/requirements.lock")
        host.run(*offline, "--no-deps", bundle / f"wheels/stonefall-{release.version}-py3-none-any.whl")

    def guides() -> None:
        for part in PARTS:
            if (bundle / part).is_dir():
                shutil.copytree(bundle / part, folder / part)
            elif (bundle / part).exists():
                shutil.copy(bundle / part, folder)

    host.step(f"{folder}: environment, from the wheels", environment, is_done=is_done)
    host.step(f"{folder}: guides, installer, self-test", guides, is_done=is_done)
    if is_done or host.dry_run:
        _prepare(host, release, is_done=is_done)
    else:
        try:
            _prepare(host, release, is_done=False)
        except BaseException:
            shutil.rmtree(folder)
            raise
        os.sync()  # all of it is on the disk before it counts
        releases.mark_complete(release, folder)
    return not is_done


def _prepare(host: Host, release: Release, *, is_done: bool) -> None:
    if release.folder(host).exists():
        accounts(host, release)
    config = f"{releases.FOLDER}/{release.version}/deploy/stonefall.toml"
    host.step(
        "compile loops for this processor", lambda: compile_loops(host, release, config), is_done=is_done
    )
    host.step("self-test", lambda: run_selftest(host, release), is_done=is_done)


def accounts(host: Host, release: Release) -> None:
    """Make the account of the service and its folders."""
    if placement.place(host, release, {ACCOUNTS}) and not host.dry_run:
        host.run("systemd-sysusers", placement.BY_SUFFIX[ACCOUNTS])
    placement.place(host, release, {".toml"})
    if placement.place(host, release, {FOLDERS}) and not host.dry_run:
        host.run("systemd-tmpfiles", "--create", placement.BY_SUFFIX[FOLDERS])


def compile_loops(host: Host, release: Release, config: str) -> None:
    """Compile for the processor of this host; what was compiled on another one does not run here."""
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


def _require_room(host: Host, release: Release) -> None:
    free_mb = shutil.disk_usage(host.root).free >> 20
    if free_mb < release.needs_mb:
        raise InstallError(
            f"a release needs {release.needs_mb} MB of disk, {free_mb} MB are free: make room first"
        )
