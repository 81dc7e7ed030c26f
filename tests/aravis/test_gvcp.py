"""Discovery and action commands, over our own datagrams."""

import os
import resource
import socket
import struct
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from support.eventually import PATIENCE_S
from support.gige import INTERFACE, NET, design, place, powered, serial, settings_for

from drivers.cameras.finding import find_camera
from drivers.gige_simulator.camera import SimulatedCamera
from drivers.gige_simulator.personalities import PLAIN
from drivers.gvcp import (
    GVCP_PORT,
    DiscoveredCamera,
    action_command,
    decoded,
    discover,
    local_addresses,
    probe,
)


@pytest.fixture
def camera() -> Iterator[SimulatedCamera]:
    with powered(design()) as simulated:
        yield simulated


def ours(devices: list[DiscoveredCamera]) -> list[DiscoveredCamera]:
    """Other simulators of this machine answer as well."""
    return [device for device in devices if device.address.startswith(f"{NET}.")]


def test_a_camera_says_who_it_is(camera: SimulatedCamera) -> None:
    device = probe(f"{NET}.2")
    assert device is not None
    assert (device.address, device.serial, device.user_name) == (f"{NET}.2", serial(2), place(2))
    assert len(device.mac.split(":")) == 6
    assert ours(discover([INTERFACE])) == [device]


@pytest.mark.parametrize(
    ("name", "encoding", "told"),
    [
        ("Süd", "utf-8", "Süd"),
        ("Süd", "latin-1", "Süd"),
        ("相机一", "utf-8", "相机一"),
        ("Förderband West", "utf-8", "Förderband West"),  # 16 bytes
        ("相机一", "gbk", "相机一".encode("gbk").decode("latin-1")),  # wrong, but always the same
    ],
)
def test_user_names_are_utf_8_or_else_latin_1(name: str, encoding: str, told: str) -> None:
    """tiscamera 418; the camera is found by the name as people write it."""
    with powered(design(user_name=name, personality=replace(PLAIN, encoding=encoding))):
        found = find_camera(settings_for(design(), address=None, user_name=told, interfaces=(INTERFACE,)))
    assert (found.address, found.user_name) == (f"{NET}.2", told)


def test_a_character_that_the_field_has_cut_is_left_out() -> None:
    assert decoded("Förderband Ostü".encode()[:16]) == "Förderband Ost"
    assert decoded("Förderband Süd-1".encode()[:16]) == "Förderband Süd"
    assert decoded(b"S\xfcd") == "Süd"
    assert decoded(b"S\xfc") == "Sü"  # Latin-1, whose last character begins none of UTF-8
    assert decoded(b"") == ""


@pytest.mark.usefixtures("camera")
def test_everybody_answers_a_broadcast_in_order_of_addresses() -> None:
    with powered(design(10)), powered(design(3)):
        assert [device.serial for device in ours(discover())] == [serial(2), serial(3), serial(10)]


def test_a_dead_address_costs_no_more_than_it_is_given() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mute:
        mute.bind((f"{NET}.9", GVCP_PORT))
        lasted_s = []
        for _ in range(10):  # a busy machine may be late, but not always
            start_s = time.monotonic()
            assert probe(f"{NET}.9", timeout_s=0.1) is None
            lasted_s.append(time.monotonic() - start_s)
        assert min(lasted_s) < 0.3
    assert probe(f"{NET}.9") is None  # refused
    assert probe("240.0.0.1") is None  # unreachable


@pytest.mark.usefixtures("camera")
def test_a_process_with_many_files_open_may_ask() -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(2000, limits[1]), limits[1]))
    descriptors = [os.open(os.devnull, os.O_RDONLY) for _ in range(1024)]
    try:
        assert probe(f"{NET}.2") is not None
        assert [device.serial for device in ours(discover([INTERFACE]))] == [serial(2)]
    finally:
        for descriptor in descriptors:
            os.close(descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def test_a_lost_datagram_is_no_dead_camera() -> None:
    """The second question is answered, and so is what is no answer passed over."""
    with ThreadPoolExecutor(1) as executor, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf_at_first:
        deaf_at_first.bind((f"{NET}.9", GVCP_PORT))
        deaf_at_first.settimeout(PATIENCE_S)
        probing = executor.submit(probe, f"{NET}.9", timeout_s=2.0)
        first, _ = deaf_at_first.recvfrom(100)
        second, peer = deaf_at_first.recvfrom(100)
        assert first[:6] == second[:6] == bytes.fromhex("420100020000")
        registers = bytearray(0xF8)
        registers[0xD8:0xDC] = b"S123"
        deaf_at_first.sendto(b"noise", peer)
        deaf_at_first.sendto(struct.pack(">HHHH", 0, 0x81, 0xF8, 2) + registers, peer)
        deaf_at_first.sendto(struct.pack(">HHHH", 0, 3, 0xF8, 2) + registers, peer)
        device = probing.result()
    assert device is not None
    assert device.serial == "S123"


def test_an_address_of_another_machine_is_refused_by_name() -> None:
    with pytest.raises(OSError, match=r"out of 198\.51\.100\.7.*this machine has .*127\.0\.0\.1"):
        discover(["198.51.100.7"])
    assert "127.0.0.1" in local_addresses()
    with pytest.raises(ValueError, match="camera-1"):
        probe("camera-1")


def test_action_command_on_the_wire() -> None:
    keys = {"device_key": 7, "group_key": 2, "group_mask": 0x80000001}
    assert action_command(**keys, request_id=9) == bytes.fromhex(
        "42 00 0100 000c 0009 00000007 00000002 80000001"
    )
    assert action_command(**keys, request_id=9, at_ns=5) == bytes.fromhex(
        "42 80 0100 0014 0009 00000007 00000002 80000001 0000000000000005"
    )
    for request_id in (0, 0x10000):
        with pytest.raises(ValueError, match="request_id"):
            action_command(**keys, request_id=request_id)
