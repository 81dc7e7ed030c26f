"""Triggering the cameras from this machine."""

import os
import socket
import threading
from collections.abc import Iterator

import pytest
from support.eventually import PATIENCE_S

from drivers.cameras import host_trigger
from drivers.cameras.host_trigger import BROADCAST, ActionKeys, ActionTrigger, SoftwareTrigger
from drivers.gvcp import GVCP_PORT

CAMERA = f"127.33.{os.getpid() % 256}.201"
FOREIGN = "198.51.100.7"
"""No address of any machine."""


@pytest.fixture
def camera() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind((CAMERA, GVCP_PORT))
        listening.settimeout(PATIENCE_S)
        yield listening


def test_a_camera_with_an_address_is_told_once(camera: socket.socket) -> None:
    ActionTrigger(ActionKeys(targets=(CAMERA,)))()
    assert camera.recv(100)[:4] == bytes.fromhex("42000100")
    camera.setblocking(False)
    with pytest.raises(BlockingIOError):
        camera.recv(100)


def test_a_named_interface_that_is_down_is_told() -> None:
    with pytest.raises(OSError, match=rf"no action command to {BROADCAST} out of {FOREIGN}: "):
        ActionTrigger(ActionKeys(), ["127.0.0.1", FOREIGN])()


def test_of_unnamed_interfaces_one_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    fire = ActionTrigger(ActionKeys(device_key=0xFFFF_FFFF))
    monkeypatch.setattr(host_trigger, "local_addresses", lambda: [FOREIGN, "127.0.0.1"])
    fire()
    monkeypatch.setattr(host_trigger, "local_addresses", lambda: [FOREIGN])
    with pytest.raises(OSError, match=FOREIGN):
        fire()


def test_a_camera_that_hangs_stops_no_other_and_gets_no_backlog() -> None:
    release, hung, fired = threading.Event(), threading.Semaphore(0), threading.Semaphore(0)

    def hang() -> None:
        hung.release()
        release.wait(PATIENCE_S)

    trigger = SoftwareTrigger([hang, lambda: fired.release()])
    try:
        for _ in range(5):
            trigger()
            assert fired.acquire(timeout=PATIENCE_S)
        assert hung.acquire(timeout=PATIENCE_S)
    finally:
        release.set()
    assert not hung.acquire(timeout=0.1)  # the four others were left out
    trigger()
    assert hung.acquire(timeout=PATIENCE_S)
