"""The wizards, each from its first step to its last: hands at a simulated rig, eyes on its lamps."""

import io
import re
import tarfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect
from support.browser import SIZES, Watched, origin_of, reachable_by_tab, screenshot, violations, watched_page
from support.eventually import eventually
from support.live_rig import LiveRig, live_rig
from support.small_recording import write_ball_recording

PATIENCE_MS = 300_000
N_BALLS = 10
BALL_MM = 10.0
EXCHANGED = {"c05": "c07", "c07": "c05"}
"""Where the person finds the cameras of these places."""
SILENT = "c16"
LOOKS = (("wall", "light"), ("desktop", "dark"), ("tablet", "light"), ("tablet", "dark"))
NAMES_OF = "(all) => all.map((each) => each.getAttribute('aria-label') ?? each.innerText.trim())"
"""The names of buttons as `reachable_by_tab` has them."""


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveRig]:
    """A rig before which balls fall one by one."""
    folder = tmp_path_factory.mktemp("live")
    write_ball_recording(folder / "recording", n_balls=N_BALLS, diameter_mm=BALL_MM)
    recording, strobe = folder / "recording", 'strobe_line = "Line2"'
    with live_rig(folder, recording, by_address=True, number=9, more=strobe) as live:
        yield live


@pytest.fixture
def page(watched: Watched) -> Page:
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    return watched.page


def enter(page: Page, live: LiveRig, wizard: str) -> None:
    page.goto(f"{origin_of(live.daemon.url(''))}/setup#{wizard}")
    expect(page.locator(".step h2")).to_be_visible()


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name, exact=True).first.click()


def step(page: Page) -> Locator:
    return page.locator(".steps li[aria-current]")


@pytest.mark.full
def test_a_calibration_from_the_first_ball_to_its_use(page: Page, live: LiveRig) -> None:
    enter(page, live, "calibration")
    before = live.daemon.get("/calibrations")["active"]["id"]
    assert violations(page) == []
    screenshot(page, "setup-calibration-prepare")
    page.get_by_label("Diameter of the ball, mm").first.fill(str(BALL_MM))
    page.get_by_label("Your name").fill("A. Miller")
    press(page, "Begin")
    expect(step(page)).to_have_text("Drop")
    live.fall(3)
    expect(page.locator(".drops li")).to_have_count(3)
    expect(page.locator(".live-wanted")).to_contain_text("5 more times")
    page.reload()
    expect(page.locator(".drops li")).to_have_count(3)  # it goes on where it was
    live.fall(N_BALLS - 3)
    expect(page.locator(".drops li")).to_have_count(N_BALLS)
    assert page.locator("svg.space .ball").count() == 3 * N_BALLS
    assert page.locator(".view .ball").count() > 8 * N_BALLS
    assert violations(page) == []
    screenshot(page, "setup-calibration-drop")
    press(page, "Solve")
    expect(step(page)).to_have_text("Review")
    expect(page.locator(".verdict")).to_have_text("This calibration can be used.")
    assert page.locator(".bars tbody tr").count() == 16
    after_px = [float(text) for text in page.locator(".bars td:nth-child(3) .value").all_inner_texts()]
    before_px = [float(text) for text in page.locator(".bars td:nth-child(2) .value").all_inner_texts()]
    assert max(after_px) < 0.3 < max(before_px)
    assert violations(page) == []
    screenshot(page, "setup-calibration-review")
    press(page, "Drop more")
    expect(step(page)).to_have_text("Drop")
    page.reload()
    expect(step(page)).to_have_text("Review")
    press(page, "Accept")
    expect(step(page)).to_have_text("Use")
    assert live.daemon.get("/calibrations")["active"]["id"] == before
    screenshot(page, "setup-calibration-use")
    page.locator(".step").get_by_role("button", name="Activate").click()
    expect(step(page)).to_have_text("Prepare")
    active = live.daemon.get("/calibrations")["active"]
    assert active["id"] != before
    expect(page.locator(".below")).to_contain_text("in use")


