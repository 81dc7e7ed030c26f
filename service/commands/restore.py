"""`stonefall restore`: put a backup in the place of the database of results."""

from pathlib import Path
from typing import Annotated

import typer

from service.configuration.settings import load_settings
from service.store.backups import restore


def command(
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
