"""The wiring of a rig: what its configuration says, and what it leaves open, for the electrician's page."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import ceil

from service.base.language import Language
from service.lots.plant import PlantSettings

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
    fires_light: bool = False  # with the pulse that it delays itself


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
    has_flash: bool
    network: NetworkPlan
    is_simulated: bool = False
    plant: PlantSettings = field(default_factory=PlantSettings)
