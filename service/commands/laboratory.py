"""`stonefall lots sieving`, `sievings` and `correlations`: the laboratory, as a client of the REST interface."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import quote

import typer
from rich.console import Console
from rich.table import Column, Table

from service.base.errors import UsageError
from service.base.tables.files import table_text
from service.commands.daemon_client import AsJson, DaemonClient
from service.commands.options import with_options

HISTORY_TIMEOUT_S = 600.0

Reason = Annotated[str | None, typer.Option(help="Why; kept with it and in the audit.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Store nothing: show how the table is read.")]


@dataclass(frozen=True, slots=True)
class SievingOptions:
    lot: Annotated[str, typer.Argument(metavar="LOT", help="Name of the lot.")]
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="Table of the sieving.")] = None
    dry_run: DryRun = False
    dry_mass_g: Annotated[float | None, typer.Option(help="Dry mass before sieving, g.")] = None
    by: Annotated[str | None, typer.Option(help="Who sieved.")] = None
    reason: Reason = None
    replaces: Annotated[int | None, typer.Option(help="Number of the sieving that it corrects.")] = None
    void: Annotated[int | None, typer.Option(help="Number of a sieving that is to count no more.")] = None


@with_options
def sieving(options: SievingOptions, daemon: DaemonClient, as_json: AsJson = False) -> None:
    """Store a laboratory's sieving of a lot, or declare one void; without FILE list them."""
    path = f"/lots/{quote(options.lot)}/sieving"
    if options.void is not None:
        if options.file is not None or options.reason is None:
            raise UsageError("--void N: needs --reason and no FILE")
        _show(daemon.ask(f"{path}/{options.void}/void", {"reason": options.reason}), options.lot, as_json)
    elif options.file is None:
        found = daemon.ask(path)
        if as_json:
            typer.echo(json.dumps(found))
        else:
            Console().print(_sievings_table(found["items"]))
    else:
        body = {
            "table": table_text(options.file),
            **{name: getattr(options, name) for name in ("dry_mass_g", "by", "reason", "replaces")},
            "dry_run": options.dry_run,
        }
        _show(daemon.ask(path, body), options.lot, as_json)


@with_options
def sievings(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Table with a column `lot`, Los or Charge.")],
    dry_run: DryRun = False,
    reason: Reason = None,
    *,
    daemon: DaemonClient,
    as_json: AsJson = False,
) -> None:
    """Store a sieving of each lot of a table, such as the history of months: all of them or none."""
    body = {"table": table_text(file), "reason": reason, "dry_run": dry_run}
    stored = daemon.ask("/sievings", body, timeout_s=HISTORY_TIMEOUT_S)
    if as_json:
        typer.echo(json.dumps(stored))
        return
    for each in stored["items"]:
        _show(each, each["lot"], as_json)


@dataclass(frozen=True, slots=True)
class CorrelationOptions:
    product: Annotated[str, typer.Argument(metavar="PRODUCT", help="Name of the product.")]
    study: Annotated[bool, typer.Option("--study", help="Study all lots that were sieved.")] = False
    form: Annotated[str, typer.Option(help="Of the mapping: factor or monotone.")] = "factor"
    accept: Annotated[int | None, typer.Option(help="Version to put in use.")] = None
    withdraw: Annotated[int | None, typer.Option(help="Version to take back.")] = None
    reason: Reason = None


@with_options
def correlations(options: CorrelationOptions, daemon: DaemonClient, as_json: AsJson = False) -> None:
    """List the correlation studies of a product; make, accept or withdraw one."""
    path = f"/products/{quote(options.product)}/correlations"
    if sum((options.study, options.accept is not None, options.withdraw is not None)) > 1:
        raise UsageError("--study, --accept, --withdraw: give one of them")
    if options.withdraw is not None and options.reason is None:
        raise UsageError("--withdraw N: needs --reason")
    if options.study:
        found = daemon.ask(path, {"form": options.form}, timeout_s=HISTORY_TIMEOUT_S)
    elif options.accept is not None:
        found = daemon.ask(f"{path}/{options.accept}/accept", {}, method="POST")
    elif options.withdraw is not None:
        found = daemon.ask(f"{path}/{options.withdraw}/withdraw", {"reason": options.reason})
    else:
        found = daemon.ask(path)
    if as_json:
        typer.echo(json.dumps(found))
        return
    columns = ("version", "state", "in use", "factor", "lots", "raw, points", "held out, points")
    table = Table(*columns)
    for each in found.get("items", [found]):
        held_out = "" if each["held_out_rmse"] is None else f"{each['held_out_rmse']:.2f}"
        figures = (f"{each['factor']:.4f}", str(each["n_lots"]), f"{each['raw_rmse']:.2f}", held_out)
        table.add_row(str(each["version"]), each["state"], "yes" if each["is_in_use"] else "", *figures)
    Console().print(table)
    for each in found.get("items", [found]):
        for obstacle in each["obstacles"]:
            typer.echo(f"version {each['version']} cannot be accepted: {obstacle}")


def _show(found: dict[str, Any], lot: str, as_json: bool) -> None:
    """Print a stored sieving in a line, or one that was only read as a table."""
    if as_json:
        typer.echo(json.dumps(found))
        return
    mass = "" if found["mass_g"] is None else f", {found['mass_g']:g} g"
    if "understood" not in found:
        state = "stored" if found["voided_at"] is None else "void"
        n_sieves = len(found["passing_percent"])
        typer.echo(f"sieving {found['sieving']} of lot {lot} is {state}: {n_sieves} sieves{mass}")
        return
    heads = ("sieve, mm", "retained, g", "passing, %", "instrument, %", "difference")
    table = Table(*(Column(head, justify="right") for head in heads), title=f"lot {lot}{mass}")
    for step in found["sieves"]:
        numbers = (
            *(step["retained_g"], step["passing_percent"]),
            *(step["instrument_percent"]["value"], step["difference"]),
        )
        table.add_row(f"{step['sieve_mm']:g}", *("" if each is None else f"{each:.1f}" for each in numbers))
    Console().print(table)
    typer.echo(f"read as: {found['understood']}")
    if found["implausible"] is not None:
        typer.echo(f"implausible: {found['implausible']}")


def _sievings_table(items: list[dict[str, Any]]) -> Table:
    table = Table("sieving", "at", "by", "mass, g", "sieves", "void")
    for each in items:
        mass = "" if each["mass_g"] is None else f"{each['mass_g']:g}"
        replaced = "" if each["replaced_by"] is None else f" (see {each['replaced_by']})"
        void = f"{each['void_reason']}{replaced}" if each["voided_at"] else ""
        n_sieves = str(len(each["passing_percent"]))
        table.add_row(str(each["sieving"]), each["at"], each["by"] or "", mass, n_sieves, void)
    return table
