"""`stonefall init` and `check-config`: the configuration of a rig, asked for and written; printed, and its faults."""

import json
import os
import re
import stat
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import jinja2
import tomli_w
import typer

from drivers.files.durable import write_file
from drivers.files.rig_file import read_rig, write_rig
from drivers.gates.serial_gate import SerialGateSettings
from drivers.gvcp import DiscoveredCamera, discover, local_addresses
from pipeline.frames import CameraId
from pipeline.rig.design import nominal_rig
from service.base.errors import SettingsError, UsageError
from service.base.language import Language
from service.base.tables.files import NamedColumn, read_rows
from service.commands.cameras import ipv4_address
from service.commands.options import DensityOptions, with_options
from service.commands.wiring import write_wiring
from service.configuration.camera_wire import UPLINK_BYTES_S, CameraWire, Carried
from service.configuration.live_rig import DelayMaker, GateSettings
from service.configuration.rig_checks import PLACEHOLDER, PLACEHOLDER_PORT, carried_by, rig_warnings
from service.configuration.rig_settings import AravisRigSettings, CameraPlace
from service.configuration.settings import (
    Settings,
    SpoolSettings,
    StoreSettings,
    load_settings,
    problems,
    shortcomings,
)
from service.host.host import ROOT, host_at
from service.host.network import links_bytes_s

TEMPLATE = Path(__file__).with_name("stonefall.toml.jinja")
GATES = Path("/dev/serial/by-id")
ROUNDED = re.compile(r"[0-9][.,][0-9]+E\+[0-9]+", re.IGNORECASE)
"""Serial number of twelve digits or more as a spreadsheet saves it."""
COLUMNS = {
    "id": NamedColumn(("id", "place", "camera", "platz", "kamera")),
    "serial": NamedColumn(("serial", "serial_number", "serial_no", "seriennummer")),
    "address": NamedColumn(("address", "ip", "ip_address", "adresse", "ip_adresse")),
    "user_name": NamedColumn(("user_name", "username", "name")),
}


@dataclass(frozen=True, slots=True)
class InitOptions:
    file: Annotated[Path, typer.Argument()]
    """Configuration file to write, such as /etc/stonefall/stonefall.toml."""
    interface: Annotated[list[str] | None, typer.Option(metavar="IP", parser=ipv4_address)] = None
    """Address of this machine towards the cameras; may be repeated."""
    camera: Annotated[list[str] | None, typer.Option(metavar="PLACE=SERIAL")] = None
    """Serial number of the camera in a place, such as c01=12345; may be repeated."""
    cameras: Path | None = None
    """Table (CSV or XLSX) with the columns id and serial, address or user_name, in the place of --camera."""
    uplink: Annotated[float | None, typer.Option(metavar="GBIT_S", min=0.1, max=1000)] = None
    """Speed of this machine's links towards the cameras together, Gb/s; default: as their ports say."""
    gate: str | None = None
    """Port of a light gate with a serial line."""
    strobe_line: Annotated[str | None, typer.Option(metavar="LINE")] = None
    """Output of the cameras that fires the light panels, such as Line2."""
    delay: DelayMaker | None = None
    """What makes the delay from gate to exposure; with gate or timer more than four stones a second can be measured."""
    flash_us: Annotated[float | None, typer.Option(min=0.1)] = None
    """Light of one flash, if shorter than the exposure of 20 us."""
    store: Path = Path("/var/lib/stonefall")
    """Folder for results."""
    spool: Path = Path("/run/stonefall")
    """Folder on tmpfs for bundles."""
    product: str | None = None
    """Name of the product, for the steps that are printed."""
    simulated: bool = False
    """The rig is a simulated one."""
    force: bool = False
    """Replace the file."""
    wiring: bool = False
    """Write the wiring page of the rig beside the file, wiring.svg and wiring.pdf; alone it leaves that as it is."""
    language: Language = Language.ENGLISH
    """Language of the wiring page."""


