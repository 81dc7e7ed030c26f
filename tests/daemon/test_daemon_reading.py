"""Pictures cost the daemon nothing: they come with their stone, or of a process whose death no client sees."""

import os
import signal
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from support.daemon_process import DaemonProcess, descendants_of, process_name
from support.eventually import PATIENCE_S
from support.small_recording import write_small_recording

from service.processing.measure_job import THUMBNAIL
from service.web.reader_process import DRAWING

N_STONES = 3


def drawers_of(daemon: DaemonProcess) -> list[int]:
    return [pid for pid in descendants_of(daemon.process.pid) if process_name(pid) == DRAWING]


def preview(daemon: DaemonProcess, seq: int) -> bytes:
    """Return a stone's picture; ask again when a busy machine has not drawn it in time, as the answer says."""
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            with urlopen(daemon.url(f"/particles/{seq}/preview.png")) as answer:  # noqa: S310 - http, our own
                return bytes(answer.read())
        except HTTPError as error:
            assert error.code == 503
            assert time.monotonic() < deadline_s


@pytest.mark.full
def test_the_drawing_process_is_killed_and_every_answer_comes(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    with DaemonProcess(tmp_path, tmp_path / "recording") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        assert len(list(daemon.folder.glob(f"state/particles/**/{THUMBNAIL}"))) == N_STONES
        killed = set()
        for seq in range(1, N_STONES + 1):
            assert preview(daemon, seq).startswith(b"\x89PNG")
            (drawer,) = drawers_of(daemon)
            (worker, *_) = daemon.worker_pids()
            assert os.getpriority(os.PRIO_PROCESS, drawer) > os.getpriority(os.PRIO_PROCESS, worker)
            os.kill(drawer, signal.SIGKILL)
            killed.add(drawer)
        assert len(killed) == N_STONES
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
