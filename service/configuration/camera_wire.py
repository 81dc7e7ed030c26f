"""The wire from the cameras to this machine: what a bundle of images takes of it, and what it can carry.

All cameras expose together and send together, each over a link of its own; behind the switch they share the uplink.
What comes faster than the uplink takes it waits in the switch, and is lost where its buffer ends. A pause after each
packet (`GevSCPD`) slows the cameras down to what the uplink takes; meanwhile the next frame waits in its camera.

`python -m service.configuration.camera_wire` prints the table of deploy/README.md.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil

LINK_BYTES_S = 125e6
"""Speed of a camera's link: 1 Gb/s."""
UPLINK_BYTES_S = 2.5e9
"""Speed of this machine's ports where the configuration says nothing: 2 x 10 Gb/s."""
BUFFER_BYTES = 512 << 10
"""Memory of a small switch for packets that wait for the uplink; its data sheet says it."""
PACKET_BYTES = 8192
ETHERNET_BYTES = 38
"""Preamble, header, checksum and gap of a packet on the wire (IEEE 802.3)."""
HEADER_BYTES = 48
"""Headers of IP, UDP and of images (GigE Vision 2.0, with block numbers of 64 bits), which a packet's size includes."""
N_AROUND = 2
"""Leader and trailer of a frame, each a packet of its own."""
UPLINK_SHARE = 0.9
"""Share of the uplink that images may take; the rest is for packets that are sent again, and for control."""
DELAY_STEP_NS = 100
"""Step to which a packet delay is rounded up."""
LARGEST_PACKET_BYTES = 9000
"""Largest size of packets that are negotiated; the smallest is 1500."""
BURST_MS = 25.0
"""Shortest time between two stones of which the first has left the picture."""
MOST_LOAD = 0.5
"""Greatest load of the uplink: a bundle of stones that fall at random waits for half a bundle's time on average.

Beyond it waiting grows steeply (M/D/1 queue), in cameras that hold few frames, and past the window of a bundle.
"""
RATES_HZ = (4, 10, 13)
"""Stones a second of the table: with the delay in the cameras, the goal, the most clean ones of random feeding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraWire:
    """The cameras' links, the switch, and the uplink to this machine."""

    n_cameras: int
    image_bytes: int  # of one camera
    link_bytes_s: float = LINK_BYTES_S  # of one camera
    uplink_bytes_s: float = UPLINK_BYTES_S  # of all
    buffer_bytes: int = BUFFER_BYTES  # of the switch, for packets that wait for the uplink
    packet_bytes: int = PACKET_BYTES
    packet_delay_ns: int = 0

    @property
    def n_packets(self) -> int:
        """Packets of a frame."""
        return ceil(self.image_bytes / (self.packet_bytes - HEADER_BYTES)) + N_AROUND

    @property
    def frame_bytes(self) -> int:
        """All that a frame puts on the wire."""
        return self.image_bytes + self.n_packets * (HEADER_BYTES + ETHERNET_BYTES)

    @property
    def packet_s(self) -> float:
        """Time from packet to packet of one camera."""
        return self._wire_bytes / self.link_bytes_s + self.packet_delay_ns / 1e9

    @property
    def sent_bytes_s(self) -> float:
        """Rate at which all cameras together send."""
        return self.n_cameras * self._wire_bytes / self.packet_s

    @property
    def frame_ms(self) -> float:
        """Time for which a camera sends a frame; the next one waits for its end."""
        return self.frame_bytes / self.link_bytes_s * 1e3 + self.n_packets * self.packet_delay_ns / 1e6

    @property
    def bundle_ms(self) -> float:
        """Time of a bundle on the wire: until the last camera has sent, and the uplink has taken it."""
        return max(self.frame_ms, self.n_cameras * self.frame_bytes / self.uplink_bytes_s * 1e3)

    def queued_bytes(self, spacing_ms: float = BURST_MS) -> float:
        """Return the most that waits in the switch while two bundles follow each other; all cameras send in step."""
        together = self.n_cameras * self._wire_bytes
        taken = self.uplink_bytes_s * self.packet_s
        one = together + (self.n_packets - 1) * max(0.0, together - taken)
        pause_s = max(self.packet_s, spacing_ms / 1e3 - (self.n_packets - 1) * self.packet_s)
        return one + max(0.0, one - self.uplink_bytes_s * pause_s)

    def paced(self) -> "CameraWire":
        """Return it with the shortest packet delay at which the cameras together leave room on the uplink."""
        in_step_s = self.n_cameras * self._wire_bytes / (UPLINK_SHARE * self.uplink_bytes_s)
        delay_ns = (in_step_s - self._wire_bytes / self.link_bytes_s) * 1e9
        return replace(self, packet_delay_ns=max(0, ceil(delay_ns / DELAY_STEP_NS) * DELAY_STEP_NS))

    @property
    def _wire_bytes(self) -> int:
        return self.packet_bytes + ETHERNET_BYTES


