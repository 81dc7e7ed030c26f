"""The operator's page on a running replay: painted at once, live, usable by hand, eye and ear."""

import re
import statistics
from collections.abc import Iterator
from datetime import datetime
from itertools import product

import pytest
from playwright.sync_api import Browser, expect
from support.browser import (
    SIZES,
    Watched,
    first_paint_ms,
    origin_of,
    reachable_by_tab,
    screenshot,
    until,
    violations,
    watched_page,
)
from support.daemon_process import DaemonProcess

from screens.conftest import DIM

PATIENCE_MS = 300_000
MAX_PAINT_MS = 10_000
"""Ten times what is asked for: no test depends on how fast the machine is."""
MAX_DELAY_MS = 10_000
N_STONES = 6
LIMITS = {
    "title": "8/16 basalt",
    "density_kg_m3": 2850,
    "lower_mm": 8,
    "upper_mm": 16,
    "specification": "GC85-20",
}

OWN_TEXTS = """() => {
  const texts = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
  const own = [];
  const isOwn = ({ parentElement }) => !parentElement.closest("[lang=en], style");
  while (texts.nextNode()) if (isOwn(texts.currentNode)) own.push(texts.currentNode.data);
  return own;
}"""
"""All texts of a page, but those of others, which are marked as English."""
QUICK_LOOKS = [("wall", "en", "light"), ("desktop", "de", "dark"), ("tablet", "de", "light")]
"""Each size, language and theme."""
LOOKS = [
    *QUICK_LOOKS,
    *(
        pytest.param(*look, marks=pytest.mark.full)
        for look in product(SIZES, ("en", "de"), ("light", "dark"))
        if look not in QUICK_LOOKS
    ),
]


@pytest.fixture
def operator(watched: Watched, replay: DaemonProcess) -> Watched:
    """The page, once it shows the rig."""
    watched.page.set_default_timeout(PATIENCE_MS)
    expect.set_options(timeout=PATIENCE_MS)
    watched.page.goto(origin_of(replay.url("")))
    expect(watched.page.locator("#ne107")).not_to_be_empty()
    return watched


@pytest.fixture(scope="module")
def lot(replay: DaemonProcess) -> Iterator[str]:
    """A lot of a product with a specification, open during the tests that ask for it."""
    replay.put("/products/basalt", LIMITS)
    opened = replay.post("/lots", {"lot": "L-1207", "product": "basalt"})
    yield str(opened["lot"])
    replay.post("/lots/L-1207/close", {})


def test_it_is_painted_at_once_and_stones_come_onto_it(operator: Watched, replay: DaemonProcess) -> None:
    page = operator.page
    paint_ms = first_paint_ms(page)
    page.evaluate(
        "window.arrivals = {}; for (const e of document.querySelectorAll('[data-seq]')) arrivals[e.dataset.seq] = 0"
    )
    until(page, "(n) => Object.values(arrivals).filter((at) => at > 0).length >= n", N_STONES)
    arrivals = {int(seq): at_ms for seq, at_ms in page.evaluate("window.arrivals").items() if at_ms > 0}
    results = replay.get(f"/results?after={min(arrivals) - 1}&limit=1000")["items"]
    recorded_ms = {
        each["seq"]: 1000 * datetime.fromisoformat(each["recorded_at"]).timestamp() for each in results
    }
    delays_ms = [at_ms - recorded_ms[seq] for seq, at_ms in arrivals.items()]
    print(  # noqa: T201 - what the issue asks for, measured
        f"\nfirst paint after {paint_ms:.0f} ms; {len(delays_ms)} stones on the page"
        f" {statistics.median(delays_ms):.0f} ms after their result (median), {max(delays_ms):.0f} ms at most"
    )
    assert 0 < paint_ms < MAX_PAINT_MS
    assert min(delays_ms) > -50 and max(delays_ms) < MAX_DELAY_MS  # two clocks of one machine


