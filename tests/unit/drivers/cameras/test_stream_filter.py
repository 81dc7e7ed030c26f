"""The packet filter of a stream, asked by the kernel about real datagrams."""

import socket
import struct
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from support.eventually import PATIENCE_S

from drivers.cameras.stream_filter import attach_filter, max_packet_number, stream_program
from drivers.gige_simulator.gvsp import Block, packets

CAMERA, STRANGER, HOST = "127.35.1.2", "127.35.1.3", "127.35.1.1"
LAST = 40
LEADER, TRAILER, PAYLOAD, ALL_IN, EXTENDED = 1, 2, 3, 4, 0x80
WHOLE = 0xFFFFFFFF


def standard(kind: int, number: int) -> bytes:
    return struct.pack(">HHI", 0, 7, kind << 24 | number) + b"data"


def extended(kind: int, number: int, *, low_bits: int = 0) -> bytes:
    return struct.pack(">HHIQI", 0, 0, (kind | EXTENDED) << 24 | low_bits, 7, number) + b"data"


Passing = Callable[..., list[bytes]]


@pytest.fixture
def passes() -> Iterator[Passing]:
    """Tell which of some datagrams, sent from an address, pass the filter of a camera's socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
        stream.bind((HOST, 0))
        attach_filter(stream, stream_program(CAMERA, LAST))
        stream.settimeout(PATIENCE_S)

        def passing(datagrams: list[bytes], sent_from: str = CAMERA) -> list[bytes]:
            end = standard(LEADER, LAST)
            with (
                socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
                socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
            ):
                sender.bind((sent_from, 0))
                camera.bind((CAMERA, 0))
                for datagram in datagrams:
                    sender.sendto(datagram, stream.getsockname())
                camera.sendto(end, stream.getsockname())
                found = []
                while (datagram := stream.recv(4096)) != end:
                    found.append(datagram)
            return found

        yield passing


def test_packets_of_a_frame_pass_and_others_do_not(passes: Passing) -> None:
    good = [
        *(standard(kind, number) for kind in (LEADER, TRAILER, PAYLOAD) for number in (0, 1, LAST - 1)),
        *(extended(kind, number) for kind in (LEADER, TRAILER, PAYLOAD) for number in (0, LAST)),
        extended(PAYLOAD, 3, low_bits=0xFFFFFF),
    ]
    bad = [
        standard(PAYLOAD, LAST + 1),
        standard(PAYLOAD, 0xFFFFFF),
        extended(PAYLOAD, LAST + 1),
        extended(TRAILER, 0x90000000),
        extended(TRAILER, WHOLE),
        standard(0, 1),
        standard(ALL_IN, 1),
        standard(0x7F, 1),
        extended(PAYLOAD, 1)[:19],
        standard(PAYLOAD, 1)[:7],
        b"",
    ]
    assert passes([*bad, *good, *bad]) == good
    assert passes(good, STRANGER) == []


@pytest.mark.parametrize("has_extended_ids", [False, True])
@pytest.mark.parametrize("packet_bytes", [576, 1500, 9000])
def test_a_whole_frame_passes(has_extended_ids: bool, packet_bytes: int) -> None:
    image = np.zeros((1024, 1280), np.uint8)
    block = Block(
        block_id=1,
        has_extended_ids=has_extended_ids,
        packet_bytes=packet_bytes,
        device_ns=1,
        image=image,
        offset_px=(0, 0),
        chunks=None,
    )
    n = len(packets(block))
    most = max_packet_number(image.size, packet_bytes)
    assert n - 1 <= most < 1.03 * n + 1
