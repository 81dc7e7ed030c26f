"""`stonefall backup`: copy the database of results."""

from pathlib import Path
from typing import Annotated

import typer

from service.configuration.settings import load_settings
from service.store.backups import back_up, backup_path


def command(
    config: Annotated[Path, typer.Option("--config", help="TOML file of the daemon.")],
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
