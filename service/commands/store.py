"""`stonefall backup`, `restore` and `audit verify`: the database of results, copied, put back, and looked at."""

from pathlib import Path
from typing import Annotated

import typer

from service.base.errors import StoreError
from service.commands.options import DaemonConfig
from service.configuration.settings import load_settings
from service.store import read
from service.store.audit import check_chain, kept_digests
from service.store.backups import back_up, backup_path, restore
from service.store.history import DATABASE

audit_command = typer.Typer(
    no_args_is_help=True, help="The audit: who changed what. `GET /audit.csv` exports it."
)


def backup_command(
    config: DaemonConfig,
    out: Annotated[
        Path | None,
        typer.Argument(help="File to write; a file of its own in store.dir/backups if not given."),
    ] = None,
) -> None:
    """Copy the database of results as it is now, and check the copy; the daemon may be running."""
    state_dir = load_settings(config).store.dir
    target = backup_path(state_dir) if out is None else out.absolute()
    back_up(state_dir, target)
    typer.echo(str(target))


def restore_command(
    file: Annotated[Path, typer.Argument(help="A file that `stonefall backup` or the daemon has written.")],
    config: Annotated[Path, typer.Option("--config", help="TOML file of the daemon, which must not run.")],
    any_audit: Annotated[
        bool,
        typer.Option(
            "--any-audit", help="Accept a backup with the audit of another store, such as another rig's."
        ),
    ] = False,
) -> None:
    """Restore a backup; what was there is moved aside, and clients begin the feed again (new instance_id)."""
    typer.echo(restore(file.absolute(), load_settings(config).store.dir, any_audit=any_audit))


@audit_command.callback()
def _several() -> None:
    """Keep `verify` a command of its own."""


@audit_command.command()
def verify(
    config: Annotated[Path, typer.Option("--config", help="TOML file of the daemon, which may be running.")],
) -> None:
    """Check that no entry of the audit was edited or removed; exit 1 if one was.

    It is compared with the digests that the daemon keeps beside the database. If both were changed, only an earlier
    export or an earlier printed digest shows it.
    """
    state_dir = load_settings(config).store.dir
    path, kept = state_dir / DATABASE, kept_digests(state_dir)
    chain = read(path, check_chain, kept)
    if chain.broken_at is not None:
        raise StoreError(
            f"{path}: entry {chain.broken_at} of the audit, or one before it, was changed or removed"
        )
    typer.echo(f"{chain.n_entries} entries, whole; digest of the last: {chain.digest or 'none'}")
