"""`stonefall alarms`: the alarms that need attention, and their remedies, as a client of a running daemon."""

import json
from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, Any

import typer

from service.base.language import Language
from service.commands.daemon_client import AsJson, DaemonClient
from service.commands.options import with_options
from service.health.alarms.alarm import AlarmState

STATES = {
    AlarmState.UNACKNOWLEDGED: "not acknowledged",
    AlarmState.ACKNOWLEDGED: "acknowledged",
    AlarmState.RETURNED: "gone, not acknowledged",
    AlarmState.SHELVED: "shelved",
    AlarmState.SUPPRESSED: "caused by another alarm",
    AlarmState.NORMAL: "ended",
}


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
        typer.echo(alarm_as_text(alarm))
    aside = [f"{len(found[kind])} {kind}" for kind in ("shelved", "suppressed") if found.get(kind)]
    typer.echo("; ".join([f"{len(found['items'])} alarms", *aside]))


def alarm_as_text(alarm: Mapping[str, Any]) -> str:
    """Return an alarm in a few lines: how urgent, since when and for how long; what is wrong, why, what to do."""
    raised = datetime.fromisoformat(alarm["raised_at"])
    times = f"raised {raised:%Y-%m-%d %H:%M:%S} UTC"
    if alarm["occurrences"] > 1:
        times = f"first {times}, {alarm['occurrences']} times in all"
    if alarm["state"] in (AlarmState.RETURNED, AlarmState.NORMAL) and alarm["cleared_at"] is not None:
        lasted = datetime.fromisoformat(alarm["cleared_at"]) - raised
        times += f", gone after {timedelta(seconds=max(0, round(lasted.total_seconds())))}"  # a clock may be set back
    texts = (alarm.get("said"), alarm["detail"], alarm["cause"], f"-> {alarm['action']}")
    lines = (
        f"{alarm['id']:>5}  {alarm['priority']}  {alarm['check']}  {STATES[alarm['state']]}; {times}",
        *(f"       {text}" for text in dict.fromkeys(texts) if text),
    )
    return "\n".join(lines)
