"""A rig with faults, told to Germans: what light gate, cameras and setup say, no sentence of it in English."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from support.browser import origin_of, screenshot, violations, watched_page
from support.live_rig import live_rig
from support.small_recording import write_small_recording

from screens.test_operator_page import OWN_TEXTS, PATIENCE_MS

ENGLISH = re.compile(r"\b(the|of|and|light|look|check|has|is|its|does|not|answer|lost|sent|within)\b")
SILENT = "c03"


@pytest.mark.full
def test_a_fault_of_gate_and_camera_is_told_in_german(browser: Browser, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=2)
    with (
        live_rig(tmp_path, recording, by_address=True, number=8) as live,
        watched_page(browser, locale="de-DE") as watched,
    ):
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        expect.set_options(timeout=PATIENCE_MS)
        page.goto(f"{origin_of(live.daemon.url(''))}/setup#calibration")
        begun = live.daemon.post("/calibrations", {"ball_diameters_mm": [10.0]})
        live.daemon.post(f"/calibrations/{begun['id']}/solve", {})  # without a drop
        expect(page.locator(".step")).to_contain_text("Zu wenige Fälle")
        assert [text for text in page.evaluate(OWN_TEXTS) if ENGLISH.search(text)] == []
        live.daemon.post(f"/calibrations/{begun['id']}/cancel", {})
        live.rig.gate.faults.is_blocked = True
        live.camera(SILENT).unplug()
        page.goto(origin_of(live.daemon.url("")))
        alarms = page.locator("#alarms")
        expect(alarms).to_contain_text("der Strahl ist seit")
        expect(alarms).to_contain_text("antwortet nicht")
        live.rig.gate.faults.is_silent = True
        expect(alarms).to_contain_text("nichts gesendet: Kabel und Stromversorgung prüfen")
        expect(page.locator("#reasons")).to_contain_text("nichts gesendet")
        for details in page.locator("#alarms details").all():
            details.evaluate("each => { each.open = true; }")
        screenshot(page, "operator-german-faults")
        assert [text for text in page.evaluate(OWN_TEXTS) if ENGLISH.search(text)] == []
        for name in (SILENT, "c01"):
            page.locator(f"#camera-{name} button").click()
            shown = page.evaluate(OWN_TEXTS) + page.locator("dialog[open]").all_inner_texts()
            assert [text for text in shown if ENGLISH.search(text)] == []
            page.keyboard.press("Escape")
        assert violations(page) == []
        watched.assert_clean()
