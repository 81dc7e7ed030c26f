"""The simulated uplink drops what the arithmetic of the configuration says, in whatever order packets are sent."""

import random

from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from drivers.gige_simulator.uplink import Uplink
from service.configuration.camera_wire import ETHERNET_BYTES, CameraWire

BURST_S = 0.025


def n_dropped(wire: CameraWire, buffer_bytes: float, seed: int) -> int:
    """Send two bundles of all cameras in step, their threads in any order, and return how many packets are dropped."""
    uplink = Uplink(rate_bytes_s=wire.uplink_bytes_s, buffer_bytes=round(buffer_bytes))
    second_s = max(BURST_S, wire.n_packets * wire.packet_s)
    leaves_s = [
        1e3 + start_s + number * wire.packet_s
        for start_s in (0, second_s)
        for number in range(wire.n_packets)
    ] * wire.n_cameras
    random.Random(seed).shuffle(leaves_s)  # noqa: S311 - nothing secret
    return sum(not uplink.carries(wire.packet_bytes + ETHERNET_BYTES, at_s) for at_s in leaves_s)


@examples(0.2)
@given(
    st.builds(
        CameraWire,
        n_cameras=st.integers(2, 16),
        image_bytes=st.integers(100_000, 400_000),
        uplink_bytes_s=st.sampled_from([125e6, 312.5e6, 1.25e9]),
        packet_bytes=st.sampled_from([1500, 8192]),
        packet_delay_ns=st.sampled_from([0, 20_000, 400_000]),
    ),
    st.integers(0, 9),
)
def test_what_waits_at_most_is_the_buffer_that_two_bundles_need(wire: CameraWire, seed: int) -> None:
    needed_bytes = wire.queued_bytes(1e3 * BURST_S)
    assert (
        n_dropped(wire, 1.1 * needed_bytes, seed) == 0
    )  # the time of the uplink is in slots of a 64th of it
    assert n_dropped(wire, 0.8 * needed_bytes, seed) > 0
    assert n_dropped(wire.paced(), 1.1 * wire.n_cameras * (wire.packet_bytes + ETHERNET_BYTES), seed) == 0