@dataclass(frozen=True, slots=True, kw_only=True)
class Carried:
    """The load of a wire at one rate of stones."""

    rate_hz: float
    load: float
    """Share of the time for which it is busy."""
    is_carried: bool
    """The switch is not overrun, and frames wait in no camera, or seldom: the load is at most `MOST_LOAD`."""
    bundle_ms: float
    """Time of a bundle on it."""
    queued_bytes: float
    """The most that waits in the switch while two bundles follow each other."""
    is_burst_carried: bool
    """Two bundles that follow each other neither overrun the switch nor wait in a camera."""


def carried(wire: CameraWire, rate_hz: float, spacing_ms: float = BURST_MS) -> Carried:
    """Return the load of a wire at a rate of stones, and whether it carries two that are `spacing_ms` apart."""
    load, queued_bytes = rate_hz * wire.bundle_ms / 1e3, wire.queued_bytes(spacing_ms)
    is_held, is_sent = queued_bytes <= wire.buffer_bytes, wire.bundle_ms <= spacing_ms
    return Carried(
        rate_hz=rate_hz,
        load=load,
        is_carried=is_held and (is_sent or load <= MOST_LOAD),
        bundle_ms=wire.bundle_ms,
        queued_bytes=queued_bytes,
        is_burst_carried=is_held and is_sent,
    )


def table() -> Iterator[str]:
    """Yield the lines of the guide's table: sixteen cameras of 1280 x 1024 px, by uplink and packet size."""
    yield (
        "| uplink, Gb/s | packets, bytes | packet delay, us | bundle on the wire, ms | waits in the switch, MB "
        + "".join(f"| {rate_hz}/s " for rate_hz in RATES_HZ)
        + f"| two stones {BURST_MS:g} ms apart |"
    )
    yield "|---" * (6 + len(RATES_HZ)) + "|"
    for gbit_s, packet_bytes, is_paced in (
        (1, PACKET_BYTES, True),
        (2.5, PACKET_BYTES, True),
        (5, PACKET_BYTES, True),
        (10, PACKET_BYTES, True),
        (10, PACKET_BYTES, False),
        (10, 1500, True),
        (20, PACKET_BYTES, True),
    ):
        wire = CameraWire(
            n_cameras=16, image_bytes=1280 * 1024, uplink_bytes_s=gbit_s * 125e6, packet_bytes=packet_bytes
        )
        rates = [carried(wire.paced() if is_paced else wire, rate_hz) for rate_hz in RATES_HZ]
        delay_us = wire.paced().packet_delay_ns / 1e3 if is_paced else 0
        most = rates[0]
        yield (
            f"| {gbit_s:g} | {packet_bytes} | {delay_us:g} | {most.bundle_ms:.1f} | {most.queued_bytes / 1e6:.2f} "
            + "".join(f"| {each.load:.0%}{'' if each.is_carried else ': no'} " for each in rates)
            + f"| {_burst(most)} |"
        )


def _burst(most: Carried) -> str:
    if most.is_burst_carried:
        return "carried"
    return "lost in the switch" if most.queued_bytes > BUFFER_BYTES else "the second waits in the cameras"


if __name__ == "__main__":
    sys.stdout.writelines(f"{line}\n" for line in table())
