"""`stonefall check-host`: is this machine set up for the rig of a configuration."""

import json
from pathlib import Path
from typing import Annotated

import typer

from service.commands.findings import document, has_fault, show
from service.configuration.host_needs import host_needs
from service.configuration.settings import load_settings
from service.host.check import check_host
from service.host.host import ROOT, host_at

Root = Annotated[
    Path,
    typer.Option(
        "--root",
        exists=True,
        file_okay=False,
        help="Look at the files below this folder instead of this machine's, such as a copy of /proc, /sys and /etc.",
    ),
]


def command(
    config: Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")],
    root: Root = ROOT,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON list of all findings.")] = False,
) -> None:
    """Check buffers, network ports, processor, gate, clock, journal, spool and disk; exit 0 if there is no fault.

    Each fault has its remedy: a command, or a file of deploy/host and where it goes. Nothing is changed.
    """
    findings = check_host(host_at(root), host_needs(load_settings(config)))
    if as_json:
        typer.echo(json.dumps(document(findings), indent=2))
    else:
        show("Host", findings)
    if has_fault(findings):
        raise typer.Exit(1)