@pytest.mark.full
def test_a_stone_has_its_picture_and_words_and_leads_to_its_passport(
    operator: Watched, replay: DaemonProcess
) -> None:
    picture = operator.page.locator("#newest img").first
    expect(picture).to_be_visible()
    until(operator.page, "() => document.querySelector('#newest img')?.naturalWidth > 100")
    newest = operator.page.locator("#newest a").first
    newest.hover()  # the stones stay where they are
    assert re.fullmatch(r"\d+\.\d mm\s+\w+\s*.*", newest.inner_text(), re.DOTALL)
    name = (newest.get_attribute("href") or "").removeprefix("/stones/")
    assert replay.get(f"/particles/{name}")["outcome"] == "measured"
    newest.click()
    expect(operator.page.locator("#title")).to_contain_text(name)


@pytest.mark.full
def test_the_verdict_is_one_sentence_and_that_of_the_last_lot_stays(
    operator: Watched, replay: DaemonProcess
) -> None:
    page = operator.page  # before any test that asks for the module's lot, which is open from then on
    replay.put("/products/gravel", {**LIMITS, "title": "Gravel"})
    replay.post("/lots", {"lot": "L-1206", "product": "gravel"})
    expect(page.locator("#verdict-word")).to_have_text(re.compile(r"L-1206[: ]"))
    page.locator("#newest li").nth(5).wait_for()
    closed = replay.post("/lots/L-1206/close?wait_s=20", {})
    assert closed["completion"] is not None
    sentence = page.locator("#verdict-word")
    expect(sentence).to_have_text(re.compile(r"L-1206.*(measured|stones|many)"))
    expect(page.locator("#last-lot")).to_contain_text("Closed ")
    report = page.locator("#last-lot a")
    expect(report).to_have_attribute("href", closed["completion"]["report"])
    past = page.locator("#history a").first
    verdict = closed["completion"]["verdict"]
    expect(past).to_have_attribute("aria-label", re.compile("^L-1206: "))
    expect(page.locator("#history li").first).to_have_attribute("data-verdict", verdict)
    expect(past).to_have_attribute("href", closed["completion"]["report"])
    replay.post("/lots", {"lot": "L-1206b", "product": "gravel"})
    expect(sentence).to_have_text(re.compile("L-1206b"))
    expect(page.locator("#last-lot")).to_contain_text("Before: L-1206")
    replay.post("/lots/L-1206b/close?wait_s=20", {})


@pytest.mark.full
def test_lot_curve_and_verdict_change(operator: Watched, lot: str) -> None:
    page = operator.page
    expect(page.locator("#lot-name")).to_have_text(lot)
    expect(page.locator("#curve-title")).to_contain_text(lot)
    expect(page.locator("#verdict-word")).to_contain_text(re.compile("Too few|Undecided|onform"))
    expect(page.locator("#curve-drawing svg title")).not_to_be_empty()
    before = page.locator("#curve-drawing").inner_html()
    until(page, "(before) => document.querySelector('#curve-drawing').innerHTML !== before", before)
    expect(page.locator("#tile-d50 b")).to_have_text(re.compile(r"\d+\.\d"))
    expect(page.locator("#tile-rate b")).to_have_text(re.compile(r"\d+"))


@pytest.mark.full
def test_every_figure_has_its_trend(operator: Watched, lot: str) -> None:
    titles = set()
    expect(operator.page.locator("#tile-passing_lower .name")).to_have_text("Passing 8 mm")
    for name in ("d50", "passing_lower", "passing_upper", "flakiness", "shape", "rate"):
        operator.page.locator(f"#tile-{name}").click()
        expect(operator.page.locator("#trend")).to_have_attribute(
            "data-asked", re.compile(f"/{name}[.]svg.hours=1&.*product=basalt")
        )
        until(
            operator.page,
            "(seen) => !seen.includes(document.querySelector('#trend svg title')?.textContent ?? '')",
            ["", *titles],
        )
        titles.add(operator.page.locator("#trend svg title").first.text_content())
    assert len(titles) == 6
    operator.page.get_by_role("button", name="12 h").click()
    expect(operator.page.locator("#trend")).to_have_attribute("data-asked", re.compile("hours=12&"))


