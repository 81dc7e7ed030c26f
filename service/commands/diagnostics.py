"""`stonefall diagnostics`: one archive for support, of the running daemon or of what one has left."""

import os
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from service.base.errors import UsageError
from service.commands.daemon_client import ConfiguredUrl, DaemonClient, DaemonError, Key
from service.commands.doctor import is_running
from service.configuration.settings import load_settings
from service.daemon.diagnostics.archive import build_archive
from service.daemon.diagnostics.diagnostic_inputs import diagnostic_inputs

ANSWER_S = 90.0
"""The archive may wait for other answers of the daemon."""


def command(
    config: Annotated[Path, typer.Option("--config", help="TOML file, see deploy/stonefall.toml.")],
    out: Annotated[
        Path | None, typer.Argument(help="File to write; default: stonefall-TIME.tar.gz here.")
    ] = None,
    url: ConfiguredUrl = None,
    key: Key = None,
    offline: Annotated[
        bool,
        typer.Option("--offline", help="Do not ask the daemon, even if it runs: without health and metrics."),
    ] = False,
) -> None:
    """Write an archive with configuration, versions, health, alarms, host, calibrations and log, without secrets."""
    out = out or Path(f"stonefall-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.tar.gz")
    if out.exists():
        raise UsageError(f"{out}: exists already")
    settings = load_settings(config)
    daemon = DaemonClient(url or settings.api.local_url, key)
    if not offline and is_running(daemon):
        try:
            content = daemon.fetch("/diagnostics", timeout_s=ANSWER_S)
        except DaemonError as err:
            raise DaemonError(f"{err}; --offline does without the daemon", err.kind) from err
        source = f"the daemon at {daemon.url}"
    else:
        os.nice(10)  # it may run beside a daemon
        content, source = build_archive(diagnostic_inputs(settings)), "files alone: no daemon was asked"
    with open(out, "xb", opener=partial(os.open, mode=0o600)) as file:  # for its owner alone
        file.write(content)
    typer.echo(f"{out}: {len(content) / 1e3:.0f} kB, of {source}")
