"""The operator's page on a rehearsal: a lot opens, the verification falls due, an alarm comes and says what to do."""

import json
import re
import signal
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import expect
from support.browser import Watched, screenshot
from support.daemon_process import PATIENCE_S, STONEFALL, free_port
from support.eventually import eventually

from service.commands.rehearsal.rehearsed_daemon import is_free

PATIENCE_MS = 300_000


@pytest.mark.full  # a rehearsal takes half a minute and more
def test_a_rehearsed_day_is_seen_on_the_page(watched: Watched, tmp_path: Path) -> None:
    page, port = watched.page, free_port()
    page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    command = [
        "env",
        "--default-signal=INT",
        STONEFALL,
        "rehearse",
        "--script",
        "verification-overdue",
        "--json",
    ]
    command += ["--port", str(port), "--folder", tmp_path / "rehearsal", "--linger-s", "500"]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as rehearsal:
        try:
            eventually(lambda: not is_free(port), PATIENCE_S)
            page.goto(f"http://127.0.0.1:{port}/")
            expect(page.locator("#lot-name")).to_have_text("L-1")
            verdict = page.locator("#verdict-word")
            expect(verdict).to_contain_text(re.compile("too few|ndecided|onform"))
            expect(page.locator("#newest li")).not_to_have_count(0)
            alarm = page.locator('.alarm[data-check="calibration"]')
            expect(alarm).to_contain_text("What to do:")
            screenshot(page, "rehearsal")
            alarm.get_by_role("button", name="Acknowledge").click()
            expect(alarm).to_have_class(re.compile("acknowledged$"))
            assert rehearsal.stdout is not None
            expected = json.loads(rehearsal.stdout.readline())
            assert expected["followed"]["results"] > 0
            expect(page.locator("#lot-name")).to_have_text("None open")
        finally:
            rehearsal.send_signal(signal.SIGINT)
            rehearsal.wait(PATIENCE_S)
