"""`stonefall alarms`: the alarms that need attention, and their remedies, as a client of a running daemon."""

import json
from typing import Annotated

import typer

from service.base.language import Language
from service.commands.daemon_client import DEFAULT_URL, AsJson, Key, Url, ask
from service.health.alarms.printed import as_text


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
    url: Url = DEFAULT_URL,
    key: Key = None,
    as_json: AsJson = False,
) -> None:
    """Print the alarms of a running daemon, the most urgent first, each with its cause and what to do."""
    if acknowledge is not None:
        ask(url, f"/alarms/{acknowledge}/acknowledge", key, {})
    found = ask(url, f"/alarms{'/history' if is_history else ''}?language={language}", key)
    if as_json:
        typer.echo(json.dumps(found))
        return
    for alarm in found["items"]:
        typer.echo(as_text(alarm))
    aside = [f"{len(found[kind])} {kind}" for kind in ("shelved", "suppressed") if found.get(kind)]
    typer.echo("; ".join([f"{len(found['items'])} alarms", *aside]))
