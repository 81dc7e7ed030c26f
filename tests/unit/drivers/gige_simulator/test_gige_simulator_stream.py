"""What a simulated camera sends and how fast, seen by a raw socket."""

import struct
import time

import numpy as np
import pytest
from support.gige_client import RESEND, SCPS
from support.simulated_camera import N_PACKETS, N_PIXELS, PACKET_BYTES, SIZE_PX, Session, picture, session

from drivers.gige_simulator.gvsp import Block, packets
from drivers.gige_simulator.uplink import Uplink


def test_a_frame_is_the_image_with_leader_and_trailer(camera: Session) -> None:
    camera.start(packet_bytes=PACKET_BYTES)
    for n in (1, 2, 3):
        camera.camera.line()
        frame = camera.receiver.frame()
        assert frame is not None
        assert frame.block_id == n
        assert [packet_id for packet_id, _ in frame.order] == list(range(N_PACKETS))
        assert frame.size_px == SIZE_PX
        np.testing.assert_array_equal(frame.image, picture(n))
        trailer = frame.packets[N_PACKETS - 1]
        assert trailer == struct.pack(">HHI", 0, 1, SIZE_PX[1])
    counters = camera.settled()
    assert (counters.exposures, counters.frames, counters.packets) == (3, 3, 3 * N_PACKETS)
    assert (counters.dropped, counters.resent, counters.torn) == (0, 0, 0)


def test_block_ids_begin_anew_with_every_acquisition_and_skip_zero(camera: Session) -> None:
    for _ in range(2):
        camera.start()
        camera.camera.line()
        frame = camera.receiver.frame()
        assert frame is not None
        assert frame.block_id == 1
        assert camera.set("AcquisitionStop", 1) == 0
    camera.start()
    camera.camera.skip_blocks(65_534)
    ids = []
    for _ in range(2):
        camera.camera.line()
        frame = camera.receiver.frame()
        assert frame is not None
        ids.append(frame.block_id)
    assert ids == [65_535, 1]


def test_extended_ids(camera: Session) -> None:
    assert camera.set("GevGVSPExtendedIDMode", 0x40000000) == 0
    camera.start()
    camera.camera.skip_blocks(2**40)
    camera.camera.faults.lost_packets = (0, 3)
    camera.camera.line()
    lost = camera.receiver.frame()
    assert lost is not None
    assert lost.has_extended_ids
    assert lost.block_id == 2**40 + 1
    body = struct.pack(">IIIQ", 0, 0, 3, lost.block_id)
    camera.control.tell(RESEND, body, flags=0x10)
    again = camera.receiver.frame()
    assert again is not None
    assert [packet_id for packet_id, _ in again.order] == [0, 1, 2, 3]
    np.testing.assert_array_equal(
        np.frombuffer((again.packets | lost.packets)[3], np.uint8),
        picture(1).reshape(-1)[2 * 1452 : 3 * 1452],  # the header is 12 bytes longer
    )
    assert camera.settled().frames == 1


def test_chunks_follow_the_image(camera: Session) -> None:
    assert camera.set("ChunkModeActive", 1) == 0
    assert camera.number("PayloadSize") == N_PIXELS + 8 + 4 * 16
    assert camera.set("ChunkEnable", 0, bank=1) == 0  # FrameID
    assert camera.number("PayloadSize") == N_PIXELS + 8 + 3 * 16
    camera.start()
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, picture(1))
    tail = frame.payload[N_PIXELS:]
    assert struct.unpack(">II", tail[:8]) == (0x100, N_PIXELS)
    assert struct.unpack(">QIIdIIQII", tail[8:]) == (
        *(frame.device_ns, 0x101, 8),
        *(100.0, 0x103, 8),
        *(1, 0x104, 8),
    )
    assert frame.packets[frame.trailer_id] == struct.pack(
        ">HHIII", 0, 0x4001, SIZE_PX[1], len(frame.payload), 0
    )


