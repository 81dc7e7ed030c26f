"""`stonefall audit`: whether the audit is whole."""

from pathlib import Path
from typing import Annotated

import typer

from service.base.errors import StoreError
from service.configuration.settings import load_settings
from service.store import read
from service.store.audit import check_chain, kept_digests
from service.store.history import DATABASE

command = typer.Typer(no_args_is_help=True, help="The audit: who changed what. `GET /audit.csv` exports it.")


@command.callback()
def _several() -> None:
    """Keep `verify` a command of its own."""


@command.command()
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