@pytest.mark.full
def test_a_figure_of_the_product_has_its_control_chart(operator: Watched, lot: str) -> None:
    page = operator.page
    expect(page.locator("#lot-name")).to_have_text(lot)
    page.locator("#tile-shape").click()
    page.get_by_role("button", name="Control chart").click()
    expect(page.locator("#trend")).to_have_attribute(
        "data-asked", re.compile("/products/basalt/control/shape_percent[.]svg")
    )
    expect(page.locator("#trend svg title")).to_have_text("Shape index SI, %: basalt")
    page.get_by_role("button", name="Control chart").click()
    expect(page.locator("#trend svg title")).to_have_text("Shape index SI, %")


@pytest.mark.full
def test_every_camera_has_a_tile_and_the_dim_one_stands_out(operator: Watched, replay: DaemonProcess) -> None:
    page = operator.page
    expect(page.locator("#camera-tiles li")).to_have_count(16)
    dim = page.locator(f"#camera-{DIM}")
    expect(dim).not_to_have_attribute("data-ne107", "good")
    expect(dim.locator('[data-field="brightness"]')).to_have_text(re.compile(r"Light (6|7)\d %"))
    expect(page.locator('#camera-tiles li[data-ne107="good"]')).to_have_count(15)
    until(page, "() => document.querySelector('#camera-tiles .picture').style.backgroundImage !== ''")
    dim.get_by_role("button").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text(re.compile(r"Light (6|7)\d %"))
    until(page, "() => document.querySelector('dialog img').naturalWidth > 100")
    page.keyboard.press("Escape")
    expect(dialog).to_have_count(0)


@pytest.mark.full
def test_an_alarm_says_what_to_do_and_is_acknowledged_and_shelved(
    operator: Watched, replay: DaemonProcess
) -> None:
    page = operator.page
    alarm = page.locator('.alarm[data-check="optics"]')
    expect(alarm).to_contain_text("What to do:")
    number = alarm.get_attribute("data-id")
    acknowledge = alarm.get_by_role("button", name="Acknowledge")
    acknowledge.focus()
    page.keyboard.press("Enter")
    expect(alarm).to_have_class(re.compile("acknowledged$"))
    expect(acknowledge).to_have_count(0)
    stored = {str(each["id"]): each for each in replay.get("/alarms")["items"]}[str(number)]
    assert stored["state"] == "acknowledged" and stored["acknowledged_by"] == "this machine"
    alarm.get_by_role("button", name="Shelve").click()
    page.get_by_label("Why it can wait").fill("cleaned at the end of the shift")
    page.get_by_role("button", name="Shelve", exact=True).click()
    expect(page.locator(".alarm.shelved")).to_have_count(1)
    (shelved,) = replay.get("/alarms")["shelved"]
    assert shelved["shelf_reason"] == "cleaned at the end of the shift"
    page.locator("#alarm-list summary").click()
    page.get_by_role("button", name="Take back").click()
    expect(alarm).to_have_count(1)


@pytest.mark.full
def test_what_was_changed_at_the_crusher_is_noted(operator: Watched, replay: DaemonProcess) -> None:
    page = operator.page
    page.get_by_role("button", name="Diary entry").click()
    page.get_by_label("Liner").check()
    expect(page.get_by_label("New gap, mm")).to_be_hidden()
    page.get_by_label("In words").fill("new concave")
    page.get_by_role("dialog").get_by_role("button", name="Diary entry").click()
    expect(page.get_by_role("dialog")).to_be_hidden()
    (entry,) = replay.get("/diary")["items"]
    assert (entry["kind"], entry["text"], entry["value"]) == ("liner", "new concave", None)