@pytest.mark.parametrize("n_bytes", [N_PIXELS // 4, N_PIXELS // 4 + 1, N_PIXELS, N_PIXELS * 2])
def test_the_last_packet_is_as_short_as_it_may_be(n_bytes: int) -> None:
    block = Block(
        block_id=1,
        has_extended_ids=False,
        packet_bytes=n_bytes + 36,
        device_ns=0,
        image=picture(1),
        offset_px=(0, 0),
        chunks=None,
    )
    _, *payload, _ = packets(block)
    lengths = [len(packet) - 8 for packet in payload]
    assert sum(lengths) == N_PIXELS
    assert set(lengths[:-1]) <= {n_bytes}
    assert b"".join(bytes(packet[8:]) for packet in payload) == picture(1).tobytes()


def test_a_region_of_interest(camera: Session) -> None:
    for name, value in (("Width", 64), ("Height", 32), ("OffsetX", 16), ("OffsetY", 10)):
        assert camera.set(name, value) == 0
    camera.start()
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    np.testing.assert_array_equal(frame.image, picture(1)[10:42, 16:80])
    assert struct.unpack_from(">II", frame.packets[0], 24) == (16, 10)


def test_test_packets_get_through_up_to_the_mtu() -> None:
    with session(mtu_bytes=4000) as camera:
        camera.stream_to_receiver()
        for size, arrives in ((1500, True), (4000, True), (4004, False)):
            assert camera.control.write(SCPS, 1 << 31 | 1 << 30 | size) == 0
            packet = camera.receiver.packet(0.1)
            assert (packet is not None and len(packet) == size - 28) is arrives
        assert camera.control.read(SCPS) == 1 << 30 | 4004  # the command bit is gone


@pytest.mark.parametrize(
    ("name", "value", "lasts_s"),
    [
        ("DeviceLinkThroughputLimit", 100_000, N_PACKETS * 1500 / 100_000),
        ("GevSCPD", 10_000_000, N_PACKETS * 0.010),
    ],
)
def test_throughput_limit_and_packet_delay_are_obeyed(
    camera: Session, name: str, value: int, lasts_s: float
) -> None:
    assert camera.set(name, value) == 0
    camera.start()
    since_s = time.monotonic()
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    assert 0.8 * lasts_s < frame.last_s - since_s  # a busy machine is later


def test_a_shared_uplink_drops_what_does_not_fit() -> None:
    uplink = Uplink(rate_bytes_s=1_000_000, buffer_bytes=4 * PACKET_BYTES)
    with session(uplink=uplink) as camera:
        camera.start()
        camera.camera.line()
        frame = camera.receiver.frame()
        counters = camera.settled()
    assert frame is not None
    assert 3 <= len(frame.order) == counters.packets < N_PACKETS
    assert counters.packets + counters.dropped == N_PACKETS
    assert (counters.frames, counters.torn) == (0, 1)


def test_an_image_of_the_wrong_shape_is_noted_and_not_sent() -> None:
    with session(lambda exposure: picture(exposure.n)[:, :-4]) as camera:
        camera.start()
        camera.camera.line()
        assert camera.settled().unexposed == 1
        assert "image source gave uint8 (96, 124), not uint8 (96, 128)" in camera.camera.log[-1].event


def test_without_a_destination_a_frame_is_lost() -> None:
    with session() as camera:
        assert camera.set("TriggerMode", 1) == camera.set("AcquisitionStart", 1) == 0
        camera.camera.line()
        counters = camera.settled()
        assert (counters.torn, counters.dropped, counters.packets) == (1, N_PACKETS, 0)


def test_stopping_in_the_middle_of_a_frame_tears_it(camera: Session) -> None:
    assert camera.set("GevSCPD", 20_000_000) == 0
    camera.start()
    camera.camera.line()
    assert camera.receiver.packet() is not None
    assert camera.set("AcquisitionStop", 1) == 0
    counters = camera.settled()
    assert (counters.torn, counters.frames) == (1, 0)
    assert counters.packets < N_PACKETS
