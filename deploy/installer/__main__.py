"""Steps of `deploy/install` once Python is there: prints each, and exits with 1 if one cannot be done."""

import argparse
import shutil
import signal
import sys
import time
from functools import partial
from pathlib import Path

from installer import building, placement, releases, service
from installer.host import Host, InstallError, say
from installer.releases import Release
from installer.review import may_switch, review
from installer.switch import switch

HERE = Path(__file__).resolve().parents[2]


def main() -> None:
    """Install the bundle that this lies in, or switch to a release that is installed."""
    parser = argparse.ArgumentParser(prog="deploy/install", description=main.__doc__)
    parser.add_argument("--dry-run", action="store_true", help="print every step and change nothing")
    parser.add_argument(
        "--switch-to", metavar="VERSION", help="make an installed release the current one again"
    )
    parser.add_argument(
        "--restore",
        action="store_true",
        help="with an older release: restore the backup that it can read; later results are kept beside the feed",
    )
    parser.add_argument(
        "--review",
        metavar="STONES",
        type=int,
        help="show first what changes, and how the results of so many archived stones would shift; then ask",
    )
    parser.add_argument(
        "--yes", action="store_true", help="with --review: do not ask while shifts are within limits"
    )
    parser.add_argument("--show", action="store_true", help="with --review: do not ask, and switch nothing")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by SIGTERM"))
    host = Host(dry_run=arguments.dry_run)
    start = time.monotonic()
    try:
        changed = _install(host, arguments)
    except (InstallError, OSError) as err:
        sys.exit(f"stonefall is not installed: {err}")
    minutes = (time.monotonic() - start) / 60
    if not changed:
        print("nothing to do")
    else:
        print("nothing was changed: dry run" if host.dry_run else f"{minutes:.1f} minutes")


def _install(host: Host, arguments: argparse.Namespace) -> bool:
    if arguments.switch_to is None:
        target = releases.read_release(HERE / "bundle.json")
        changed = building.build(host, HERE, target)
    else:
        target, changed = _installed(host, arguments.switch_to), False
    previous = releases.current(host)
    if arguments.review is not None and target != previous and not host.dry_run:
        is_within = review(host, previous, target, arguments.review)
        if arguments.show or not may_switch(target, is_within=is_within, is_agreed=arguments.yes):
            say("unchanged", f"{target.version} lies beside the current release; nothing was switched")
            return changed
    if host.dry_run and (target not in releases.installed(host) or not (host.is_root or target == previous)):
        say(
            "would",
            "place units and files of the host, back up the database, switch, start, and wait for health",
        )
        return True
    changed |= switch(host, target, may_restore=arguments.restore)
    for release in releases.expendable(releases.installed(host), (target, previous)):
        changed |= host.step(
            f"remove release {release.version}: {releases.KEEP} are kept",
            partial(shutil.rmtree, release.folder(host)),
        )
    if host.runs_systemd and not service.is_running(host):
        changed |= host.step(
            "enabled, so that it starts with the host",
            partial(host.run, "systemctl", "enable", service.UNIT),
            is_done=host.ask("systemctl", "is-enabled", service.UNIT).stdout.strip() == "enabled",
        )
    if not host.dry_run:
        _say_what_remains(host, target)
    return changed


def _installed(host: Host, version: str) -> Release:
    every = releases.installed(host)
    for release in every:
        if release.version == version:
            return release
    known = ", ".join(release.version for release in every)
    raise InstallError(f"there is no release {version}; installed: {known or 'none'}")


def _say_what_remains(host: Host, release: Release) -> None:
    for problem in sorted(service.read_configuration(host, release).problems):
        say("to do", f"{placement.CONFIGURATION}: {problem}")
    found = service.stonefall(host, release, "check-host", "--config", placement.CONFIGURATION)
    if found.returncode != 2:  # the release has this command
        for line in (found.stdout or found.stderr).strip().splitlines():
            say("host", line)
    if not host.runs_systemd:
        say("skipped", "systemd does not run here: nothing was enabled, started or loaded. By hand:")
        print(
            "      install -d -o stonefall -g stonefall /run/stonefall\n"
            "      runuser -u stonefall -- env NUMBA_CACHE_DIR=/var/cache/stonefall/numba"
            f" {releases.CURRENT}/bin/stonefall serve --config {placement.CONFIGURATION}"
        )
    elif not service.is_running(host):
        say("to do", "calibrate and configure the rig (deploy/README.md), then: systemctl start stonefall")


main()
