"""Packets of a simulated camera that are asked for again, seen by a raw socket."""

import struct

import numpy as np
import pytest
from support.gige_client import RESEND, SCDA, SCP
from support.simulated_camera import N_PACKETS, Session, picture


def _resend(camera: Session, block_id: int, first: int, last: int) -> None:
    camera.control.tell(RESEND, struct.pack(">HHII", 0, block_id, first, last))


@pytest.mark.parametrize("packet_id", [0, 4, -1])
def test_a_lost_packet_is_there_when_asked_for_again(camera: Session, packet_id: int) -> None:
    camera.start()
    camera.camera.faults.lost_packets = (packet_id,)
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    lost = packet_id % N_PACKETS
    assert {index for index, _ in frame.order} == set(range(N_PACKETS)) - {lost}
    counters = camera.settled()
    assert (counters.frames, counters.torn, counters.dropped) == (0, 1, 1)
    _resend(camera, 1, lost, lost)
    again = camera.receiver.frame()
    assert again is not None
    frame.packets |= again.packets
    np.testing.assert_array_equal(frame.image, picture(1))
    counters = camera.settled()
    assert (counters.frames, counters.torn, counters.resent) == (1, 0, 1)
    assert counters.packets == N_PACKETS


def test_only_the_last_frames_are_kept(camera: Session) -> None:
    camera.start()
    for _ in range(4):
        camera.camera.line()
        assert camera.receiver.frame() is not None
    _resend(camera, 1, 0, 0)
    gone = camera.receiver.frame()
    assert gone is not None
    assert gone.order == [(0, 0x800C)]
    _resend(camera, 2, 0, 1)
    kept = camera.receiver.frame()
    assert kept is not None
    assert kept.order == [(0, 0), (1, 0)]
    assert camera.camera.counters.unavailable == 1


def test_a_camera_that_cannot_resend_says_so(camera: Session) -> None:
    camera.start()
    camera.camera.faults.set("no_resend", True)
    camera.camera.line()
    assert camera.receiver.frame() is not None
    _resend(camera, 1, 2, 3)
    refused = camera.receiver.frame()
    assert refused is not None
    assert refused.order == [(2, 0x800C), (3, 0x800C)]


def test_a_new_receiver_does_not_get_old_frames(camera: Session) -> None:
    camera.start()
    camera.camera.line()
    assert camera.receiver.frame() is not None
    assert camera.set("AcquisitionStop", 1) == 0
    assert camera.control.write(SCDA, 0x7F000001) == camera.control.write(SCP, camera.receiver.port) == 0
    assert camera.set("AcquisitionStart", 1) == 0
    _resend(camera, 1, 0, 0)
    refused = camera.receiver.frame()
    assert refused is not None
    assert refused.order == [(0, 0x800C)]
    assert camera.camera.counters.unavailable == 1