@with_options
def command(options: InitOptions, density: DensityOptions) -> None:
    """Write a configuration with comments, and say what is missing in it and what to do next; exit 0 if nothing is.

    On a terminal, and without --wiring, it asks for what no option says. Cameras that answer are entered in any order
    when there is one for each place. A rig file that is there is kept; without one the design is written, until the rig
    is calibrated. An installed example that has nothing of this site yet is replaced.
    """
    is_page_alone = options == InitOptions(file=options.file, wiring=True, language=options.language)
    if options.file.exists() and not options.force:
        if is_page_alone:
            _print_wiring(options)
            return
        if not _is_example(options.file):
            raise UsageError(f"{options.file}: exists already; --force replaces it")
    is_asked = sys.stdin.isatty() and not options.wiring  # who wires has no answers yet
    interfaces = tuple(options.interface or (_asked_interfaces() if is_asked else ()))
    rig_file = options.file.resolve().parent / "rig.json"
    rig = read_rig(rig_file) if rig_file.exists() else nominal_rig()
    named = (
        _from_table(options.cameras) if options.cameras is not None else _from_options(options.camera or [])
    )
    if unknown := sorted(named.keys() - set(rig.camera_ids)):
        raise UsageError(f"{', '.join(unknown)}: no place of the rig, which has {', '.join(rig.camera_ids)}")
    if not named:
        found = discover(interfaces or None)
        networks = ", ".join(interfaces or local_addresses())
        typer.echo(f"{len(found)} cameras answer on the networks of {networks}")
        named = _placed(rig.camera_ids, found, is_asked=is_asked)
    gate = options.gate or _found_gate(is_asked=is_asked)
    strobe_line, flash_us = options.strobe_line, options.flash_us
    if is_asked and strobe_line is None and flash_us is None:
        strobe_line = _asked(
            "output of the cameras that fires the light panels, such as Line2 (- if they are always on)"
        )
        if strobe_line is not None:
            flash_us = _asked_number("light of one flash, us (0 if as long as the exposure of 20)", most=20)
    uplink_bytes_s = options.uplink * 125e6 if options.uplink else _found_uplink(interfaces)
    wire = CameraWire(
        n_cameras=len(rig.cameras),
        image_bytes=max(width * height for width, height in (camera.image_size_px for camera in rig.cameras)),
        uplink_bytes_s=uplink_bytes_s or UPLINK_BYTES_S,
    )
    density_kg_m3 = density.given_kg_m3
    if is_asked and density_kg_m3 is None:
        density_kg_m3 = _asked_number("density of the particles, kg/m3, such as 2700 (0 if it is not known)")
    environment = jinja2.Environment(  # noqa: S701 - TOML, not HTML
        trim_blocks=True, keep_trailing_newline=True, undefined=jinja2.StrictUndefined
    )
    # what is None is not known: a comment with an example, or MISSING
    text = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        line=_line,
        interfaces=interfaces,
        cameras=named,
        places=rig.camera_ids,
        gate=gate,
        delay=options.delay and options.delay.value,
        uplink_bytes_s=uplink_bytes_s,
        example_bytes_s=UPLINK_BYTES_S,
        packet_delay_ns=wire.paced().packet_delay_ns,
        strobe_line=strobe_line,
        flash_us=flash_us,
        calibration=rig_file,
        spool=options.spool.resolve(),
        store=options.store.resolve(),
        density_kg_m3=density_kg_m3,
        is_simulated=options.simulated,
    )
    options.file.parent.mkdir(parents=True, exist_ok=True)
    if not rig_file.exists():
        write_rig(rig_file, rig)
        typer.echo(f"{rig_file}: the rig's design, until it is calibrated")
    earlier = options.file.stat() if options.file.exists() else None
    write_file(options.file, text.encode())
    if earlier is not None:  # as the installed example, which the service may read and nobody else
        os.chown(options.file, earlier.st_uid, earlier.st_gid)
        options.file.chmod(stat.S_IMODE(earlier.st_mode))
    if options.wiring:
        _print_wiring(options)
    missing = _missing(options.file, [place for place in rig.camera_ids if place not in named], gate)
    typer.echo(
        f"{options.file}: {'written; nothing is missing' if not missing else 'written, and not ready:'}"
    )
    for each in missing:
        typer.echo(f"  - {each}")
    typer.echo(_next_steps(options.file, options.product, density_kg_m3))
    if missing:
        raise typer.Exit(1)


def _print_wiring(options: InitOptions) -> None:
    pages = write_wiring(options.file, options.language)
    typer.echo(f"{' and '.join(map(str, pages))}: the wiring page")


