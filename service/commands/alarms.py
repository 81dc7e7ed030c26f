"""`stonefall alarms`: the alarms that need attention, and their remedies, as a client of a running daemon."""

import json
from typing import Annotated

import typer

from service.base.language import Language
from service.commands.daemon_client import AsJson, DaemonClient
from service.commands.options import with_options
from service.health.alarms.printed import as_text


@with_options
def command(
    acknowledge: Annotated[
        int | None,
        typer.Option(metavar="ID", help="Acknowledge the alarm of this number, and print the others."),
    ] = None,
    is_history: Annotated[
        bool,
        typer.Option("--history", help="Print the latest 100 instead, newest first, with those that ended."),
    ] = False,
    language: Annotated[Language, typer.Option(help="Of causes and actions.")] = Language.ENGLISH,
    *,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Print the alarms of a running daemon, the most urgent first, each with its cause and what to do."""
    if acknowledge is not None:
        daemon.ask(f"/alarms/{acknowledge}/acknowledge", {})
    found = daemon.ask(f"/alarms{'/history' if is_history else ''}?language={language}")
    if as_json:
        typer.echo(json.dumps(found))
        return
    for alarm in found["items"]:
        typer.echo(as_text(alarm))
    aside = [f"{len(found[kind])} {kind}" for kind in ("shelved", "suppressed") if found.get(kind)]
    typer.echo("; ".join([f"{len(found['items'])} alarms", *aside]))
