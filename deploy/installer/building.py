"""Put a release on a host, beside the others: its environment, its guides, its compiled loops, its self-test."""

import os
import shutil
import tempfile
from functools import partial
from pathlib import Path

from installer import placement, releases, selftest, service
from installer.host import COMPILED, USER, Host, InstallError
from installer.releases import Release

BRIDGE = "/etc/stonefall-bridge/bridge.toml"
"""Where it is, the packages of the bridge are installed as well."""
PARTS = ("README.md", "deploy", "systemd", "selftest", "service", "drivers", "pipeline", "tests")
"""What goes into a release beside its environment: guides, the installer, what is placed in /etc, the self-test."""


def build(host: Host, bundle: Path, release: Release) -> bool:
    """Install a release from a bundle, up to its self-test, beside the current one; return if it was not there.

    Raises
    ------
    InstallError
        The version is there from another commit, or a step failed: what there was of the release is removed.
    """
    folder = release.folder(host)
    present = next((each for each in releases.installed(host) if each.version == release.version), None)
    if present is not None and present.commit != release.commit:
        raise InstallError(
            f"release {release.version} is installed from commit {present.commit[:7]}, this is {release.commit[:7]}:"
            " a release never changes; the new one needs a version of its own in pyproject.toml"
        )
    is_done = present is not None
    steps = (
        (f"{folder}: environment, from the wheels", partial(make_environment, host, bundle, release)),
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


def make_environment(host: Host, bundle: Path, release: Release) -> None:
    """Install the wheels of a bundle, by the hashes of its lock, into the folder of the release."""
    folder = release.folder(host)
    if folder.exists():  # an earlier installation was interrupted
        shutil.rmtree(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    host.run("/usr/bin/python3", "-m", "venv", "--system-site-packages", folder)
    pip = (folder / "bin/python", "-m", "pip", "--isolated", "--quiet", "--disable-pip-version-check")
    offline = (*pip, "install", "--no-index", "--find-links", bundle / "wheels")
    lock = "requirements-bridge.lock" if host.path(BRIDGE).exists() else "requirements.lock"
    host.run(*offline, "--require-hashes", "--requirement", bundle / "deploy" / lock)
    host.run(*offline, "--no-deps", bundle / f"wheels/stonefall-{release.version}-py3-none-any.whl")


def copy_parts(bundle: Path, folder: Path) -> None:
    """Copy what a release has beside its environment."""
    for part in PARTS:
        if (bundle / part).is_dir():
            shutil.copytree(bundle / part, folder / part)
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