@pytest.mark.parametrize(("size", "language", "theme"), LOOKS)
@pytest.mark.full
def test_it_is_accessible_at_every_size(
    browser: Browser, replay: DaemonProcess, lot: str, size: str, language: str, theme: str
) -> None:
    with watched_page(browser, viewport=SIZES[size], color_scheme=theme) as watched:
        page = watched.page
        page.goto(f"{origin_of(replay.url(''))}/?language={language}")
        expect(page.locator("#camera-tiles li")).to_have_count(16)
        expect(page.locator("#curve-drawing svg")).to_have_count(1, timeout=PATIENCE_MS)
        expect(page.locator("#newest li")).to_have_count(12)
        assert page.evaluate("document.documentElement.lang") == language
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), "it scrolls sideways"
        if size == "wall":
            assert page.evaluate("document.documentElement.scrollHeight <= innerHeight"), (
                "nobody scrolls a wall"
            )
        page.emulate_media(reduced_motion="reduce")
        until(page, "() => document.querySelector('#newest img')?.naturalWidth > 100")
        screenshot(page, f"operator-{size}-{theme}-{language}")
        if size == "wall":
            assert page.evaluate("document.documentElement.scrollHeight <= innerHeight"), (
                "nobody scrolls a wall"
            )
        assert violations(page) == []
        watched.assert_clean()


def test_everything_is_reached_by_keyboard(operator: Watched) -> None:
    page = operator.page
    expect(page.locator("#camera-tiles button")).to_have_count(16)
    expect(
        page.locator('.alarm[data-check="optics"] button').first
    ).to_be_visible()  # texts are empty until then
    wanted = page.evaluate(
        "[...document.querySelectorAll('button, a')].filter((each) => each.checkVisibility())"
        ".map((each) => (each.getAttribute('aria-label') ?? each.innerText).trim())"
    )
    reached = reachable_by_tab(page)
    values = re.compile(r"\n.*|\s*(Light|Dust|Focus|Lost|Temp).*", re.DOTALL)  # they change meanwhile
    assert {values.sub("", each) for each in wanted} <= {values.sub("", each) for each in reached}


@pytest.mark.full
def test_it_speaks_german_and_remembers_it(operator: Watched) -> None:
    page = operator.page
    page.get_by_role("button", name="Deutsch").click()
    expect(page.get_by_role("heading", name="Kameras", exact=True)).to_be_visible()
    expect(page.locator("#alarms")).to_contain_text("Was zu tun ist:")
    page.reload()
    expect(page.get_by_role("heading", name="Kameras", exact=True)).to_be_visible()


def test_a_german_page_has_no_english(operator: Watched, lot: str) -> None:
    page = operator.page
    page.get_by_role("button", name="Deutsch").click()
    expect(page.locator("#alarms .alarm h3", has_text=f"Kamera {DIM} (Azimut")).to_have_count(1)
    expect(page.locator("#reasons")).to_contain_text("weniger Licht")
    page.locator(f"#camera-{DIM} button").click()
    page.keyboard.press("Escape")
    own = page.evaluate(OWN_TEXTS)
    english = re.compile(r"\b(the|of|and|light|look at|stones|is|lost|measured|conforms|camera|loop)\b")
    assert [text for text in own if english.search(text)] == []
    assert page.title().endswith(" – stonefall") and " · " not in page.title()


@pytest.mark.full
def test_a_wrong_address_is_a_page(operator: Watched, replay: DaemonProcess) -> None:
    operator.is_expected = re.compile("404")
    operator.page.goto(f"{origin_of(replay.url(''))}/nowhere?language=de")
    expect(operator.page.get_by_role("heading")).to_have_text("Hier ist keine Seite")
    assert operator.page.title() == "Hier ist keine Seite – stonefall"
    operator.page.get_by_role("link", name="Zur Seite des Bedieners").click()
    expect(operator.page.locator("#ne107")).not_to_be_empty()


@pytest.mark.full
def test_the_icon_of_the_tab_shows_the_state(operator: Watched, replay: DaemonProcess) -> None:
    icon = operator.page.locator("link[rel=icon]")
    expect(icon).to_have_attribute("href", re.compile(r"/icons/(?!stonefall)\w+[.]svg$"))


@pytest.mark.full
def test_the_theme_is_chosen_and_remembered(operator: Watched) -> None:
    page = operator.page
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.get_by_role("button", name="Theme: as system").click()
    page.get_by_role("button", name="Theme: light").click()
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert dark != light
    page.reload()
    expect(page.get_by_role("button", name="Theme: dark")).to_be_visible()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


@pytest.mark.full
def test_it_says_that_a_recording_is_played(operator: Watched) -> None:
    expect(operator.page.locator(".banner.origin")).to_have_text(re.compile("Simulated|Replay"))
