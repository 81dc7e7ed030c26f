"""Steps of `deploy/uninstall`: take away what was installed, and leave what was measured and configured.

Files in /etc that were edited on the host stay, and are named. Packages of Debian stay, as others may use them.
"""

import argparse
import shutil
import sys
from functools import partial

from installer import placement, releases, service
from installer.host import BRIDGE_USER, USER, Host, InstallError, say

WORDS = "delete all results"
KEPT = ("/var/lib/stonefall", "/etc/stonefall", "/var/lib/stonefall-bridge", "/etc/stonefall-bridge")
TAKEN = ("/opt/stonefall", "/var/cache/stonefall", "/run/stonefall")


def main() -> None:
    """Remove releases, units and unedited host files; --purge, in its words, also results and configuration."""
    parser = argparse.ArgumentParser(prog="deploy/uninstall", description=main.__doc__)
    parser.add_argument("--dry-run", action="store_true", help="print every step and change nothing")
    parser.add_argument(
        "--purge", metavar=f'"{WORDS}"', help="in these words: also all that was measured and configured"
    )
    arguments = parser.parse_args()
    try:
        uninstall(Host(dry_run=arguments.dry_run), arguments.purge)
    except (InstallError, OSError) as err:
        sys.exit(f"stonefall is not uninstalled: {err}")


def uninstall(host: Host, purge: str | None) -> None:
    """Uninstall, with results and configuration if `purge` is `WORDS`.

    Raises
    ------
    InstallError
        Other words, or a daemon that systemd does not run: nothing was changed; or a command failed.
    """
    if purge is not None and purge != WORDS:
        raise InstallError(
            f"nothing was changed: --purge is meant only with the words {WORDS!r}, not {purge!r}"
        )
    if not service.is_running(host):
        service.require_unlocked_store(host.path(KEPT[0]))
    files = list(placement.placed(host, releases.installed(host)))
    if host.runs_systemd and host.path(f"/etc/systemd/system/{service.UNIT}").exists():
        for unit in (service.BRIDGE, service.UNIT):
            if host.path(f"/etc/systemd/system/{unit}").exists():
                host.step(
                    f"stop and disable {unit}", partial(host.run, "systemctl", "disable", "--now", unit)
                )
    for target, was_edited in files:
        if was_edited:
            say("kept", f"{target}: it was edited here")
        else:
            host.step(f"remove {target}", host.path(target).unlink)
    for link in placement.links(host):
        host.step(f"remove {link}", host.path(link).unlink)
    for folder in [*TAKEN, *(KEPT if purge is not None else ())]:
        if host.path(folder).exists():
            host.step(f"remove {folder}", partial(shutil.rmtree, host.path(folder)))
    if host.runs_systemd:
        host.step("systemctl daemon-reload", lambda: host.run("systemctl", "daemon-reload"))
    if purge is None:
        for folder in KEPT:
            if host.path(folder).exists():
                say("kept", f'{folder}; --purge "{WORDS}" removes it')
    for user in (USER, BRIDGE_USER) if purge is not None else ():
        if host.ask("id", user).returncode == 0:
            host.step(f"remove the account {user}", partial(host.run, "userdel", user))


if __name__ == "__main__":
    main()
