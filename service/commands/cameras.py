"""`stonefall cameras`: find GigE cameras, and print the GenICam description of one."""

import json
from dataclasses import asdict, dataclass
from ipaddress import IPv4Address
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from drivers.cameras.description import genicam_xml
from drivers.gvcp import discover, local_addresses
from service.commands.options import Json, with_options


def ipv4_address(text: str) -> str:
    """Return the address as it is usually written; raise `typer.BadParameter` when it is none."""
    try:
        return str(IPv4Address(text))
    except ValueError as err:
        raise typer.BadParameter(str(err)) from err


@dataclass(frozen=True, slots=True)
class CamerasOptions:
    xml: Annotated[str | None, typer.Option(metavar="ADDRESS", parser=ipv4_address)] = None
    """Print the GenICam XML of the camera at this address."""
    interface: Annotated[list[str] | None, typer.Option(metavar="IP", parser=ipv4_address)] = None
    """Search only the network port of this machine with this address; may be repeated."""
    as_json: Json = False
    """Print a JSON list with one object for each camera."""


@with_options
def command(options: CamerasOptions) -> None:
    """List all GigE cameras on the networks of this machine, also those in use."""
    if options.xml is not None:
        typer.echo(genicam_xml(options.xml))
        return
    found = discover(options.interface)
    if options.as_json:
        typer.echo(json.dumps([asdict(device) for device in found], indent=2))
    elif found:
        titles = ("address", "serial", "user name", "model", "MAC")
        table = Table(*(Column(title, overflow="fold") for title in titles))
        for each in found:
            model = f"{each.vendor} {each.model} {each.version}"
            cells = (each.address, each.serial, each.user_name, model, each.mac)
            table.add_row(*map(Text, cells))  # rich would print the :cd: of a MAC as a picture of a disc
        Console().print(table)
    else:
        networks = ", ".join(options.interface or local_addresses())
        typer.echo(f"No camera answers on the networks of {networks}.")