@pytest.mark.full
def test_a_calibration_that_is_refused_says_why_and_is_cancelled(page: Page, live: LiveRig) -> None:
    enter(page, live, "calibration")
    page.get_by_label("Diameter of the ball, mm").first.fill("12")
    press(page, "Begin")
    expect(step(page)).to_have_text("Drop")
    live.fall(N_BALLS)
    expect(page.locator(".drops li")).to_have_count(N_BALLS)
    press(page, "Solve")
    expect(page.locator(".step")).to_contain_text(re.compile("could not be solved|must not be used"))
    screenshot(page, "setup-calibration-refused")
    press(page, "Reject" if step(page).inner_text() == "Review" else "Cancel")
    expect(step(page)).to_have_text("Prepare")
    (newest, *_) = live.daemon.get("/calibrations")["items"]
    assert newest["state"] in ("rejected", "cancelled")


@pytest.mark.full
def test_a_verification_to_its_verdict(page: Page, live: LiveRig) -> None:
    enter(page, live, "verification")
    assert violations(page) == []
    page.get_by_label("Diameter of the ball, mm").fill(str(BALL_MM))
    page.get_by_label("Number of drops").fill("3")
    press(page, "Begin")
    expect(step(page)).to_have_text("Drop")
    live.fall(2)
    expect(page.locator(".live tbody tr")).to_have_count(2)
    assert violations(page) == []
    screenshot(page, "setup-verification-drop")
    live.fall(1)
    expect(step(page)).to_have_text("Verdict")
    (verdict, *_) = live.daemon.get("/verifications")["items"]
    words = {"passed": "Passed", "failed": "Failed"}[verdict["state"]]
    expect(page.locator(".verdict")).to_have_text(words)
    shown_mm = float(page.locator(".gauge strong").first.inner_text().removesuffix(" mm").replace("−", "-"))
    assert shown_mm == pytest.approx(verdict["summary"]["error_mm"], abs=5e-4)
    expect(page.locator(".chart circle, .chart .out")).to_have_count(1)
    assert violations(page) == []
    screenshot(page, "setup-verification-verdict")
    press(page, "Verify again")
    expect(step(page)).to_have_text("Prepare")


def test_a_recording_to_its_files(page: Page, live: LiveRig) -> None:
    enter(page, live, "recording")
    assert violations(page) == []
    page.get_by_label("Name").fill("day-1")
    page.get_by_label("Stones from now on").fill("3")
    press(page, "Record")
    expect(page.locator(".live")).to_contain_text("0 of 3 stones")
    live.fall(2)
    expect(page.locator(".live")).to_contain_text("2 of 3 stones")
    page.reload()
    expect(page.locator(".live")).to_contain_text("2 of 3 stones")
    assert violations(page) == []
    screenshot(page, "setup-recording-record")
    live.fall(1)
    expect(step(page)).to_have_text("Fetch")
    expect(page.locator(".step")).to_contain_text("All stones asked for are there.")
    assert violations(page) == []
    screenshot(page, "setup-recording-done")
    (recorded,) = live.daemon.get("/recordings")["items"]
    with page.expect_download() as waited:
        page.locator(".step").get_by_role("link", name="Download .tar").click()
    with tarfile.open(fileobj=io.BytesIO(Path(waited.value.path()).read_bytes())) as archive:
        assert sum(name.endswith(".tiff") for name in archive.getnames()) == recorded["bundles"] >= 3
    page.get_by_role("button", name="Delete day-1").click()
    page.get_by_role("button", name="Really delete day-1").click()
    expect(page.locator(".below")).to_contain_text("There is none yet.")
    assert live.daemon.get("/recordings")["items"] == []


def blinking(page: Page, live: LiveRig) -> str:
    """Return the place of the one camera that a person sees blink now that the page says so."""
    expect(page.locator(".asked")).to_contain_text(" blinks ")

    def blinks() -> dict[str, int]:
        return {name: camera.counters.blinks for name, camera in live.rig.cameras.items()}

    before = blinks()
    seen: list[str] = []

    def is_seen() -> bool:
        seen[:] = [name for name, n in blinks().items() if n > before[name]]
        return seen != []

    eventually(is_seen)
    (camera,) = seen
    return camera


