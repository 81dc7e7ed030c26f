"""`stonefall compare`: the same stones as measured twice, one by one and as a lot; the gate of an upgrade.

Either two folders that `stonefall measure` wrote of one recording, by an old and a new release; or, with `--lot`, two
algorithm versions or revisions of the stones of a running daemon. Exits with 1 when a change is beyond a given limit.
"""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Column, Table

from service.base.errors import UsageError
from service.commands.daemon_client import DaemonClient
from service.commands.options import with_options
from service.commands.results_folder import read_results
from service.lots.comparing import ComparedFigure, compared_figures
from service.lots.evaluation import figures_of
from service.lots.stone_changes import Group, Records, StoneChanges, beyond_limits, stone_changes
from service.lots.stones import stones_in
from service.lots.yardsticks import Request, UnknownYardstickError
from service.results.version import CHANGES_GUIDE

PAGE = 500
REVISION = re.compile("r([0-9]{1,6})")
NAMED = 10
"""Stones whose outcome or quality is another one that are named for people; `--json` names all."""

Stones = dict[str, dict[str, Any]]
Limit = Annotated[float | None, typer.Option(min=0.0)]


@dataclass(frozen=True, slots=True)
class CompareOptions:
    old: Annotated[str, typer.Argument()]
    """Folder of results; with --lot a version such as 13, or r1."""
    new: Annotated[str, typer.Argument()]
    """The same, of the new release; r2 is the second revision."""
    lot: str | None = None
    """Compare stones of this lot of a running daemon."""
    max_volume_percent: Limit = None
    """Largest change of a stone's volume."""
    max_sieve_mm: Limit = None
    """Largest change of a stone's sieve size."""
    max_axes_mm: Limit = None
    """Largest change of a stone's axes and Feret diameters."""
    max_shape: Limit = None
    """Largest change of a stone's shape factors, 0 to 1."""
    max_passing_percent: Limit = None
    """Largest change of the lot's passing at a sieve, in points."""
    same_words: bool = False
    """Outcome, reason and quality of each stone must be equal."""
    sieve_set: Annotated[str, typer.Option("--sieves")] = "stonefall"
    """Name of a sieve set."""


@with_options
def command(
    options: CompareOptions,
    daemon: DaemonClient,
    as_json: Annotated[bool, typer.Option("--json", help="Print all differences as JSON.")] = False,
) -> None:
    """Compare two measurements of the same stones: volume, sieve size, axes, shape, quality, and the lot's curve.

    What each version of the algorithm changed in results: service/remeasuring/README.md.
    """
    if options.lot is None:
        before, after = (_by_bundle(Path(path)) for path in (options.old, options.new))
    else:
        before, after = revisions_of_lot(daemon, options.lot, (options.old, options.new))
    changes = stone_changes(before, after)
    if not changes.n_common:
        raise UsageError(f"{options.old} and {options.new} have no stone in common")
    figures = _figures([before, after], options.sieve_set)
    limits = {
        Group.VOLUME: options.max_volume_percent,
        Group.SIEVE: options.max_sieve_mm,
        Group.AXES: options.max_axes_mm,
        Group.SHAPE: options.max_shape,
    }
    beyond = [
        *beyond_limits(changes, {group: limit for group, limit in limits.items() if limit is not None}),
        *_passing_beyond(figures, options.max_passing_percent),
        *(
            [f"{each.field} of {each.id} is {each.after}, was {each.before}" for each in changes.words]
            if options.same_words
            else []
        ),
    ]
    if as_json:
        lots = [figure.model_dump(mode="json") for figure in figures]
        typer.echo(json.dumps({"stones": asdict(changes), "lot": lots, "beyond": beyond}))
    else:
        _print(changes, figures, beyond)
        if changes.n_changed:
            typer.echo(_versions_line(before, after))
    if beyond:
        raise typer.Exit(1)


def _by_bundle(results: Path) -> Stones:
    """Return the records of a folder by the names of their bundles, which are the stones' ids here."""
    records = {record["bundle"]: {**record, "id": record["bundle"]} for record in read_results(results)}
    if not records:
        raise UsageError(f"{results} has no results")
    return records


