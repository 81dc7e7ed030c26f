"""The wiring page of a rig, for the electrician: what goes where, with a box to tick for each connection."""

from collections.abc import Mapping

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
from service.reports.letterhead import letterhead
from service.reports.wiring import GateKind, RigWiring, WiredCamera
from service.reports.wiring_drawing import speed, wiring_drawing
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
            Section(say("wiring.overview"), (Picture(wiring_drawing(rig, say)),)),
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
        pins.append(
            (say("wiring.light"), say("wiring.fired_elsewhere" if rig.has_flash else "wiring.always_on"))
        )
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
            "wiring.uplink_is", n=ports, gbit_s=speed(plan.uplink_bytes_s, say), ports=uplinks
        ),
        "wiring.link": say("wiring.link_is", n=n, gbit_s=speed(plan.link_bytes_s, say)),
        "wiring.mtu": mtu,
        "wiring.packet_delay": say("wiring.packet_delay_is", us=say.number(plan.packet_delay_ns / 1e3, 1)),
        "wiring.sent": say("wiring.sent_is", mb_s=say.number(plan.sent_bytes_s / 1e6, 0)),
        "wiring.bundle": say("wiring.bundle_is", ms=say.number(plan.bundle_ms, 1)),
        "wiring.burst": say("wiring.carried" if plan.is_carried else "wiring.not_carried"),
    }
    return [(say(key), text) for key, text in known.items()]


def _parts(rig: RigWiring, say: Words) -> Table:
    """Return the bill of materials: number, part, and what matters of it."""
    n, ports = len(rig.cameras), rig.network.n_uplinks
    has_board, fires_light = rig.gate.kind is GateKind.SERIAL, rig.gate.fires_light
    n_wired = sum(camera.trigger is not None for camera in rig.cameras)
    size = " x ".join(map(str, rig.image_size_px))
    gbit_s = speed(rig.network.uplink_bytes_s / ports, say)
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
