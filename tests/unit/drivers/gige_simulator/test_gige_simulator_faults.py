"""What can go wrong with a simulated camera's stream, seen by a raw socket."""

import time

import numpy as np
import pytest
from support.simulated_camera import N_PACKETS, SIZE_PX, Session, picture, session


def test_loss_is_seeded_and_counted() -> None:
    orders = []
    for _ in range(2):
        with session(seed=3) as camera:
            camera.start()
            camera.camera.faults.packet_loss = 0.3
            order = []
            for _ in range(5):
                camera.camera.line()
                if frame := camera.receiver.frame():
                    order += frame.order
            counters = camera.settled()
            assert counters.packets == len(order)
            assert counters.packets + counters.dropped == 5 * N_PACKETS
            assert counters.frames + counters.torn == 5
            assert counters.dropped > 5
            orders.append(order)
    assert orders[0] == orders[1]


def test_duplicates_and_reordering(camera: Session) -> None:
    camera.start()
    camera.camera.faults.duplicate = 1.0
    camera.camera.faults.reorder = True
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    rest = [camera.receiver.packet() for _ in range(2 * N_PACKETS - len(frame.order))]
    assert all(rest)
    assert [packet_id for packet_id, _ in frame.order][4:8] == [3, 3, 2, 2]
    np.testing.assert_array_equal(frame.image, picture(1))
    assert camera.settled().packets == 2 * N_PACKETS


def test_a_stall_ends_the_frame(camera: Session) -> None:
    camera.start()
    camera.camera.faults.stall_after = 3
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    assert [packet_id for packet_id, _ in frame.order] == [0, 1, 2, 3]
    assert camera.settled().torn == 1


def test_a_swallowed_frame_and_one_not_shown_leave_a_gap() -> None:
    with session(lambda exposure: None if exposure.n == 2 else picture(exposure.n)) as camera:
        camera.start()
        ids = []
        for n in range(1, 5):
            camera.camera.faults.swallowed_frames = 1 if n == 3 else 0
            camera.camera.line()
            if n in (1, 4):
                frame = camera.receiver.frame()
                assert frame is not None
                ids.append(frame.block_id)
            camera.settled()
        assert ids == [1, 4]
        counters = camera.settled()
    assert (counters.frames, counters.unexposed, counters.swallowed) == (2, 1, 1)


def test_faults_of_the_image(camera: Session) -> None:
    camera.start()
    faults = camera.camera.faults
    faults.corrupted = True
    assert _exposed(camera)[:2, 0].tolist() == [255 - picture(1)[0, 0], picture(1)[1, 0]]
    faults.clear()
    faults.frozen = True
    np.testing.assert_array_equal(_exposed(camera), picture(2))
    np.testing.assert_array_equal(_exposed(camera), picture(2))
    faults.clear()
    faults.wrong_size = True
    np.testing.assert_array_equal(_exposed(camera), picture(4)[: SIZE_PX[1] // 2])
    faults.clear()
    np.testing.assert_array_equal(_exposed(camera), picture(5))


def _exposed(camera: Session) -> np.ndarray:
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    camera.settled()
    return frame.image


def test_a_late_frame(camera: Session) -> None:
    camera.start()
    camera.camera.faults.late_ms = 120
    since_s = time.monotonic()
    camera.camera.line()
    frame = camera.receiver.frame()
    assert frame is not None
    assert frame.first_s - since_s > 0.12


@pytest.mark.parametrize(("kind", "n_bytes"), [("short", 3), ("foreign", 40), ("huge", 24), ("abort", 36)])
def test_malformed_datagrams(camera: Session, kind: str, n_bytes: int) -> None:
    camera.start()
    camera.camera.send_malformed(kind)
    packet = camera.receiver.packet()
    assert packet is not None
    assert len(packet) == n_bytes
    assert camera.camera.counters.packets == 0


def test_faults_are_set_by_name_and_refused_by_name(camera: Session) -> None:
    faults = camera.camera.faults
    faults.set("lost_packets", [0, 5])
    faults.set("stall_after", 3)
    faults.set("packet_loss", 1)
    assert (faults.lost_packets, faults.stall_after, faults.packet_loss) == ((0, 5), 3, 1.0)
    for name, value in (("nonsense", 1), ("packet_loss", "much"), ("no_resend", 1), ("swallowed_frames", -1)):
        with pytest.raises(ValueError, match=name):
            faults.set(name, value)
    faults.clear()
    assert faults.as_dict()["lost_packets"] == ()
