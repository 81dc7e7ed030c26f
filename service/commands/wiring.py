"""The wiring page of `stonefall init --wiring`: what a configuration says of a rig, and what it leaves open."""

from collections.abc import Iterator, Sequence
from ipaddress import IPv4Address, IPv4Network
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from drivers.files.durable import write_file
from drivers.files.rig_file import read_rig
from drivers.files.times import utc_now
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from service.base.errors import UsageError
from service.base.language import Language
from service.base.settings_file import read_toml
from service.bundling.window import BundlingSettings
from service.configuration.camera_wire import carried
from service.configuration.live_rig import DelayMaker, GateSettings
from service.configuration.rig_checks import PLACEHOLDER, PLACEHOLDER_PORT
from service.configuration.rig_settings import AravisRigSettings, CameraPlace
from service.configuration.settings import wrong_rig_fields
from service.lots.plant import PlantSettings
from service.reports.printed import pdf_of, svg_of
from service.reports.wiring import GateKind, NetworkPlan, RigWiring, WiredCamera, WiredGate
from service.reports.wiring_sheet import wiring_document

LAYER_GAP_DEG = 10.0
"""Cameras whose elevations differ by less are of one layer."""
FIRST_HOST = 11
"""Last byte of the address that is proposed for the first camera."""


def write_wiring(file: Path, language: Language) -> Sequence[Path]:
    """Write the wiring page of a configuration beside it, as SVG and PDF; return both files.

    Raises `UsageError` when the file has no live rig that can be read.
    """
    document = wiring_document(rig_wiring(file, language))
    pages = {"svg": svg_of(document), "pdf": pdf_of(document)}
    written = [file.resolve().with_name(f"wiring.{suffix}") for suffix in pages]
    for path, page in zip(written, pages.values(), strict=True):
        write_file(path, page)
    return written


def rig_wiring(file: Path, language: Language) -> RigWiring:
    """Return the wiring of the rig of a configuration; cameras and gate that it does not name yet are left open."""
    document = read_toml(file)
    settings, rig = _rig(file, document)
    wire = settings.wire_for(rig)
    most = carried(wire, 1.0, settings.bundling_for(BundlingSettings()).dead_time_ms)
    return RigWiring(
        file=str(file),
        created_at=utc_now(),
        language=language,
        cameras=tuple(_cameras(settings, rig)),
        image_size_px=rig.cameras[0].image_size_px,
        focal_px=float(np.mean([camera.K[0, 0] for camera in rig.cameras])),
        gate=_gate(settings),
        delay_ms=settings.trigger_delay_ms,
        strobe_line=settings.strobe_line,
        has_flash=settings.has_flash,
        network=NetworkPlan(
            interfaces=settings.interfaces,
            link_bytes_s=wire.link_bytes_s,
            uplink_bytes_s=wire.uplink_bytes_s,
            switch_buffer_bytes=wire.buffer_bytes,
            packet_bytes=wire.packet_bytes,
            packet_delay_ns=wire.packet_delay_ns,
            sent_bytes_s=wire.sent_bytes_s,
            bundle_ms=wire.bundle_ms,
            is_carried=most.is_burst_carried,
        ),
        is_simulated=settings.is_simulated,
        plant=TypeAdapter(PlantSettings).validate_python(
            document.get("plant", {}), context={"folder": file.parent}
        ),
    )


