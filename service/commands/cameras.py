"""`stonefall cameras`: find GigE cameras, and print the GenICam description of one."""

import json
from dataclasses import asdict
from ipaddress import IPv4Address
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from drivers.cameras.description import genicam_xml
from drivers.gvcp import discover, local_addresses


def ipv4_address(text: str) -> str:
    """Return the address as it is usually written; raise `typer.BadParameter` when it is none."""
    try:
        return str(IPv4Address(text))
    except ValueError as err:
        raise typer.BadParameter(str(err)) from err


def command(
    xml: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            parser=ipv4_address,
            help="Print the GenICam XML of the camera at this address.",
        ),
    ] = None,
    interface: Annotated[
        list[str] | None,
        typer.Option(
            metavar="IP",
            parser=ipv4_address,
            help="Search only the network port of this machine with this address; may be repeated.",
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON list with one object for each camera.")
    ] = False,
) -> None:
    """List all GigE cameras on the networks of this machine, also those in use."""
    if xml is not None:
        typer.echo(genicam_xml(xml))
        return
    found = discover(interface)
    if as_json:
        typer.echo(json.dumps([asdict(device) for device in found], indent=2))
    elif found:
        titles = ("address", "serial", "user name", "model", "MAC")
        table = Table(*(Column(title, overflow="fold") for title in titles))
        for each in found:
            model = f"{each.vendor} {each.model} {each.version}"
            cells = (each.address, each.serial, each.user_name, model, each.mac)
            table.add_row(
                *map(Text, cells)
            )  # as text: rich would print the :cd: of a MAC as a picture of a disc
        Console().print(table)
    else:
        typer.echo(f"No camera answers on the networks of {', '.join(interface or local_addresses())}.")
