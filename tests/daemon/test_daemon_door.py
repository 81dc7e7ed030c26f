"""What strangers do at the REST port costs neither stones nor the daemon."""

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.daemon_process import STONEFALL, DaemonProcess
from support.small_recording import write_small_recording

N_STONES = 6
N_DESCRIPTORS = 1024
N_STRANGERS = 1100


@pytest.fixture
def strangers() -> Iterator[ExitStack]:
    with ExitStack() as held:
        yield held


@pytest.mark.full
def test_half_requests_by_the_thousand_take_neither_descriptors_nor_stones(
    tmp_path: Path, strangers: ExitStack
) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    limited = ("prlimit", f"--nofile={N_DESCRIPTORS}", STONEFALL)
    with DaemonProcess(tmp_path, tmp_path / "recording", rig='pace = "fast"', command=limited) as daemon:
        daemon.hear("READY=1")
        host, port = daemon.url("").split("/")[2].split(":")
        for _ in range(N_STRANGERS):
            stranger = strangers.enter_context(socket.create_connection((host, int(port))))
            stranger.sendall(b"GET /api/v1/res")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        assert daemon.get("/health/live") == {"status": "pass"}
        assert len(os.listdir(f"/proc/{daemon.process.pid}/fd")) < N_DESCRIPTORS / 2  # noqa: PTH208 - names alone
        assert daemon.stop() == 0
    assert "Too many open files" not in daemon.log