def _is_example(file: Path) -> bool:
    """True when a file has placeholders and defaults alone, as the installed example: nothing of this site is lost."""
    try:
        settings = load_settings(file)
    except SettingsError:
        return False
    rig = settings.rig
    if not isinstance(rig, AravisRigSettings):
        return False
    if not all(PLACEHOLDER.fullmatch(camera.serial or "") for camera in rig.cameras):
        return False
    cameras = tuple(CameraPlace(id=camera.id, serial=camera.serial) for camera in rig.cameras)
    gate = GateSettings(serial=SerialGateSettings(port=PLACEHOLDER_PORT))
    untouched = AravisRigSettings(backend="aravis", calibration=rig.calibration, cameras=cameras, gate=gate)
    spool, store = SpoolSettings(dir=settings.spool.dir), StoreSettings(dir=settings.store.dir)
    return settings == Settings(rig=untouched, spool=spool, store=store)


def check_config_command(
    file: Annotated[Path, typer.Argument(help="Configuration file, see deploy/stonefall.toml.")],
    as_json: Annotated[
        bool, typer.Option("--json", help="Print settings, problems, warnings, and the URL here as JSON.")
    ] = False,
) -> None:
    """Print all settings of a configuration file, defaults included, and what is wrong; exit 0 if nothing is.

    A warning names a setting that is allowed but rarely intended; it is no fault.
    """
    try:
        settings = load_settings(file)
    except SettingsError as err:
        if as_json:
            typer.echo(json.dumps({"settings": None, "problems": [str(err)], "warnings": []}, indent=2))
        raise
    wrong = _wrong(settings)
    doubtful = list(rig_warnings(settings.rig, settings.bundling))
    network = carried_by(settings.rig, settings.bundling)
    if as_json:
        said = {
            "settings": settings.model_dump(mode="json"),
            "problems": wrong,
            "warnings": doubtful,
            "network": [asdict(each) for each in network],
        }
        typer.echo(json.dumps({"url": settings.api.local_url, **said}, indent=2))
    else:
        typer.echo("\n".join([*_sections(settings), *_network(network)]))
        for problem in [*wrong, *(f"warning: {each}" for each in doubtful)]:
            typer.echo(f"stonefall: {file}: {problem}", err=True)
    if wrong:
        raise typer.Exit(1)


def _sections(settings: Settings) -> Iterator[str]:
    """Yield each section as TOML that can be read again; settings without a value are comments below its header."""
    known = settings.model_dump(mode="json", exclude_none=True)
    for name, values in settings.model_dump(mode="json").items():
        if values is None:
            yield f"# [{name}] is not set\n"
            continue
        header, *lines = tomli_w.dumps({name: known[name]}).splitlines()
        unset = [f"# {key} is not set" for key, value in values.items() if value is None]
        yield "\n".join([header, *unset, *lines, ""])


def _network(network: Sequence[Carried]) -> Iterator[str]:
    """Yield the load of the cameras' network as comments, at the most that the rig takes and at common rates."""
    for most in network[:1]:
        yield (
            f"# network: a bundle is {most.bundle_ms:.1f} ms on the wire, of which at most"
            f" {most.queued_bytes / 1e6:.2f} MB wait in the switch"
        )
        yield f"# two stones {1e3 / most.rate_hz:.0f} ms apart: {'carried' if most.is_burst_carried else 'not carried'}"
        loads = ", ".join(f"{each.load:.0%} at {each.rate_hz:.3g}" for each in network)
        yield f"# load: {loads} stones/s; the first is the most that this rig takes\n"


def _from_options(given: Sequence[str]) -> dict[str, CameraPlace]:
    named: dict[str, CameraPlace] = {}
    for each in given:
        place, separator, serial = each.partition("=")
        if not (place and separator and serial):
            raise UsageError(f"--camera {each}: must be PLACE=SERIAL, such as c01=12345")
        if place in named:
            raise UsageError(f"--camera {each}: {place} is there twice")
        named[place] = _place(place, serial)
    return named


def _from_table(path: Path) -> dict[str, CameraPlace]:
    columns, rows = read_rows(path, COLUMNS, ("id",))
    named: dict[str, CameraPlace] = {}
    for row in rows:
        given = {name: row.at(column.number) or None for name, column in columns.items()}
        place, serial, address, user_name = (given.get(name) for name in COLUMNS)
        if place is None or place in named or not (serial or address or user_name):
            raise UsageError(f"{row.place}: needs an id of its own, and a serial, address or user_name")
        if serial is not None and ROUNDED.fullmatch(serial):
            raise UsageError(
                f"{row.place}: serial {serial} was rounded by a spreadsheet: make its column text"
            )
        named[place] = CameraPlace(id=CameraId(place), serial=serial, address=address, user_name=user_name)
    return named


