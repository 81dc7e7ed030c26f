"""What the cameras' network carries: against the arithmetic step by step, and against the table of the guide."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples

from service.configuration.camera_wire import (
    DELAY_STEP_NS,
    ETHERNET_BYTES,
    UPLINK_SHARE,
    CameraWire,
    carried,
    table,
)

GUIDE = Path(__file__).parents[4] / "deploy" / "README.md"
RIG = CameraWire(n_cameras=16, image_bytes=1280 * 1024)

WIRES = st.builds(
    CameraWire,
    n_cameras=st.integers(1, 32),
    image_bytes=st.integers(10_000, 5_000_000),
    link_bytes_s=st.sampled_from([12.5e6, 125e6, 312.5e6]),
    uplink_bytes_s=st.sampled_from([125e6, 1.25e9, 2.5e9]),
    packet_bytes=st.sampled_from([1500, 8192, 9000]),
    packet_delay_ns=st.integers(0, 1_000_000),
)


def waiting_step_by_step(wire: CameraWire, spacing_ms: float) -> float:
    """Let all cameras send two frames in step, packet by packet, and return the most that waits."""
    waiting, most, now_s = 0.0, 0.0, 0.0
    for n_bundle in range(2):
        at_s = max(now_s, n_bundle * spacing_ms / 1e3)
        for n_packet in range(wire.n_packets):
            sent_s = at_s + n_packet * wire.packet_s
            waiting = max(
                0.0, waiting - wire.uplink_bytes_s * (sent_s - now_s if n_bundle or n_packet else 0)
            )
            waiting += wire.n_cameras * (wire.packet_bytes + ETHERNET_BYTES)
            most, now_s = max(most, waiting), sent_s
        now_s = at_s + wire.n_packets * wire.packet_s
        waiting = max(0.0, waiting - wire.uplink_bytes_s * wire.packet_s)
    return most


@examples(0.5)
@given(WIRES, st.floats(1, 300))
def test_what_waits_in_the_switch_is_what_cameras_in_step_leave_there(wire: CameraWire, spacing_ms: float):
    assert wire.queued_bytes(spacing_ms) == pytest.approx(waiting_step_by_step(wire, spacing_ms), rel=1e-6)


@examples(0.5)
@given(WIRES)
def test_the_packet_delay_is_the_shortest_that_leaves_room_on_the_uplink(wire: CameraWire):
    paced = wire.paced()
    assert paced.sent_bytes_s <= UPLINK_SHARE * wire.uplink_bytes_s * 1.000001
    if delay_ns := paced.packet_delay_ns:
        shorter = replace(paced, packet_delay_ns=delay_ns - DELAY_STEP_NS)
        assert shorter.sent_bytes_s > UPLINK_SHARE * wire.uplink_bytes_s
    assert paced.queued_bytes() == pytest.approx(wire.n_cameras * (wire.packet_bytes + ETHERNET_BYTES))


@examples(0.5)
@given(WIRES, st.floats(0.1, 40))
def test_a_bundle_takes_what_its_slowest_part_takes_and_the_load_grows_with_the_rate(
    wire: CameraWire, rate_hz: float
):
    least_s = wire.image_bytes * max(1 / wire.link_bytes_s, wire.n_cameras / wire.uplink_bytes_s)
    assert wire.bundle_ms > 1e3 * least_s
    found = carried(wire, rate_hz)
    assert found.load == pytest.approx(rate_hz * wire.bundle_ms / 1e3)
    assert found.is_carried or not found.is_burst_carried


@pytest.mark.parametrize(
    ("uplink_bytes_s", "bundle_ms", "is_burst_carried"),
    [(125e6, 191, False), (1.25e9, 19.0, True), (2.5e9, 10.6, True)],
)
def test_sixteen_cameras_on_common_uplinks(uplink_bytes_s: float, bundle_ms: float, is_burst_carried: bool):
    found = carried(replace(RIG, uplink_bytes_s=uplink_bytes_s).paced(), 10)
    assert found.bundle_ms == pytest.approx(bundle_ms, rel=0.01)
    assert (found.is_burst_carried, found.is_carried) == (is_burst_carried, is_burst_carried)
    assert found.queued_bytes == pytest.approx(16 * (8192 + ETHERNET_BYTES))


def test_without_a_packet_delay_a_bundle_overruns_the_switch():
    found = carried(replace(RIG, uplink_bytes_s=1.25e9), 4)
    assert found.load < 0.1
    assert found.queued_bytes > 8e6
    assert not found.is_carried
    assert carried(replace(RIG, uplink_bytes_s=1.25e9, buffer_bytes=9_000_000), 4).is_carried


def test_the_table_of_the_guide_is_what_it_prints():
    assert "\n".join(table()) in GUIDE.read_text(encoding="utf-8")