@pytest.mark.full
def test_the_first_start_finds_two_exchanged_cameras_and_a_silent_one(
    watched: Watched, page: Page, live: LiveRig
) -> None:
    watched.is_expected = re.compile("503 .*/identify")
    enter(page, live, "places")
    screenshot(page, "setup-places-prepare")
    press(page, "Stop measuring")
    expect(page.get_by_role("button", name="Let the first camera blink")).to_be_enabled()
    assert violations(page) == []
    live.camera(SILENT).unplug()
    press(page, "Let the first camera blink")
    found = []
    for n in range(15):
        camera = blinking(page, live)
        found.append(camera)
        expect(page.locator(".asked")).to_contain_text(live.camera(camera).design.serial)
        if n == 7:
            assert violations(page) == []
            page.reload()  # a tablet fell asleep: it goes on where it was
            expect(page.locator(".tile.found")).to_have_count(7)
            screenshot(page, "setup-places-find")
            press(page, "Let it blink")
            assert blinking(page, live) == camera
        page.locator(f'.tile[data-place="{EXCHANGED.get(camera, camera)}"]').click()
        expect(page.locator(".tile.found")).to_have_count(n + 1)
        expect(page.locator(".asked")).not_to_contain_text(live.camera(camera).design.serial)
    expect(page.locator(".tile.found")).to_have_count(15)
    assert sorted(found) == sorted(set(live.rig.cameras) - {SILENT})
    expect(page.locator(".step")).to_contain_text("16 of 16 cameras")
    expect(page.locator(".asked")).to_contain_text(f"{SILENT}: ")  # and why it did not blink
    live.camera(SILENT).replug()
    press(page, "To the result")
    text = page.locator(".findings").inner_text()
    assert "The cameras of c05 and c07 are exchanged." in text
    assert f"{SILENT} is silent" in text
    snippet = page.get_by_label("Cameras for the configuration").input_value()
    serials = dict(re.findall(r'id = "(\w+)"\nserial = "([^"]+)"', snippet))
    truth = {
        EXCHANGED.get(name, name): camera.design.serial
        for name, camera in live.rig.cameras.items()
        if name != SILENT
    }
    assert serials == truth
    assert f"# {SILENT}: no camera was seen here" in snippet
    assert violations(page) == []
    screenshot(page, "setup-places-result")
    press(page, "Start measuring")
    live.wait_until_whole()


def is_disarmed(acquisition: dict[str, Any]) -> bool:
    return acquisition["state"] == "disarmed"


@pytest.mark.full
def test_new_pictures_of_all_cameras(page: Page, live: LiveRig) -> None:
    live.daemon.put("/acquisition", {"state": "disarmed"})
    live.daemon.wait_for("/acquisition", is_disarmed)
    page.add_init_script(
        "localStorage.setItem('rig-places', JSON.stringify({c01: {place: 'c01', serial: 'x'}}))"
    )
    enter(page, live, "places")
    frames = {each["id"]: each["frames"] for each in live.daemon.get("/cameras")["items"]}
    press(page, "Take new pictures")
    expect(page.get_by_role("button", name="Take new pictures")).to_be_enabled()
    now = {each["id"]: each["frames"] for each in live.daemon.get("/cameras")["items"]}
    assert all(now[name] > frames[name] for name in now)
    shown = (
        "() => [...document.querySelectorAll('.tile img')].filter((image) => image.naturalWidth > 0).length"
    )
    eventually(lambda: page.evaluate(shown) == 16)
    live.daemon.wait_for("/acquisition", is_disarmed)  # meanwhile it cannot be armed
    live.daemon.put("/acquisition", {"state": "armed"})
    live.wait_until_whole()


@pytest.mark.parametrize(
    ("wizard", "size", "theme"),
    [
        pytest.param(wizard, *look, marks=[] if i == j == 0 else pytest.mark.full)
        for i, wizard in enumerate(("places", "calibration", "verification", "recording"))
        for j, look in enumerate(LOOKS)
    ],
)
def test_every_wizard_by_keyboard_in_german_in_every_size(
    browser: Browser, live: LiveRig, wizard: str, size: str, theme: str
) -> None:
    options = {"viewport": SIZES[size], "locale": "de-DE", "color_scheme": theme}
    with watched_page(browser, **options) as watched:
        page = watched.page
        page.set_default_timeout(PATIENCE_MS)
        enter(page, live, wizard)
        expect(page.locator("h1")).to_have_text("Die Anlage einrichten")
        threading.Event().wait(0.5)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert violations(page) == []
        screenshot(page, f"setup-{wizard}-{size}-{theme}")
        buttons = page.locator("main button:enabled")  # some come while the page is looked at
        eventually(lambda: set(buttons.evaluate_all(NAMES_OF)) <= reachable_by_tab(page))
        watched.assert_clean()
