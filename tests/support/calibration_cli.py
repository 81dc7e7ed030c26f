"""`stonefall calibration` asked of a daemon of a test."""

import json
from typing import Any

from support.daemon_process import DaemonProcess
from typer.testing import CliRunner

from service.commands.cli import build_app


def run(daemon: DaemonProcess, *words: str) -> dict[str, Any]:
    """What it prints with --json."""
    url = daemon.url("").removesuffix("/api/v1")
    done = CliRunner().invoke(build_app(["calibration"]), ["calibration", *words, "--url", url, "--json"])
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))
