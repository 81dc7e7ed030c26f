"""The page that checks a report: the very file that was issued, and one with a byte changed."""

import re
from pathlib import Path
from urllib.request import urlopen

import pytest
from playwright.sync_api import expect
from support.browser import Watched, origin_of, screenshot, violations
from support.daemon_process import DaemonProcess
from support.eventually import PATIENCE_S

ISSUED = "/lots/L1/report.pdf?revision=1"


def fetched(daemon: DaemonProcess, path: str) -> bytes:
    with urlopen(daemon.url(path)) as answer:  # noqa: S310 - of the daemon that the test has started
        return bytes(answer.read())


@pytest.fixture
def issued(replay: DaemonProcess) -> bytes:
    """The report of a lot of the replay; the next tests of this module get the same one."""
    replay.put("/products/basalt", {"title": "basalt", "density_kg_m3": 2700})
    replay.post("/lots", {"lot": "L1", "product": "basalt"})
    replay.post(f"/lots/L1/close?wait_s={PATIENCE_S:g}", {})
    return fetched(replay, ISSUED)


@pytest.mark.full
def test_a_report_is_genuine_until_a_byte_is_changed(
    watched: Watched, replay: DaemonProcess, issued: bytes, tmp_path: Path
) -> None:
    page = watched.page
    page.goto(origin_of(replay.url("")) + "/lots")
    page.locator("#list tbody tr").first.wait_for()  # what comes late moves the link under the mouse
    page.get_by_role("link", name="Check a report").click()
    for name, content, said in (
        ("issued", issued, "Genuine: this instrument signed it"),
        ("changed", issued.replace(b"endobj", b"endobk", 1), "changed after it was signed"),
        ("unsigned", fetched(replay, "/lots/L1/report.pdf"), "Not signed"),
    ):
        (file := tmp_path / f"{name}.pdf").write_bytes(content)
        page.get_by_label("PDF file").set_input_files(file)
        page.get_by_role("button", name="Check", exact=True).click()
        expect(page.locator("#found")).to_contain_text(said)
        expect(page.locator("#found dd")).to_have_count(5 if name == "issued" else 0)
        screenshot(page, f"verify-{name}")
        if name == "issued":
            expect(page.locator("#found")).to_contain_text(re.compile(r"20\d\d"))
    key = replay.get("/instrument/key")["fingerprint"]
    expect(page.locator("#key")).to_have_text(re.compile(key))


@pytest.mark.full
def test_a_genuine_report_says_that_there_is_a_newer_one(
    watched: Watched, replay: DaemonProcess, issued: bytes, tmp_path: Path
) -> None:
    replay.post("/lots/L1/assign", {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"})
    newest = replay.get("/lots/L1")["revision"]
    assert newest > 1
    (file := tmp_path / "issued.pdf").write_bytes(issued)
    page = watched.page
    page.goto(origin_of(replay.url("")) + "/verify")
    page.get_by_label("PDF file").set_input_files(file)
    page.get_by_role("button", name="Check", exact=True).click()
    expect(page.locator("#found")).to_contain_text(f"a newer report: revision {newest}")


@pytest.mark.full
def test_the_page_is_for_everybody(watched: Watched, replay: DaemonProcess) -> None:
    watched.page.goto(origin_of(replay.url("")) + "/verify")
    expect(watched.page.locator("#key")).not_to_be_empty()
    assert violations(watched.page) == []
