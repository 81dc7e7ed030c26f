"""`stonefall lots`: products and lots of a running daemon, as a client of its REST interface."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote, urlencode

import typer
from rich.console import Console
from rich.table import Column, Table

from drivers.files.durable import write_file
from service.base.errors import UsageError
from service.commands.daemon_client import AsJson, DaemonClient
from service.commands.laboratory import correlations, sieving, sievings
from service.commands.options import SizeOptions, with_options

FORMATS = ("html", "pdf", "csv", "xlsx")
STONE_FORMATS = ("csv", "parquet")
STONES_TIMEOUT_S = 600.0
"""A hundred thousand stones are made in a minute or more, beside the measuring."""
OPEN = ("insufficient", "undecided")
"""Verdicts that more stones may decide. No enumeration is imported: answers are words of the REST contract."""

command = typer.Typer(
    no_args_is_help=True, help="Products and lots of a running daemon: gradation, verdict, report."
)
for of_laboratory in (sieving, sievings, correlations):
    command.command()(of_laboratory)

Lot = Annotated[str, typer.Argument(metavar="LOT", help="Name of the lot.")]
SieveSet = Annotated[
    str | None, typer.Option("--sieves", help="Sieve set, or 4,5.6,8 (mm), in the place of the product's.")
]


@dataclass(frozen=True, slots=True)
class ProductOptions(SizeOptions):
    title: Annotated[str | None, typer.Option(help="For people; the name when absent.")] = None
    sieve_set: SieveSet = None
    flakiness_category: Annotated[str | None, typer.Option(help="Such as FI20.")] = None
    shape_category: Annotated[str | None, typer.Option(help="Such as SI20.")] = None


@command.command()
@with_options
def product(
    name: Annotated[str, typer.Argument(metavar="PRODUCT", help="Name of the product.")],
    density_kg_m3: Annotated[float, typer.Option(help="Density of the particles, EN 1097-6, kg/m3.")],
    options: ProductOptions,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Define a product, or change it: a change is a new version, and lots keep theirs."""
    wanted = {**asdict(options), "density_kg_m3": density_kg_m3, "title": options.title or name}
    saved = daemon.ask(f"/products/{quote(name)}", wanted, method="PUT")
    typer.echo(json.dumps(saved) if as_json else f"product {name}, version {saved['version']}")


@dataclass(frozen=True, slots=True)
class OpenOptions:
    lot: Lot
    product: Annotated[str, typer.Option(help="Name of the product.")]
    equipment: Annotated[str | None, typer.Option(help="The crusher or belt that it comes from.")] = None
    sublot: str | None = None
    sample_id: str | None = None
    sampler: str | None = None
    external_id: Annotated[str | None, typer.Option(help="Its id in the plant's own system.")] = None
    order: str | None = None
    customer: str | None = None
    tonnage_t: float | None = None
    remark: str | None = None


@command.command("open")
@with_options
def open_(options: OpenOptions, daemon: DaemonClient, as_json: AsJson = False) -> None:
    """Open a lot: what falls from now on is in it."""
    _show(daemon.ask("/lots", asdict(options)), as_json)


