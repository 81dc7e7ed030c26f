"""Switch a host from one release to another: backup, link, health gate, and back by itself if that fails.

An older release cannot read a database that a newer one has migrated. To go back then means to restore a backup made
before; what was measured since is counted, written to a file, and stays in the database that is moved aside.
"""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from installer import placement, releases, service
from installer.host import Host, InstallError, say
from installer.releases import Release
from installer.service import Configuration, Readiness
from installer.store import BACKUPS, Copy, Stock, backup_for

RELOADS = {
    "/etc/sysctl.d/": ("sysctl", "--system"),
    "/etc/udev/rules.d/": ("udevadm", "trigger", "--action=add", "-stty", "-sgpio", "-susb-serial"),
    "/etc/chrony/": ("systemctl", "try-restart", "chrony"),
    "/etc/systemd/system/": ("systemctl", "daemon-reload"),
    "/etc/systemd/journald.conf.d/": ("systemctl", "restart", "systemd-journald"),
    "/etc/tmpfiles.d/": ("systemd-tmpfiles", "--create"),
}
"""What makes a changed file count, by the folder that it lies in."""


@dataclass(frozen=True)
class Return:
    """Effect of a change to an older release on the results."""

    backup: Copy | None  # to be restored; None: the database stays as it is
    beyond: int  # results that the backup does not have


def plan_return(target: Release, stock: Stock) -> Return:
    """Return the backup to restore, if any, so that a release can read the store; raise `InstallError` if none fits."""
    if stock.in_use is None or stock.in_use.schema <= target.schema:
        return Return(None, 0)
    backup = backup_for(stock, target.schema)
    if backup is None:
        raise InstallError(
            f"the database has schema {stock.in_use.schema}, {target.version} reads schemas up to {target.schema}, and"
            f" there is no backup that it can read: nothing was changed. It could run with another store.dir only"
        )
    return Return(backup, stock.in_use.last_seq - backup.last_seq)


def _return_to(whole: Path, stock: Stock) -> Return:
    """Return the backup that undoes a downgrade; none if the database was not replaced yet."""
    backup = next(copy for copy in stock.backups if Path(copy.path) == whole)
    if stock.in_use is not None and stock.in_use.schema == backup.schema:
        return Return(None, 0)
    return Return(backup, stock.in_use.last_seq - backup.last_seq if stock.in_use else 0)


def switch(host: Host, target: Release, *, may_restore: bool) -> bool:
    """Make a release the current one; return whether anything changed.

    Raises
    ------
    InstallError
        Nothing was changed, or what was current before is so again, or cannot be; the text says which.
    """
    previous, link = releases.current(host), releases.read_link(host)
    if previous == target:
        host.step(f"current release: {target.version}", lambda: None, is_done=True)
        return activate(host, target)
    configuration = service.read_configuration(host, target)
    was_running = service.is_running(host)
    _require_configuration(host, previous, configuration, was_running)
    state_dir = configuration.state_dir
    if state_dir is not None and not was_running:
        service.require_unlocked_store(host.path(str(state_dir)))
    back = Return(None, 0)
    if state_dir is not None:
        back = plan_return(target, service.look_at_store(host, target, state_dir))
    if back.backup is not None and not may_restore:
        raise InstallError(
            f"{target.version} cannot read the database as it is. The newest backup that it reads is"
            f" {back.backup.path}, without the {back.beyond} results measured since. Nothing was changed; --restore"
            " goes on: these results are then kept in a file and in the database moved aside, no longer in the feed"
        )
    url = configuration.health_url
    before = service.usual_readiness(url) if was_running and url is not None else None
    whole = None  # the copy to return to once an older database was put in place
    try:
        if was_running:
            host.step("stop the daemon, which measures first what has fallen", lambda: service.stop(host))
        if state_dir is not None and (stock := service.look_at_store(host, target, state_dir)).in_use:
            copy = _back_up(host, previous, target, state_dir)
            if (back := plan_return(target, stock)).backup is not None:
                whole = copy
                _restore(host, target, back, stock, state_dir)
        _go_on_with(host, target, configuration, before)
    except BaseException as err:
        failure = f"{target.version}: {str(err) or type(err).__name__}"
        former = previous.version if previous else link or "none"
        say("rollback", f"to {former}")
        try:
            _return(host, previous or link, target, configuration, before, whole)
        except (InstallError, OSError) as further:
            raise InstallError(f"{failure}. The rollback failed, too: {further}") from err
        runs = " and runs" if before else ""
        raise InstallError(f"{failure}. Rolled back: {former} is the current release{runs}") from err
    if state_dir is not None:
        _remove_old_copies(host, state_dir)  # only now: one of them may have been the one to restore
    return True


