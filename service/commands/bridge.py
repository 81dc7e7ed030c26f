"""`stonefall bridge`: OPC UA, MQTT and contacts beside the daemon, as a client of it."""

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from service.base.errors import UsageError
from service.base.log_level import LogLevel
from service.base.systemd import configure_logging, service_manager
from service.bridge.opcua.passwords import hash_password
from service.bridge.run import run
from service.bridge.settings import load_bridge_settings


def command(
    config: Annotated[
        Path | None, typer.Option("--config", help="TOML file of the bridge, see deploy/bridge.toml.")
    ] = None,
    is_hashing: Annotated[
        bool, typer.Option("--hash-password", help="Ask for a password of [[opcua.users]], print its hash.")
    ] = False,
) -> None:
    """Serve results, lots, state and alarms over OPC UA, MQTT and contacts, until SIGTERM; a client of the daemon."""
    if is_hashing:
        typer.echo(
            hash_password(typer.prompt("Password", hide_input=True, confirmation_prompt=True, err=True))
        )
        return
    if config is None:
        raise UsageError("--config FILE is needed")
    settings = load_bridge_settings(config)
    configure_logging(os.environ, LogLevel.INFO)
    asyncio.run(run(settings, service_manager(os.environ, os.getpid())))