def revisions_of_lot(daemon: DaemonClient, lot: str, sides: tuple[str, str]) -> tuple[Stones, Stones]:
    """Return the records by id, of each stone the newest that is of a side: an algorithm version, or rN.

    Raises `UsageError` if a side has no stone in the lot.
    """
    found: tuple[Stones, Stones] = ({}, {})
    wanted = [_is_of(side) for side in sides]
    for stone in daemon.pages("/particles", {"lot": lot, "kind": "particle", "limit": PAGE}):
        for record in _newest_first(daemon, stone):
            for stones, is_of in zip(found, wanted, strict=True):
                if record["id"] not in stones and is_of(record):
                    stones[record["id"]] = record
            if all(record["id"] in stones for stones in found):
                break
    for side, stones in zip(sides, found, strict=True):
        if not stones:
            raise UsageError(f"no stone of lot {lot} has a result of {side}")
    return found


def _is_of(side: str) -> Callable[[dict[str, Any]], bool]:
    if revision := REVISION.fullmatch(side):
        return lambda record: bool(record["revision"] == int(revision[1]))
    return lambda record: bool(record["algorithm_version"] == side)


def _newest_first(daemon: DaemonClient, record: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a stone's results, from the newest back to the first that is kept."""
    yield record
    while record["revises"] is not None:
        record = daemon.ask(f"/particles/{record['revises']}")
        yield record


def _figures(sides: Sequence[Records], sieve_set: str) -> list[ComparedFigure]:
    """Return the figures of the stones that are in both, as lots."""
    common = [name for name in sides[0] if name in sides[1]]
    stones = [stones_in([side[name] for name in common]) for side in sides]
    if not all(each.measured_ids for each in stones):
        return []
    request = Request(sieve_set=sieve_set)
    try:
        found = [figures_of(each, request) for each in stones]
    except UnknownYardstickError as err:
        raise UsageError(f"--sieves: {err}") from err
    return compared_figures(stones, found, request.measured, is_paired=True)


def _passing_beyond(figures: Sequence[ComparedFigure], limit: float | None) -> list[str]:
    return [
        f"{each.figure} of the lot differs by {each.difference:+.3g}, more than {limit:g}"
        for each in figures
        if limit is not None
        and each.figure.startswith("passing")
        and each.difference is not None
        and abs(each.difference) > limit
    ]


def _print(changes: StoneChanges, figures: Sequence[ComparedFigure], beyond: Sequence[str]) -> None:
    console = Console()
    numbers = (Column(name, justify="right") for name in ("changed", "mean", "rms", "largest"))
    table = Table("figure", *numbers, "of stone", title=f"{changes.n_common} stones")
    for each in changes.fields:
        worst = each.largest[0] if each.n_changed else None
        table.add_row(
            f"{each.field}, {each.unit}" if each.unit == "%" else each.field,
            f"{each.n_changed} of {each.n_stones}",
            f"{each.mean:+.4f}",
            f"{each.rms:.4f}",
            "" if worst is None else f"{worst.change:+.4f}",
            "" if worst is None else f"{worst.id}: {worst.before:.6g} -> {worst.after:.6g}",
        )
    console.print(table)
    if changes.n_changed:
        numbers = (Column(name, justify="right") for name in ("before", "after", "difference"))
        as_lots = Table("figure", *numbers, title="as lots")
        for figure in figures:
            if figure.difference is not None:
                values = (f"{figure.a.value:.3f}", f"{figure.b.value:.3f}", f"{figure.difference:+.4f}")
                as_lots.add_row(figure.figure, *values)
        console.print(as_lots)
    for word in changes.words[:NAMED]:
        typer.echo(f"{word.id}: {word.field} {word.before} -> {word.after}")
    if len(changes.words) > NAMED:
        typer.echo(f"and {len(changes.words) - NAMED} more")
    for side, names in (("old", changes.only_before), ("new", changes.only_after)):
        if names:
            typer.echo(f"{len(names)} stones are in the {side} results alone: {', '.join(names[:NAMED])}")
    if not changes.n_changed:
        typer.echo("all of these are equal, bit for bit")
    for each_beyond in beyond:
        typer.echo(each_beyond, err=True)


def _versions_line(before: Records, after: Records) -> str:
    """Return the algorithm versions of both sides, and if they differ where stands what each changed."""
    old, new = (
        ", ".join(sorted({str(record.get("algorithm_version")) for record in side.values()}))
        for side in (before, after)
    )
    if old == new:
        return f"both of algorithm {old}: images, parameters, calibration or background differ"
    return f"algorithm {old} -> {new}; what each version changed: {CHANGES_GUIDE}"
