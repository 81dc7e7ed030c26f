"""One browser, and for each module of tests a daemon that replays a small recording for ever."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright
from support.browser import Watched, launch, watched_page
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording

from pipeline.frames import CameraId

DIM = CameraId("c03")
DIMMED_TO = 0.7
N_STONES = 20


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """Playwright's event loop, which no asyncio test may meet, ends with the tests of this folder."""
    with sync_playwright() as playwright:
        browser = launch(playwright)
        yield browser
        browser.close()


@pytest.fixture
def watched(browser: Browser) -> Iterator[Watched]:
    """A page of its own; the test fails if it asks another host or leaves an error."""
    with watched_page(browser) as watched:
        yield watched
        watched.assert_clean()


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Stones before a rig in which one camera has lost light."""
    path = tmp_path_factory.mktemp("recording") / "recording"
    write_small_recording(path, n_stones=N_STONES, dimmed={DIM: DIMMED_TO})
    return path


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Iterator[DaemonProcess]:
    """A real daemon that plays the recording again and again."""
    rig = "loop = true\nspeed = 0.5"
    with DaemonProcess(tmp_path_factory.mktemp("daemon"), recording, rig=rig) as daemon:
        daemon.hear("READY=1")
        yield daemon
        assert daemon.process.poll() is None, daemon.log
