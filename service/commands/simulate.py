"""`stonefall simulate`: a rig of simulated GigE Vision cameras and a light gate."""

import hashlib
import json
import os
import signal
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from enum import StrEnum
from ipaddress import AddressValueError, IPv4Address
from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import RecordingError
from drivers.files.recording import open_recording
from drivers.gige_simulator.rig import RigDesign, SimulatedRig
from service.base.errors import UsageError
from service.commands.options import Json, with_options
from service.results.version import ALGORITHM_VERSION

POLL_S = 0.1
SWITCH_INTERVAL_S = 0.0005
"""Python's default of 5 ms would delay the beam while sixteen cameras begin to send."""


class BeltStart(StrEnum):
    """Event that starts the belt."""

    AUTO = "auto"
    MANUAL = "manual"


@dataclass(frozen=True, slots=True)
class SimulateOptions:
    recording: Annotated[Path | None, typer.Argument()] = None
    """Recording that is played; default: --bodies, rendered once and kept."""
    address: str = "127.0.0.2"
    """IP address of the first camera; the others get the next ones."""
    cameras: Annotated[int | None, typer.Option(min=1)] = None
    """Number of cameras, the first ones of the recording; default: all."""
    rate: Annotated[float, typer.Option(min=0.01, max=1000)] = 4.0
    """Stones per second."""
    start: BeltStart = BeltStart.AUTO
    """auto: as soon as all cameras acquire and the gate is open; manual: on request at the control socket."""
    loop: bool = False
    """Start again at the end of the recording."""
    once: bool = False
    """Exit when everything has fallen and was sent."""
    gate_link: Path | None = None
    """Path of the gate's serial port; default: a temporary one."""
    control: Path | None = None
    """Path of the control socket; default: in a temporary folder."""
    uplink: Annotated[float | None, typer.Option(min=1)] = None
    """Rate that all cameras share behind a switch, MB/s; default: no limit."""
    gate_places: Annotated[int, typer.Option(min=0)] = 8
    """Pulses to the cameras that can wait in the gate, which makes the delay it is set to; 0: it cannot make any."""
    timer: Annotated[float, typer.Option(min=0)] = 0.0
    """Delay of a generator in the line from gate to cameras, ms."""
    seed: Annotated[int, typer.Option(min=0)] = 0
    """Equal seeds give equal clocks, faults and rendered bodies."""
    bodies: str = "stones"
    """What to render, as in `stonefall synthesize`."""
    count: Annotated[int, typer.Option(min=1, max=1000)] = 10
    """Number of bodies to render."""
    as_json: Json = False
    """Print the addresses, and counters at the end, as JSON."""


@with_options
def command(options: SimulateOptions) -> None:
    """Simulate a rig: GigE Vision cameras on loopback, a light gate on a pseudo-terminal, and a belt.

    Requests to the control socket are JSON objects, one a line: {"do": "help"} lists them.
    """
    if options.loop and options.once:
        raise typer.BadParameter("cannot be combined with --loop, which never ends", param_hint="--once")
    try:
        IPv4Address(options.address)
    except AddressValueError as err:
        raise typer.BadParameter(str(err), param_hint="--address") from err
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    source = open_recording(
        options.recording or _rendered_recording(options.bodies, options.count, options.seed)
    )
    if options.cameras is not None and options.cameras > len(source.camera_ids):
        raise UsageError(f"{source.path} has {len(source.camera_ids)} cameras, not {options.cameras}")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with tempfile.TemporaryDirectory(prefix="stonefall-simulate-") as folder:
        design = RigDesign(
            gate_link=options.gate_link or Path(folder, "gate"),
            control=options.control or Path(folder, "control"),
            first_address=options.address,
            n_cameras=options.cameras,
            rate_hz=options.rate,
            is_looping=options.loop,
            gate_places=options.gate_places,
            timer_ms=options.timer,
            uplink_bytes_s=options.uplink and options.uplink * 1e6,
            seed=options.seed,
        )
        with SimulatedRig(design, source) as rig:
            if options.start is BeltStart.AUTO:
                rig.belt.start_when(lambda: rig.is_ready)
            cameras = [camera.design for camera in rig.cameras.values()]
            addresses = {
                "cameras": [
                    {"id": each.id, "serial": each.serial, "address": each.address} for each in cameras
                ],
                "gate": str(design.gate_link),
                "control": str(design.control),
            }
            lines = [f"{each.id}  {each.address:15}  {each.serial}" for each in cameras]
            lines += [f"gate     {design.gate_link}", f"control  {design.control}"]
            typer.echo(json.dumps(addresses) if options.as_json else "\n".join(lines))
            sys.stdout.flush()
            while not (stop.wait(POLL_S) or (options.once and rig.is_over)):
                pass
    if options.as_json:
        typer.echo(json.dumps(rig.counters()))


def _rendered_recording(bodies: str, count: int, seed: int) -> Path:
    def write(path: Path) -> None:
        from service.commands import synthesize  # here: the renderer takes half a second to import

        with redirect_stdout(sys.stderr):
            synthesize.command(path, bodies=bodies, count=count, seed=seed)

    return kept_recording("recording", [bodies, count, seed], write)


def kept_recording(kind: str, made_of: Sequence[object], write: Callable[[Path], None]) -> Path:
    """Return a recording, written the first time and kept in a folder for temporary files that is this user's alone."""
    wanted = json.dumps([*made_of, ALGORITHM_VERSION])
    folder = Path(tempfile.gettempdir(), f"stonefall-{os.getuid()}")
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise UsageError(f"{folder}: is not a folder of this user; nothing in it is trusted")
    path = folder / f"{kind}-{hashlib.sha256(wanted.encode()).hexdigest()[:12]}"
    if not path.exists():
        try:
            write(path)
        except (OSError, RecordingError):
            if not path.exists():  # otherwise another process was quicker
                raise
    return path
