"""The drawing of the wiring page: the places of the cameras seen from above, and what is connected to what."""

from math import cos, radians, sin

from service.reports.drawing import Anchor, Drawing, Shape, Style, dot, label, line
from service.reports.wiring import GateKind, RigWiring
from service.reports.words import Words

WIDTH, HEIGHT = 600.0, 232.0
CENTER, OUTER = (112.0, 128.0), 92.0


def wiring_drawing(rig: RigWiring, say: Words) -> Drawing:
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

    def device(x: float, y: float, text: str) -> None:
        corners = ((x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y))
        shapes.append(line(corners, Style.FRAME))
        shapes.append(label((x + width / 2, y + height / 2 + 4), text, Anchor.MIDDLE))

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
        say("wiring.link_is", n=n, gbit_s=speed(rig.network.link_bytes_s, say)),
    )
    uplink = say("wiring.speed", gbit_s=speed(rig.network.uplink_bytes_s, say))
    wire(left + width, rows["host"] + middle, right, rows["host"] + middle, uplink)
    return shapes


def speed(bytes_s: float, say: Words) -> str:
    """Return the speed of a link in Gb/s, without the unit."""
    return say.size(bytes_s / 125e6)