@command.command()
@with_options
def close(
    lot: Lot,
    tonnage_t: float | None = None,
    wait_s: Annotated[float, typer.Option(help="Longest wait for the last stones and the verdict.")] = 20.0,
    *,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Close a lot; what fell before stays in it."""
    _show(daemon.ask(f"/lots/{quote(lot)}/close?wait_s={wait_s:g}", {"tonnage_t": tonnage_t}), as_json)


@command.command()
@with_options
def void(
    lot: Lot,
    reason: Annotated[str, typer.Option(help="Why it counts no more.")],
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Declare a lot void; it is kept."""
    _show(daemon.ask(f"/lots/{quote(lot)}/void", {"reason": reason}), as_json)


@command.command()
@with_options
def assign(
    lot: Lot,
    since: Annotated[str, typer.Option(help="Captured at or after, RFC 3339.")],
    until: Annotated[str, typer.Option(help="Captured before, RFC 3339.")],
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Put the stones of a time that are in no lot into this one."""
    done = daemon.ask(f"/lots/{quote(lot)}/assign", {"since": since, "until": until})
    typer.echo(json.dumps(done) if as_json else f"{done['n_assigned']} stones more are in lot {lot}")


@command.command("list")
@with_options
def list_(daemon: DaemonClient, as_json: AsJson = False) -> None:
    """List lots, the newest first."""
    page = daemon.ask("/lots")
    if as_json:
        typer.echo(json.dumps(page))
        return
    table = Table("lot", "state", "product", "opened", "closed", "stones")
    for lot in page["items"]:
        times = (lot["opened_at"], lot["closed_at"])
        version = f"{lot['product']} ({lot['product_version']})"
        table.add_row(lot["lot"], lot["state"], version, *times, str(lot["n_stones"]))
    Console().print(table)


@command.command()
@with_options
def show(
    lot: Lot,
    sieve_set: SieveSet = None,
    specification: Annotated[
        str | None, typer.Option(help="Specification, in the place of the product's.")
    ] = None,
    *,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Show curve, indices and verdict of a lot, through its product's sieves or through any other."""
    asked = {"sieve_set": sieve_set, "specification": specification}
    query = urlencode({name: value for name, value in asked.items() if value is not None})
    figures = daemon.ask(f"/lots/{quote(lot)}/gradation?{query}")
    if as_json:
        typer.echo(json.dumps(figures))
        return
    console = Console()
    console.print(curve_table(figures))
    console.print(
        f"{figures['triggers']} stones fell = {figures['measured']} measured + {figures['rejected']} rejected"
        f" + {figures['lost']} lost"
    )
    for title, counts in (("body", figures["by_body"]), ("not refined", figures["not_refined"])):
        if counts:
            words = (f"{n} {word.replace('_', ' ')}" for word, n in counts.items())
            console.print(f"{title}: {', '.join(words)}")
    if figures["verdict"] is not None:
        partly = " (partly measured)" if figures["is_partial"] else ""
        console.print(
            f"{figures['specification']}: [bold]{figures['verdict'].replace('_', ' ')}[/bold]{partly}"
        )
        console.print(figures["countdown"])
        if why := why_open(figures):
            typer.echo(why)


@command.command()
@with_options
def report(
    lot: Lot,
    out: Annotated[Path, typer.Option(help=f"File to write; its ending is one of {', '.join(FORMATS)}.")],
    language: Annotated[str, typer.Option(help="en or de.")] = "en",
    *,
    daemon: DaemonClient,
) -> None:
    """Write the report of a lot."""
    kind = _ending(out, FORMATS)
    content = daemon.fetch(f"/lots/{quote(lot)}/report.{kind}?{urlencode({'language': language})}")
    write_file(out, content)
    typer.echo(f"{out}: {len(content) / 1e3:.0f} kB")


@command.command()
@with_options
def control(
    product: Annotated[str, typer.Argument(metavar="PRODUCT", help="Name of the product.")],
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Show the control charts of a product: limits, capability, and the lots that are out of control."""
    found = daemon.ask(f"/products/{quote(product)}/control")
    if as_json:
        typer.echo(json.dumps(found))
        return
    console, drifting = Console(), [each["figure"] for each in found["drifting"]]
    console.print(control_table(found["charts"]))
    for chart in found["charts"]:
        for point in (each for each in chart["points"] if each["rules"]):
            console.print(f"{chart['figure']}: lot {point['lot']}: {', '.join(point['rules'])}")
    console.print(f"drifting: {', '.join(drifting) or 'nothing'}")


def control_table(charts: list[dict[str, Any]]) -> Table:
    """Return control charts as a table for a terminal: a row a figure, with its newest lot."""
    numbers = ("lots", "newest", "lower", "centre", "upper", "EWMA", "Cpk", "Ppk")
    table = Table("figure", *(Column(name, justify="right") for name in numbers))
    for chart in charts:
        counted = [point for point in chart["points"] if point["is_counted"]]
        newest = counted[-1] if counted else {"figure": {}}
        capability = chart["capability"] or {}
        shown = (
            newest["figure"].get("value"),
            newest.get("lower"),
            chart["centre"],
            newest.get("upper"),
            newest.get("ewma"),
            capability.get("cpk"),
            capability.get("ppk"),
        )
        texts = ("-" if value is None else f"{value:.2f}" for value in shown)
        table.add_row(chart["figure"], str(len(counted)), *texts)
    return table


@command.command()
@with_options
def stones(
    lot: Lot,
    out: Annotated[
        Path, typer.Option(help=f"File to write; its ending is one of {', '.join(STONE_FORMATS)}.")
    ],
    language: Annotated[
        str | None, typer.Option(help="Of the spreadsheet that shall read the CSV: en or de.")
    ] = None,
    *,
    daemon: DaemonClient,
) -> None:
    """Write all stones of a lot, with all fields of their results."""
    kind = _ending(out, STONE_FORMATS)
    query = urlencode({"language": language}) if language and kind == "csv" else ""
    content = daemon.fetch(f"/lots/{quote(lot)}/stones.{kind}?{query}", timeout_s=STONES_TIMEOUT_S)
    write_file(out, content)
    typer.echo(f"{out}: {len(content) / 1e3:.0f} kB")


def _ending(out: Path, formats: Sequence[str]) -> str:
    kind = out.suffix.removeprefix(".")
    if kind not in formats:
        raise UsageError(f"--out {out}: must end with .{', .'.join(formats)}")
    return kind


def why_open(figures: dict[str, Any]) -> str | None:
    """Return in one line why there is no verdict yet and what would close it; None when it is decided."""
    if figures["verdict"] not in OPEN:
        return None
    indices = [("FI", figures["flakiness_decision"]), ("SI", figures["shape_decision"])]
    judged = [(f"{step['sieve_mm']:g} mm", step["decision"]) for step in figures["curve"]] + indices
    still_open = [
        (name, decision["more_stones"])
        for name, decision in judged
        if decision and decision["verdict"] in OPEN
    ]
    few = f"with {figures['measured']} stones the 95 % interval reaches over a limit"
    if figures["verdict"] == "insufficient":
        few = f"{figures['measured']} stones are too few for a verdict"
    never = [name for name, more in still_open if more is None]
    if never:
        return f"open, as {few}; no number of stones would decide {', '.join(never)}"
    last, more = max(still_open, key=lambda each: each[1])
    return f"open, as {few}; about {more} more would close it, if the curve stays ({last} takes the most)"


def curve_table(figures: dict[str, Any]) -> Table:
    """Return the curve as a table for a terminal: passing with its interval, limits and verdict."""
    columns = (
        Column(name, justify="right") for name in ("sieve, mm", "passing, %", "95 %", "limits", "verdict")
    )
    table = Table(*columns, title=f"{figures['sieve_set']}: {figures['measured']} stones")
    for step in figures["curve"]:
        passing, decision = step["passing_percent"], step["decision"]
        is_measured = passing["value"] is not None
        limits = decision and decision["limits"]
        table.add_row(
            f"{step['sieve_mm']:g}",
            f"{passing['value']:.1f}" if is_measured else "not measured",
            f"{passing['low']:.1f} to {passing['high']:.1f}" if is_measured else "",
            f"{limits['min_percent']:g} to {limits['max_percent']:g}" if limits else "",
            decision["verdict"].replace("_", " ") if decision else "",
        )
    return table


def _show(lot: dict[str, Any], as_json: bool) -> None:
    text = f"lot {lot['lot']} of {lot['product']} is {lot['state']}: {lot['n_stones']} stones"
    if lot["in_progress"]:
        text += f", {lot['in_progress']} without an outcome yet"
    if (said := lot["completion"]) is not None:
        text += f"; revision {said['revision']} is final: {said['verdict'] or 'no specification'}"
    typer.echo(json.dumps(lot) if as_json else text)
