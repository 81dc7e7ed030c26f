"""The wiring page of a rig, for the electrician: what goes where, with a box to tick for each connection."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import ceil, cos, radians, sin

from service.base.language import Language
from service.lots.plant import PlantSettings
from service.reports.document import (
    DASH,
    Column,
    Document,
    NamesAndValues,
    Picture,
    Section,
    Signatures,
    Table,
)
from service.reports.drawing import Anchor, Drawing, Shape, Style, dot, label, line
from service.reports.letterhead import letterhead
from service.reports.words import Words, abridged, words

BOX = "☐"
BLANK = "__________"
"""Stands for what is not known yet: it is written by hand."""
LONGEST = 48
CAMERA_COLUMNS = {
    "wiring.place": 0.8,
    "wiring.layer": 1.3,
    "wiring.azimuth": 1.0,
    "wiring.serial": 2.2,
    "wiring.address": 2.8,
    "wiring.switch_port": 1.4,
    "wiring.trigger": 1.6,
    "wiring.strobe": 1.4,
    "wiring.cable": 1.6,
}
GATE_COLUMNS = {"wiring.pin": 2.0, "wiring.goes_to": 8.0, "wiring.cable": 1.2}
BEFORE = ("wiring.before_off", "wiring.before_isolated", "wiring.before_measured")
PART_COLUMNS = {"wiring.number": 0.7, "wiring.part": 3.2, "wiring.matters": 8.0, "wiring.there": 0.8}
"""Columns of each table: the word of the head, and the width."""
UPLINK_BYTES_S = 1.25e9
"""Fastest port that an uplink is made of: 10 Gb/s."""


class GateKind(StrEnum):
    """Kind of the light gate: what reads the sensor."""

    SERIAL = "serial"
    MODEM_LINE = "modem_line"
    GPIO = "gpio"


@dataclass(frozen=True, slots=True, kw_only=True)
class WiredCamera:
    """A camera with its place and its three connections."""

    place: str
    layer: int  # from the lowest, from 1
    azimuth_deg: int  # counter-clockwise from +x, seen from above
    elevation_deg: int
    switch_port: int
    serial: str | None  # None: not known yet
    address: str | None
    is_address_proposed: bool
    trigger: str | None  # its input; None: this machine triggers it over the network


@dataclass(frozen=True, slots=True, kw_only=True)
class WiredGate:
    """The light gate and where its lines go."""

    kind: GateKind
    port: str | None  # device of this machine; None: not known yet
    line: str | None = None  # modem line or GPIO line of the sensor
    test_line: str | None = None  # GPIO line of test pulses
    delay_maker: str  # camera, gate or timer
    fires_light: bool = False  # no output of a camera does, and the light flashes


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPlan:
    """The network of the cameras: addresses, uplink, and the pause after each packet."""

    interfaces: Sequence[str]  # addresses of this machine
    link_bytes_s: float  # of each camera
    uplink_bytes_s: float
    switch_buffer_bytes: int
    packet_bytes: int
    packet_delay_ns: int
    sent_bytes_s: float  # of all cameras together
    bundle_ms: float
    is_carried: bool  # two stones in the shortest time that the rig takes

    @property
    def n_uplinks(self) -> int:
        """Ports of this machine towards the switch."""
        return max(len(self.interfaces), ceil(self.uplink_bytes_s / UPLINK_BYTES_S))


@dataclass(frozen=True, slots=True, kw_only=True)
class RigWiring:
    """All that the wiring page prints."""

    file: str  # name of the configuration
    created_at: str  # RFC 3339 UTC
    language: Language
    cameras: Sequence[WiredCamera]
    image_size_px: tuple[int, int]
    focal_px: float
    gate: WiredGate
    delay_ms: float
    strobe_line: str | None
    network: NetworkPlan
    is_simulated: bool = False
    plant: PlantSettings = field(default_factory=PlantSettings)


def wiring_document(rig: RigWiring) -> Document:
    """Return the wiring page as one page of A4."""
    say = words(rig.language, rig.plant.zone)
    title = say("wiring.title", n=len(rig.cameras))
    return Document(
        language=rig.language,
        letterhead=letterhead(rig.plant, None, None, say),
        title=title,
        subtitle=say("wiring.subtitle", file=abridged(rig.file)),
        banners=[say("banner.simulated")] if rig.is_simulated else [],
        verdict=None,
        verdict_title=say("wiring.before"),
        verdict_lines=[say(key) for key in BEFORE],
        sections=(
            Section(say("wiring.overview"), (Picture(_drawing(rig, say)),)),
            Section(say("wiring.cameras"), (_cameras(rig, say),)),
            Section(say("wiring.gate"), (_gate(rig, say),)),
            Section(say("wiring.network"), (NamesAndValues(_network(rig, say)),)),
            Section(say("wiring.parts"), (_parts(rig, say),)),
            Section(say("wiring.done"), (Signatures((say("wiring.wired_by"), say("wiring.checked_by"))),)),
        ),
        footer=say("report.footer", name=title, at=say.time(rig.created_at)),
        page=say("report.page"),
        created_at=rig.created_at,
        is_sheet=True,
    )


def _columns(say: Words, widths: Mapping[str, float]) -> list[Column]:
    return [Column(say(key), is_number=False, width=width) for key, width in widths.items()]


def _cameras(rig: RigWiring, say: Words) -> Table:
    def row(camera: WiredCamera) -> list[str]:
        proposed = f" ({say('wiring.proposed')})" if camera.is_address_proposed else ""
        return [
            camera.place,
            f"{camera.layer} ({say.number(camera.elevation_deg, 0)}°)",
            f"{camera.azimuth_deg}°",
            abridged(camera.serial or BLANK, LONGEST),
            (camera.address or BLANK) + proposed,
            f"{BOX} {camera.switch_port}",
            f"{BOX} {camera.trigger}" if camera.trigger else say("wiring.over_network"),
            f"{BOX} {rig.strobe_line}" if rig.strobe_line else DASH,
            f"{BOX} ______",
        ]

    return Table(_columns(say, CAMERA_COLUMNS), [row(camera) for camera in rig.cameras])


def _gate(rig: RigWiring, say: Words) -> Table:
    """Return the pins of the gate, each with what it goes to."""
    gate, wired = rig.gate, [camera for camera in rig.cameras if camera.trigger]
    to_cameras = say(
        "wiring.to_inputs", n=len(wired), inputs=", ".join(sorted({str(each.trigger) for each in wired}))
    )
    port = abridged(gate.port or BLANK, LONGEST)
    delay = say(f"wiring_delay.{gate.delay_maker}", ms=say.number(rig.delay_ms, 1))
    pins: list[tuple[str, str]]
    match gate.kind:
        case GateKind.SERIAL:
            pins = [
                ("D8", say("wiring.sensor")),
                *([("D9", f"{to_cameras}; {delay}")] if wired else []),
                *([("D10", say("wiring.to_driver"))] if gate.fires_light else []),
                ("D13", say("wiring.lamp")),
                ("RST", say("wiring.reset")),
                ("USB", say("wiring.to_host", port=port)),
            ]
        case GateKind.MODEM_LINE:
            pins = [
                (f"{gate.line}", say("wiring.sensor")),
                ("GND", say("wiring.ground")),
                ("USB", say("wiring.to_host", port=port)),
            ]
        case GateKind.GPIO:
            pins = [
                (f"{port}: {gate.line}", say("wiring.sensor")),
                *([(f"{port}: {gate.test_line}", say("wiring.test_pulses"))] if gate.test_line else []),
                ("GND", say("wiring.ground")),
            ]
    if gate.kind is not GateKind.SERIAL and wired:
        pins.append((say("wiring.sensor_output"), to_cameras))
    if rig.strobe_line:
        pins.append((say("wiring.camera_output", line=rig.strobe_line), say("wiring.to_driver")))
    elif not gate.fires_light:
        pins.append((say("wiring.light"), say("wiring.always_on")))
    return Table(
        _columns(say, GATE_COLUMNS),
        [[pin, text, f"{BOX} ______"] for pin, text in pins],
    )


def _network(rig: RigWiring, say: Words) -> list[tuple[str, str]]:
    plan, ports = rig.network, rig.network.n_uplinks
    n = len(rig.cameras)
    mtu = say("wiring.mtu_is", bytes=9000 if plan.packet_bytes > 1500 else 1500, packets=plan.packet_bytes)
    uplinks = ", ".join(str(n + 1 + each) for each in range(ports))
    known = {
        "wiring.host": ", ".join(plan.interfaces) or BLANK,
        "wiring.uplink": say(
            "wiring.uplink_is", n=ports, gbit_s=_gbit_s(plan.uplink_bytes_s, say), ports=uplinks
        ),
        "wiring.link": say("wiring.link_is", n=n, gbit_s=_gbit_s(plan.link_bytes_s, say)),
        "wiring.mtu": mtu,
        "wiring.packet_delay": say("wiring.packet_delay_is", us=say.number(plan.packet_delay_ns / 1e3, 1)),
        "wiring.sent": say("wiring.sent_is", mb_s=say.number(plan.sent_bytes_s / 1e6, 0)),
        "wiring.bundle": say("wiring.bundle_is", ms=say.number(plan.bundle_ms, 1)),
        "wiring.burst": say("wiring.carried" if plan.is_carried else "wiring.not_carried"),
    }
    return [(say(key), text) for key, text in known.items()]


def _gbit_s(bytes_s: float, say: Words) -> str:
    return say.size(bytes_s / 125e6)


def _parts(rig: RigWiring, say: Words) -> Table:
    """Return the bill of materials: number, part, and what matters of it."""
    n, ports = len(rig.cameras), rig.network.n_uplinks
    has_board, fires_light = rig.gate.kind is GateKind.SERIAL, rig.gate.fires_light
    n_wired = sum(camera.trigger is not None for camera in rig.cameras)
    size = " x ".join(map(str, rig.image_size_px))
    gbit_s = _gbit_s(rig.network.uplink_bytes_s / ports, say)
    buffer_kb = say.number(rig.network.switch_buffer_bytes / 1024, 0)
    parts = [
        (n, "wiring.camera", say("wiring.camera_is", size=size)),
        (
            n,
            "wiring.lens",
            say("wiring.lens_is", px=say.number(rig.focal_px, 0), mm=say.number(rig.focal_px * 0.004, 0)),
        ),
        (1, "wiring.switch", say("wiring.switch_is", n=n, ports=ports, gbit_s=gbit_s, kb=buffer_kb)),
        (ports, "wiring.card", say("wiring.card_is", gbit_s=gbit_s)),
        (n + ports, "wiring.network_cable", say("wiring.network_cable_is")),
        (n_wired, "wiring.trigger_cable", say("wiring.trigger_cable_is")),
        (1, "wiring.sensor_part", say("wiring.sensor_is")),
        (1 if has_board else 0, "wiring.board", say("wiring.board_is")),
        ((2 if fires_light else 1) if has_board and n_wired else 0, "wiring.driver", say("wiring.driver_is")),
        (1, "wiring.light", say("wiring.light_is")),
        (1, "wiring.supply", say("wiring.supply_is")),
    ]
    rows = [[str(number), say(key), text, BOX] for number, key, text in parts if number]
    return Table(_columns(say, PART_COLUMNS), rows)


WIDTH, HEIGHT = 600.0, 232.0
CENTER, OUTER = (112.0, 128.0), 92.0


def _drawing(rig: RigWiring, say: Words) -> Drawing:
    """Return the places seen from above, and beside them what is connected to what."""
    return Drawing(
        width=WIDTH,
        height=HEIGHT,
        title=say("wiring.overview"),
        description=say("wiring.drawing"),
        shapes=[*_places(rig, say), *_connections(rig, say)],
    )


def _places(rig: RigWiring, say: Words) -> list[Shape]:
    """Return the cameras on a ring for each layer, the lowest outside."""
    (x0, y0), n_layers = CENTER, max(camera.layer for camera in rig.cameras)
    shapes = [label((4, 12), say("wiring.from_above"))]
    for layer in range(1, n_layers + 1):
        ring = [_at(layer, n_layers, degrees) for degrees in range(0, 361, 5)]
        shapes.append(line(ring, Style.GRID))
    shapes += [line(((x0, y0), (x0 + OUTER + 8, y0)), Style.GRID), label((x0 + OUTER + 10, y0 + 4), "0°")]
    for camera in rig.cameras:
        x, y = _at(camera.layer, n_layers, camera.azimuth_deg)
        shapes += [dot((x, y), 2.5, Style.CURVE), label((x, y - 5), camera.place, Anchor.MIDDLE)]
    return shapes


def _at(layer: int, n_layers: int, azimuth_deg: float) -> tuple[float, float]:
    radius = OUTER * (1 - 0.7 * (layer - 1) / max(n_layers - 1, 1))
    return CENTER[0] + radius * cos(radians(azimuth_deg)), CENTER[1] - radius * sin(radians(azimuth_deg))


def _connections(rig: RigWiring, say: Words) -> list[Shape]:
    """Return the devices as boxes, each line between them with its name."""
    n, gate = len(rig.cameras), rig.gate
    left, right, width, height = 246.0, 446.0, 116.0, 34.0
    rows = {"sensor": 14.0, "gate": 96.0, "host": 178.0}
    shapes: list[Shape] = []

    def device(x: float, y: float, *texts: str) -> None:
        corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y))
        shapes.append(line(corners, Style.FRAME))
        middle = y + height / 2 + 4 - 6.5 * (len(texts) - 1)
        shapes.extend(
            label((x + width / 2, middle + 13 * number), text, Anchor.MIDDLE)
            for number, text in enumerate(texts)
        )

    def wire(x0: float, y0: float, x1: float, y1: float, text: str) -> None:
        shapes.append(line(((x0, y0), (x1, y1)), Style.CURVE))
        if y0 == y1:
            shapes.append(label(((x0 + x1) / 2, y0 - 4), text, Anchor.MIDDLE))
        else:
            shapes.append(label((x0 + 4, (y0 + y1) / 2 + 4), text))

    device(left, rows["sensor"], say("wiring.box_sensor"))
    device(left, rows["gate"], say("wiring.box_gate"))
    device(left, rows["host"], say("wiring.box_host"))
    device(right, rows["sensor"], say("wiring.box_light"))
    device(right, rows["gate"], say("wiring.box_cameras", n=n))
    device(right, rows["host"], say("wiring.box_switch"))
    below, middle = left + width / 2, height / 2
    first = {GateKind.SERIAL: "D8"}.get(gate.kind, gate.line or "")
    wire(below, rows["sensor"] + height, below, rows["gate"], first)
    wire(
        below, rows["gate"] + height, below, rows["host"], "USB" if gate.kind is not GateKind.GPIO else "GPIO"
    )
    inputs = sorted({camera.trigger for camera in rig.cameras if camera.trigger})
    if inputs:
        output = "D9" if gate.kind is GateKind.SERIAL else say("wiring.box_sensor")
        wire(left + width, rows["gate"] + middle, right, rows["gate"] + middle, f"{output} → {inputs[0]}")
    if gate.fires_light:
        wire(left + width, rows["gate"] + 6, right, rows["sensor"] + height - 6, "")
        shapes.append(label((left + width + 8, rows["gate"] - 18), "D10"))
    below = right + width / 2
    if rig.strobe_line:
        wire(below, rows["gate"], below, rows["sensor"] + height, rig.strobe_line)
    wire(
        below,
        rows["gate"] + height,
        below,
        rows["host"],
        say("wiring.link_is", n=n, gbit_s=_gbit_s(rig.network.link_bytes_s, say)),
    )
    uplink = say("wiring.speed", gbit_s=_gbit_s(rig.network.uplink_bytes_s, say))
    wire(left + width, rows["host"] + middle, right, rows["host"] + middle, uplink)
    return shapes
