"""`stonefall remeasure`: have a running daemon measure its stones again, each as a revision of its result.

The daemon alone writes its store, so this command asks it for one stone after the other; or, with `--executor`, has a
cluster measure many at a time and the daemon take what came of each. Killed half-way and started again, it goes on:
what is of today's algorithm already is not measured again.
"""

import asyncio
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import Progress

from service.commands.daemon_client import DaemonClient, Key
from service.commands.measuring_pool import Executor, one_error
from service.commands.remeasure_on_cluster import (
    OrderingDaemon,
    RemeasuredIds,
    noted_refusal,
    remeasure_on_cluster,
)
from service.configuration.settings import load_settings
from service.remeasuring.remeasuring import DEADLINE_S
from service.results.fields import Outcome

PAGE = 1000
NAMED = 10
"""Stones of a kind that are named for people; `--json` names all."""
TRIES = 3
"""Times that the daemon may need for one stone: another client may have it measure, too, and the process must start."""


def command(
    config: Annotated[Path, typer.Option(help="Configuration file of the running daemon.")],
    lot: Annotated[str | None, typer.Option(help="Only stones of this lot.")] = None,
    since: Annotated[str | None, typer.Option(help="Captured at or after, RFC 3339.")] = None,
    until: Annotated[str | None, typer.Option(help="Captured before, RFC 3339.")] = None,
    executor: Executor = None,
    key: Key = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome of each stone as JSON.")] = False,
) -> None:
    """Measure stones again from their archived frames, with today's algorithm; the results become revisions.

    What each version of the algorithm changed in results: service/remeasuring/README.md.
    """
    settings = load_settings(config)
    daemon = DaemonClient(settings.api.local_url, key)
    query = {"kind": "particle", "lot": lot, "since": since, "until": until, "fields": "algorithm_version"}
    wanted = {name: value for name, value in query.items() if value is not None}
    summary = RemeasuredIds(
        without_frames=[stone["id"] for stone in _stones(daemon, wanted, has_frames=False)]
    )
    names = [stone["id"] for stone in _stones(daemon, wanted, has_frames=True)][::-1]  # the oldest first
    with Progress(console=Console(file=sys.stderr)) as progress:
        bar = progress.add_task("measuring again", total=len(names))
        if executor is None:
            for name in names:
                with noted_refusal(name, summary):
                    done = daemon.ask(f"/particles/{name}/revisions", {}, timeout_s=TRIES * DEADLINE_S)
                    (summary.revised if done["is_new"] else summary.unchanged).append(name)
                progress.advance(bar)
        else:
            ordering = OrderingDaemon(daemon, settings.spool.dir)
            with one_error():
                asyncio.run(
                    remeasure_on_cluster(ordering, executor, names, summary, lambda: progress.advance(bar))
                )
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        n_revised, n_same, gone = map(len, (summary.revised, summary.unchanged, summary.without_frames))
        typer.echo(f"{n_revised} stones measured again, {n_same} were of this algorithm")
        if gone:
            more = f" and {gone - NAMED} more" if gone > NAMED else ""
            typer.echo(f"{gone} have no frames any more: {', '.join(summary.without_frames[:NAMED])}{more}")
        for name, why in summary.failed.items():
            typer.echo(f"{name}: {why}", err=True)
    if summary.failed:
        raise typer.Exit(1)


def _stones(daemon: DaemonClient, wanted: dict[str, str], *, has_frames: bool) -> Iterator[dict[str, Any]]:
    """Return the stones that were looked at, newest first."""
    stones = daemon.pages("/particles", {**wanted, "has_frames": str(has_frames).lower(), "limit": PAGE})
    return (stone for stone in stones if stone["outcome"] != Outcome.LOST)
