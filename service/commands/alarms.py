"""`stonefall alarms`: what needs somebody now, and what to do, as a client of a running daemon."""

import json
from typing import Annotated, Any

import typer

from service.commands.daemon_client import DEFAULT_URL, AsJson, Key, Url, ask
from service.language import Language


def command(
    acknowledge: Annotated[
        int | None, typer.Option(metavar="ID", help="Take note of this alarm, and print the others.")
    ] = None,
    language: Annotated[Language, typer.Option(help="Of causes and actions.")] = Language.ENGLISH,
    url: Url = DEFAULT_URL,
    key: Key = None,
    as_json: AsJson = False,
) -> None:
    """Print the alarms of a running daemon, the most urgent first, each with its cause and what to do."""
    if acknowledge is not None:
        ask(url, f"/alarms/{acknowledge}/acknowledge", key, {})
    found = ask(url, f"/alarms?language={language}", key)
    if as_json:
        typer.echo(json.dumps(found))
        return
    for alarm in found["items"]:
        typer.echo(_text(alarm))
    aside = [f"{len(found[kind])} {kind}" for kind in ("shelved", "suppressed") if found[kind]]
    typer.echo("; ".join([f"{len(found['items'])} alarms", *aside]))


def _text(alarm: dict[str, Any]) -> str:
    times = f", {alarm['occurrences']} times" if alarm["occurrences"] > 1 else ""
    lines = (
        f"{alarm['id']:>5}  {alarm['priority']}  {alarm['check']}  {alarm['state']}, since {alarm['raised_at']}{times}",
        *(f"       {text}" for text in (alarm["detail"], alarm["cause"], f"-> {alarm['action']}") if text),
    )
    return "\n".join(lines)