def activate(host: Host, release: Release) -> bool:
    """Let the link lead to a release and put its files in their places; return whether anything changed."""
    changed = host.step(
        f"{releases.CURRENT} -> releases/{release.version}",
        lambda: releases.make_current(host, release),
        is_done=releases.current(host) == release,
    )
    placed = placement.place(host, release)
    if placed and not host.dry_run and host.runs_systemd:
        for folder, command in RELOADS.items():
            if any(target.startswith(folder) for target in placed):
                done = host.ask(*command)
                if done.returncode != 0:  # such as sysctl in a container: the daemon works without
                    say("failed", f"{' '.join(command)}: {done.stderr.strip().splitlines()[-1:]}")
    is_changed = placement.link_command(host) or changed or bool(placed)
    if is_changed and not host.dry_run and host.runs_systemd:
        host.ask("systemctl", "try-restart", service.BRIDGE)  # where it runs: now of this release
    return is_changed


def _require_configuration(
    host: Host, previous: Release | None, configuration: Configuration, was_running: bool
) -> None:
    known = configuration if previous is None else service.read_configuration(host, previous)
    if configuration.state_dir is None and (was_running or known.state_dir is not None):
        found = configuration.problems  # with it the daemon could not be started again
    else:
        found = configuration.problems - known.problems if was_running else frozenset()
    if found:
        raise InstallError(f"the configuration does not fit, nothing was changed: {'; '.join(sorted(found))}")


def _back_up(host: Host, previous: Release | None, target: Release, state_dir: Path) -> Path:
    """Copy the database with the release that wrote it, and return the copy."""
    copy = state_dir / BACKUPS / f"before-{target.version}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.sqlite"
    maker = previous or target

    def back_up() -> None:
        done = service.stonefall(host, maker, "backup", copy, "--config", placement.CONFIGURATION)
        if done.returncode != 0:
            raise InstallError(f"no backup, so no switch: {done.stderr.strip()}")

    host.step(f"backup of the database: {copy}", back_up)
    return copy


def _remove_old_copies(host: Host, state_dir: Path) -> None:
    copies = host.path(str(state_dir / BACKUPS)).glob("before-*.sqlite")
    for path in sorted(copies, key=lambda path: path.stat().st_mtime)[: -releases.KEEP]:
        host.step(f"remove {path}: {releases.KEEP} such backups are kept", path.unlink)


def _restore(host: Host, release: Release, back: Return, stock: Stock, state_dir: Path) -> None:
    """Restore the backup of a return with the release that is to read it; keep what it does not have."""
    if back.backup is None:
        return
    backup = back.backup
    later = (
        state_dir
        / BACKUPS
        / f"after-{Path(backup.path).stem.removeprefix('before-')}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.jsonl"
    )
    if stock.in_use is not None and back.beyond > 0:
        database = stock.in_use.path
        host.step(
            f"the {back.beyond} results that the backup does not have, kept in {later}",
            lambda: service.write_later_results(host, release, database, backup.last_seq, later),
        )

    def restore() -> None:
        done = service.stonefall(host, release, "restore", backup.path, "--config", placement.CONFIGURATION)
        if done.returncode != 0:
            raise InstallError(done.stderr.strip())
        say("", done.stdout.strip())

    host.step(f"restore {backup.path}", restore)


def _go_on_with(host: Host, release: Release, configuration: Configuration, before: Readiness | None) -> None:
    """Make a release current and, if the daemon ran, start it and wait until it measures."""
    activate(host, release)
    if before is not None and configuration.health_url is not None:
        url = configuration.health_url
        host.step("start the daemon", lambda: service.start(host))
        service.require_release(host, release)
        host.step("health gate", lambda: say("", service.wait_until_healthy(url, before).detail))


def _return(
    host: Host,
    previous: Release | Path | None,
    target: Release,
    configuration: Configuration,
    before: Readiness | None,
    whole: Path | None,
) -> None:
    """Go back to the release from before with the database that it can read, or to what the link led to by hand."""
    if before is not None:
        host.ask("systemctl", "stop", service.UNIT)
    if isinstance(previous, Release):
        if configuration.state_dir is not None:
            stock = service.look_at_store(host, target, configuration.state_dir)
            back = plan_return(previous, stock) if whole is None else _return_to(whole, stock)
            _restore(host, previous, back, stock, configuration.state_dir)
        activate(host, previous)
    else:
        releases.set_link(host, previous)
    if before is not None:
        service.start(host)
        if configuration.health_url is not None:
            say("", service.wait_until_healthy(configuration.health_url, before).detail)
