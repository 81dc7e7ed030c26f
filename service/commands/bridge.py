"""`stonefall bridge`: OPC UA, MQTT and contacts beside the daemon, as a client of it."""

import asyncio
import os
from pathlib import Path
from typing import Annotated

import typer

from service.base.log_level import LogLevel
from service.base.systemd import configure_logging, service_manager
from service.bridge.run import run
from service.bridge.settings import load_bridge_settings


def command(
    config: Annotated[
        Path, typer.Option("--config", help="TOML file of the bridge, see deploy/bridge.toml.")
    ],
) -> None:
    """Serve results, lots, state and alarms over OPC UA, MQTT and contacts, until SIGTERM; a client of the daemon."""
    settings = load_bridge_settings(config)
    configure_logging(os.environ, LogLevel.INFO)
    asyncio.run(run(settings, service_manager(os.environ, os.getpid())))
