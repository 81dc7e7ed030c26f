"""`stonefall remeasure`: have a running daemon measure its stones again, each as a revision of its result.

The daemon alone writes its store, so this command asks it for one stone after the other. Killed half-way and started
again, it goes on: what is of today's algorithm already is not measured again.
"""

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlencode

import typer
from rich.console import Console
from rich.progress import Progress

from service.commands.daemon_client import DaemonError, Key, ask
from service.configuration.settings import load_settings
from service.remeasuring.remeasuring import DEADLINE_S, Hindrance
from service.results.fields import Outcome

PAGE = 1000
NAMED = 10
"""Stones of a kind that are named for people; `--json` names all."""
EVERY_INTERFACE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - where to ask a daemon that listens there
TRIES = 3
"""Times that the daemon may need for one stone: another client may have it measure, too, and the process must start."""


@dataclass(slots=True)
class Summary:
    """The ids of the stones, by what came of them."""

    revised: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)
    without_frames: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)  # with the reason


def command(
    config: Annotated[Path, typer.Option(help="Configuration file of the running daemon.")],
    lot: Annotated[str | None, typer.Option(help="Only stones of this lot.")] = None,
    since: Annotated[str | None, typer.Option(help="Captured at or after, RFC 3339.")] = None,
    until: Annotated[str | None, typer.Option(help="Captured before, RFC 3339.")] = None,
    key: Key = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what came of each stone as JSON.")] = False,
) -> None:
    """Measure stones again from their archived frames, with today's algorithm; the results become revisions."""
    settings = load_settings(config).api
    host = EVERY_INTERFACE.get(settings.host, settings.host)
    url = f"http://{f'[{host}]' if ':' in host else host}:{settings.port}"
    query = {"kind": "particle", "lot": lot, "since": since, "until": until, "fields": "algorithm_version"}
    wanted = {name: value for name, value in query.items() if value is not None}
    summary = Summary(without_frames=[stone["id"] for stone in _stones(url, key, wanted, has_frames=False)])
    stones = list(_stones(url, key, wanted, has_frames=True))
    with Progress(console=Console(file=sys.stderr)) as progress:
        for stone in progress.track(stones[::-1], description="measuring again"):  # the oldest first
            _remeasure(url, key, stone, summary)
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        _print(summary)
    if summary.failed:
        raise typer.Exit(1)


def _stones(
    url: str, key: str | None, wanted: dict[str, str], *, has_frames: bool
) -> Iterator[dict[str, Any]]:
    """Yield the stones that were looked at, newest first."""
    cursor: dict[str, str] | None = {}
    while cursor is not None:
        query = urlencode({**wanted, **cursor, "has_frames": str(has_frames).lower(), "limit": PAGE})
        page = ask(url, f"/particles?{query}", key)
        yield from (item for item in page["items"] if item["outcome"] != Outcome.LOST)
        cursor = None if page["next_cursor"] is None else {"cursor": page["next_cursor"]}


def _remeasure(url: str, key: str | None, stone: dict[str, Any], summary: Summary) -> None:
    """Have one stone measured again, and note what came of it; raise `DaemonError` if the daemon does not answer."""
    name = stone["id"]
    try:
        done = ask(url, f"/particles/{name}/revisions", key, {}, timeout_s=TRIES * DEADLINE_S)
    except DaemonError as err:
        if err.kind == Hindrance.NO_FRAMES:
            summary.without_frames.append(name)
        elif err.kind in (Hindrance.NO_CALIBRATION, Hindrance.FAILED):
            summary.failed[name] = str(err)
        else:  # nothing about this stone: the daemon stops, the key is wrong, the rig was never empty
            raise
    else:
        (summary.revised if done["is_new"] else summary.unchanged).append(name)


def _print(summary: Summary) -> None:
    typer.echo(
        f"{len(summary.revised)} stones measured again, {len(summary.unchanged)} were of this algorithm"
    )
    if summary.without_frames:
        typer.echo(f"{len(summary.without_frames)} have no frames any more: {_named(summary.without_frames)}")
    for name, why in summary.failed.items():
        typer.echo(f"{name}: {why}", err=True)


def _named(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