def _rig(file: Path, document: dict[str, Any]) -> tuple[AravisRigSettings, RigCalibration]:
    """Return the rig's settings, with placeholders where nothing is known yet, and its rig file or else the design."""
    given = dict(document.get("rig", {}))
    if given.get("backend") != "aravis":
        raise UsageError(f'{file}: rig.backend is not "aravis": only a live rig is wired')
    folder = file.resolve().parent
    rig_file = folder / str(given.get("calibration", ""))
    rig = read_rig(rig_file) if rig_file.is_file() else nominal_rig()
    known = {each.get("id") for each in given.get("cameras", ())}
    missing = (name for name in rig.camera_ids if name not in known)
    placeholders = [{"id": name, "serial": f"SERIAL-{1000 + n}"} for n, name in enumerate(missing)]
    given["cameras"] = [*given.get("cameras", ()), *placeholders]
    given.setdefault("gate", {"serial": {"port": PLACEHOLDER_PORT}})
    try:
        settings = TypeAdapter(AravisRigSettings).validate_python(given, context={"folder": folder})
    except ValidationError as err:
        raise UsageError(f"{file}: {wrong_rig_fields(err)}") from None
    if unknown := sorted({camera.id for camera in settings.cameras} - set(rig.camera_ids)):
        raise UsageError(f"{file}: rig.cameras: {', '.join(unknown)}: no place of {rig_file}")
    return settings, rig


def _cameras(settings: AravisRigSettings, rig: RigCalibration) -> Iterator[WiredCamera]:
    centers = {camera.id: camera.center_mm for camera in rig.cameras}
    elevations = {
        name: float(np.rad2deg(np.arctan2(z, np.hypot(x, y)))) for name, (x, y, z) in centers.items()
    }
    ascending = sorted(elevations.values())
    starts = [now for before, now in pairwise(ascending) if now - before > LAYER_GAP_DEG]
    is_wired = settings.trigger not in ("software", "action")
    places = sorted(settings.cameras, key=lambda each: rig.camera_ids.index(each.id))
    proposals = _proposed(settings.interfaces, places)
    for number, place in enumerate(places):
        x, y, _ = centers[place.id]
        yield WiredCamera(
            place=place.id,
            layer=1 + sum(elevations[place.id] >= start for start in starts),
            azimuth_deg=round(float(np.rad2deg(np.arctan2(y, x)))) % 360,
            elevation_deg=round(elevations[place.id]),
            switch_port=number + 1,
            serial=None if PLACEHOLDER.fullmatch(place.serial or "") else place.serial,
            address=place.address or proposals.get(place.id),
            is_address_proposed=place.address is None and place.id in proposals,
            trigger=(place.trigger or settings.trigger) if is_wired else None,
        )


def _proposed(interfaces: Sequence[str], places: Sequence[CameraPlace]) -> dict[str, str]:
    """Return an address for each camera without one, in the /24 networks of this machine, an equal share in each."""
    taken = {*interfaces, *(place.address for place in places)}
    proposed: dict[str, str] = {}
    for number, address in enumerate(interfaces):
        first, end = (len(places) * part // len(interfaces) for part in (number, number + 1))
        hosts = IPv4Network(f"{address}/24", strict=False).hosts()
        free = (str(host) for host in hosts if _is_free(host, taken))
        open_places = [place.id for place in places[first:end] if place.address is None]
        proposed |= dict(zip(open_places, free, strict=False))
    return proposed


def _is_free(host: IPv4Address, taken: set[str | None]) -> bool:
    return host.packed[-1] >= FIRST_HOST and str(host) not in taken


def _gate(settings: AravisRigSettings) -> WiredGate:
    maker = settings.delay_is_made_by
    fires_light = maker is DelayMaker.GATE and settings.flash_us is not None and settings.strobe_line is None
    match settings.gate:
        case GateSettings(serial=serial) if serial is not None:
            port = None if serial.port == PLACEHOLDER_PORT else serial.port
            return WiredGate(kind=GateKind.SERIAL, port=port, delay_maker=maker, fires_light=fires_light)
        case GateSettings(modem_line=modem) if modem is not None:
            return WiredGate(kind=GateKind.MODEM_LINE, delay_maker=maker, port=modem.port, line=modem.line)
        case GateSettings(gpio=gpio) if gpio is not None:
            test_line = None if gpio.test_line is None else str(gpio.test_line)
            return WiredGate(
                kind=GateKind.GPIO,
                delay_maker=maker,
                port=gpio.chip,
                line=str(gpio.line),
                test_line=test_line,
            )
    raise AssertionError(settings.gate)