def _placed(
    places: Sequence[str], found: Sequence[DiscoveredCamera], *, is_asked: bool
) -> dict[str, CameraPlace]:
    """Assign cameras to places: by their user names, else in the order of their addresses."""
    by_name = {device.user_name: device for device in found if device.user_name in places}
    others = iter(device for device in found if device.user_name not in places)
    suggested = {place: by_name.get(place) or next(others, None) for place in places}
    if not is_asked:
        if len(found) != len(places) or not all(suggested.values()):
            return {}
        return {place: _place(place, device.serial) for place, device in suggested.items() if device}
    for device in found:
        typer.echo(
            f"  {device.serial:20} {device.address:15} {device.user_name} ({device.vendor} {device.model})"
        )
    answers = {
        place: _asked(
            f"serial number of camera {place} (- if there is none yet)", device.serial if device else None
        )
        for place, device in suggested.items()
    }
    return {place: _place(place, serial) for place, serial in answers.items() if serial is not None}


def _place(place: str, serial: str) -> CameraPlace:
    return CameraPlace(id=CameraId(place), serial=serial)


def _asked(question: str, default: str | None = None) -> str | None:
    """Ask a question, to which `-` is no answer."""
    said: str = typer.prompt(question, default=default or "-")
    return None if said == "-" else said


def _asked_interfaces() -> Sequence[str]:
    typer.echo(f"this machine has the addresses {', '.join(local_addresses())}")
    said = _asked("addresses towards the cameras, separated by spaces (- for all)") or ""
    return [ipv4_address(each) for each in said.replace(",", " ").split()]


def _found_gate(*, is_asked: bool) -> str | None:
    ports = sorted(map(str, GATES.glob("*")))
    if not is_asked:
        return ports[0] if len(ports) == 1 else None
    for port in ports:
        typer.echo(f"  {port}")
    return _asked("port of the light gate (- if there is none yet)", ports[0] if ports else None)


def _found_uplink(interfaces: Sequence[str]) -> float | None:
    """Return the speed of the ports with these addresses together, bytes/s; None where one does not say it."""
    host = host_at(ROOT)
    return links_bytes_s(host, {port for address in interfaces for port in host.interfaces_to(address)})


def _asked_number(question: str, most: float = 1e5) -> float | None:
    while not 0 <= (number := typer.prompt(question, type=float, default=0.0)) <= most:
        typer.echo(f"it must be from 0 to {most:g}")
    return number or None


def _line(name: str, value: Any, example: Any = None) -> str:
    """Return a setting as TOML; without a value the example, as a comment."""
    known = example if value is None else value
    text = tomli_w.dumps({name: str(known) if isinstance(known, Path) else known}).rstrip()
    return f"# {text}" if value is None else text


def _missing(file: Path, absent: Sequence[str], gate: str | None) -> list[str]:
    """Return the missing and the wrong settings."""
    missing = [f"rig.cameras: no camera for {', '.join(absent)}"] if absent else []
    if gate is None:
        missing.append(
            f"rig.gate: no light gate; {GATES} has {len(list(GATES.glob('*')))} ports: say --gate PORT"
        )
    if missing:
        return missing
    try:
        settings = load_settings(file)
    except SettingsError as err:
        return [str(err)]
    return _wrong(settings)


def _wrong(settings: Settings) -> list[str]:
    return [*problems(settings), *shortcomings(settings)]


def _next_steps(file: Path, product: str | None, density_kg_m3: float | None) -> str:
    density = f"{density_kg_m3:g}" if density_kg_m3 else "KG_M3"
    return f"""
Next:
  1. stonefall check-config {file}
  2. stonefall doctor --config {file} --pulse       host, cameras, gate, exposure and light, each fault with its remedy
  3. systemctl enable --now stonefall               or: stonefall serve --config {file}
  4. which camera is where: open /setup#places on a tablet at the rig, or compare the pictures of /cameras
  5. calibrate; it takes a quarter of an hour, with a matte ball whose diameter you know:
       stonefall calibration start --ball-diameter-mm 10 --by NAME --follow
       drop the ball twenty times through the whole field of view; each drop is printed
       stonefall calibration solve 0002             if it says where drops are missing: drop there, solve again
       stonefall calibration accept 0002 --by NAME
       stonefall calibration activate 0002 --by NAME
       stonefall calibration verify --diameter-mm 15 --count 5      with another ball: exit 0 if it is right
  6. stonefall lots product {product or "PRODUCT"} --density-kg-m3 {density}
  7. stonefall keys create mes --scope read --config {file}     before [api] host is an address of the network"""
