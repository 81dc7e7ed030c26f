"""`stonefall doctor`: all that can be looked at on this machine and its rig, on one screen."""

import asyncio
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer

from service.commands.check_host import Root
from service.commands.daemon_client import ConfiguredUrl, Key
from service.commands.doctor_daemon import check_daemon, is_running
from service.commands.doctor_rig import check_cameras, check_gate, check_pulse
from service.commands.findings import document, has_fault, show
from service.configuration.host_needs import host_needs
from service.configuration.rig_settings import AravisRigSettings
from service.configuration.settings import Settings, load_settings, problems, shortcomings
from service.host.check import check_host
from service.host.finding import Finding, fault, good, unknown
from service.host.host import ROOT, Host, host_at
from service.store.lock import is_locked


def command(
    config: Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")],
    pulse: Annotated[
        bool,
        typer.Option(
            "--pulse",
            help="Also arm the rig and fire the gate's test pulse, with and without the flash; no daemon may run.",
        ),
    ] = False,
    root: Root = ROOT,
    url: ConfiguredUrl = None,
    key: Key = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all findings by part as JSON.")] = False,
) -> None:
    """Check host, configuration, cameras and gate, and name each fault with its remedy; exit 0 if there is none.

    A running daemon holds the devices: then its health is read instead, and nothing is taken from it.
    """
    settings = load_settings(config)
    host = host_at(root)
    parts: Mapping[str, list[Finding]] = {
        "Host": check_host(host, host_needs(settings)),
        "Configuration": list(_configuration(config, settings)),
        "Rig": list(_rig(settings, host, url or settings.api.local_url, key, is_fired=pulse)),
    }
    if as_json:
        typer.echo(json.dumps({name.lower(): document(part) for name, part in parts.items()}, indent=2))
    else:
        for name, part in parts.items():
            show(name, part)
    if any(map(has_fault, parts.values())):
        raise typer.Exit(1)


def _configuration(file: Path, settings: Settings) -> Iterator[Finding]:
    wrong = [*problems(settings), *shortcomings(settings)]
    for problem in wrong:
        field, _, text = problem.partition(": ")
        remedy = f"edit {file}, then: stonefall check-config {file}"
        yield fault(field, found=text, wanted="nothing is wrong with it", remedy=remedy)
    if not wrong:
        yield good(str(file), "nothing is wrong with it", "")


def _rig(settings: Settings, host: Host, url: str, key: str | None, *, is_fired: bool) -> Iterator[Finding]:
    if is_locked(settings.store.dir) or is_running(url):
        yield from check_daemon(url, key)
        if is_fired:
            yield unknown(
                "test pulse", "not fired: the daemon has the rig and fires its own", "check background"
            )
        return
    match settings.rig:
        case AravisRigSettings() as rig:
            yield from check_cameras(rig, host)
            yield check_gate(rig)
            if is_fired:
                yield from asyncio.run(check_pulse(rig, settings.bundling))
        case replay:
            yield unknown("rig", f"{replay.recording} is replayed", "cameras and a light gate")
