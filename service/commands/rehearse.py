"""`stonefall rehearse`: a scripted day on a simulated rig, for the writer of a client to follow."""

import json
import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from service.base.errors import UsageError
from service.base.language import Language
from service.commands.options import Json, with_options
from service.commands.rehearsal.day import Day, merged, scripts
from service.commands.rehearsal.expected import as_text
from service.commands.rehearsal.recordings import RehearsedRecording, rehearsed_recording
from service.commands.rehearsal.rehearsed_bridge import rehearsed_bridge
from service.commands.rehearsal.rehearsed_daemon import HOST, RehearsedDaemon, free_port, is_free
from service.commands.rehearsal.rigs import ReplayedRig, Rig, SimulatedGigeRig

SETTINGS = {
    "spool": {"dir": "spool", "max_bundles": 100},
    "store": {"dir": "state", "retention": {"min_free_gb": 0.0}},
    "recordings": {"reserve_gb": 0.1},
    "carving": {"n": 64},  # enough for images so small
    "measuring": {"density_kg_m3": 2700.0},
}


@dataclass(frozen=True, slots=True)
class RehearseOptions:
    script: str = "day"
    """Script to play; --list shows all."""
    is_list: Annotated[bool, typer.Option("--list")] = False
    """List the scripts, and end."""
    speed: Annotated[float, typer.Option(min=0.1, max=10)] = 1.0
    """Factor on four stones a second."""
    port: Annotated[int, typer.Option(min=0, max=65535)] = 8080
    """Port of the daemon; 0: a free one."""
    folder: Path | None = None
    """Folder to keep store and log in, empty or new; default: a temporary one."""
    linger_s: Annotated[float, typer.Option(min=0)] = 15.0
    """Time for clients to read the last results, before the daemon ends."""
    language: Language = Language.ENGLISH
    """Language of the alarms' causes and actions."""
    is_bridge: Annotated[bool, typer.Option("--bridge")] = False
    """Bridge it as well to OPC UA, MQTT and Modbus TCP, as far as their packages are there."""
    as_json: Json = False
    """Print what a client should have seen as JSON; the rest goes to stderr."""


@with_options
def command(options: RehearseOptions) -> None:
    """Rehearse a day: a simulated rig, a daemon of its own, sample lots, and what goes wrong at a plant.

    Let your client follow the address that is printed. The command ends with what the client should have seen, and with
    each alarm, its cause and what to do.
    """
    known = scripts()
    if options.is_list:
        table = Table("script", "what happens", "needs", box=None)
        for each in known.values():
            table.add_row(each.name, each.title, "Aravis" if each.is_gige else "")
        Console().print(table)
        return
    if options.script not in known:
        raise UsageError(f"--script {options.script}: must be one of {', '.join(known)}")
    chosen = known[options.script]
    port = options.port or free_port()
    if not is_free(port):
        raise UsageError(f"--port {port}: something else listens there")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    with ExitStack() as running:
        if options.folder is None:
            where = Path(running.enter_context(tempfile.TemporaryDirectory(prefix="stonefall-rehearse-")))
        else:
            where = options.folder.absolute()
            where.mkdir(parents=True, exist_ok=True)
            if any(where.iterdir()):
                raise UsageError(f"--folder {options.folder}: must be empty")

        def say(text: str) -> None:
            typer.echo(f"{time.strftime('%H:%M:%S')}  {text}", err=options.as_json)
            (sys.stderr if options.as_json else sys.stdout).flush()

        say(f"{chosen.name}: {chosen.title}")
        recording = rehearsed_recording(chosen.recording)
        is_looping = chosen.recording is not RehearsedRecording.BUMPED
        rig: Rig = (
            running.enter_context(SimulatedGigeRig(recording, options.speed, where))
            if chosen.is_gige
            else ReplayedRig(recording, options.speed, is_looping=is_looping)
        )
        settings = merged(merged(SETTINGS, rig.settings()), chosen.settings)
        daemon = RehearsedDaemon(where, settings, port, has_own_clock=chosen.has_own_clock)
        running.callback(daemon.stop)
        daemon.start()
        rig.rest(daemon)
        say(f"follow http://{HOST}:{port}/api/v1/results with your client")
        if options.is_bridge:
            bridge = rehearsed_bridge(where, f"http://{HOST}:{port}")
            for outlet, address in running.enter_context(bridge).items():
                say(f"{outlet}: {address}")
        expected = Day(chosen, daemon, rig, say, options.language).play()
        say("the day is over; a correct client has seen:")
        typer.echo(json.dumps(asdict(expected)) if options.as_json else as_text(expected))
        sys.stdout.flush()
        say(f"the daemon ends in {options.linger_s:g} s")
        time.sleep(options.linger_s)
